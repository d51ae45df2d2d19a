"""How far long work is: a bar on a terminal, plain lines where output goes into a file, and what is kept of it."""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from avrgym.cli.terminal import console, printable, say

if TYPE_CHECKING:
    from rich.progress import Progress

LINE_EVERY_S = 10.0
"""What is done sooner says nothing in a file but its results."""
RATE_OVER_S = 300.0
"""Over how long the rate is measured, which may differ from stage to stage."""
BEGINS_ANEW = "nothing was written; the same command begins anew"
GOES_ON = "what is done is kept; the same command goes on"
Clock = Callable[[], float]


class Bar:
    """How far long work is."""

    def __init__(self, progress: "Progress", words: str, total: float | None, unit: str) -> None:
        self._progress, self._words, self._unit = progress, printable(words), unit
        self._task = progress.add_task(self._words, total=total)
        self._began_s = self._told_s = progress.get_time()

    def advance(self, by: float = 1) -> None:
        """So many more are done."""
        self._progress.advance(self._task, by)
        self._tell()

    def show(self, done: float, total: float | None = None, words: str | None = None) -> None:
        """So many are done, of so many where that was not known, in other words where they changed."""
        description = None if words is None else printable(words)
        self._progress.update(self._task, completed=done, total=total, description=description)
        self._tell()

    def end(self) -> None:
        """Say how long it took, where lines told of it."""
        if self._told_s > self._began_s:
            say(f"{self._words}: done in {duration(self._progress.get_time() - self._began_s)}")

    def _tell(self) -> None:
        now_s = self._progress.get_time()
        if not self._progress.console.is_terminal and now_s - self._told_s >= LINE_EVERY_S:
            self._told_s = now_s
            say(self._line())

    def _line(self) -> str:
        """Such as ``avrgym/FeedingJaco-v1: 38400 of 300000 steps (13 %), 1250 a second, 4 min left``."""
        task = self._progress.tasks[self._task]
        done = f"{task.completed:.0f} {self._unit}"
        if task.total:
            share = 100 * task.completed / task.total
            done = f"{task.completed:.0f} of {task.total:.0f} {self._unit} ({share:.0f} %)"
        rate = [f"{task.speed:{'.0f' if task.speed >= 10 else '.2g'}} a second"] if task.speed else []
        left = [] if task.time_remaining is None else [f"{duration(task.time_remaining)} left"]
        return f"{task.description}: {', '.join([done, *rate, *left])}"


@contextmanager
def progress_bar(
    words: str,
    total: float | None = None,
    unit: str = "",
    stopped: str = BEGINS_ANEW,
    clock: Clock = time.monotonic,
) -> Generator[Bar]:
    """Show how long work goes on.

    Args:
        words: what is done.
        total: how much there is to do; a bar sways where nobody knows.
        unit: of what.
        stopped: what is kept where a signal breaks it off, and how to go on.
        clock: gives seconds.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    left = TimeRemainingColumn(elapsed_when_finished=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), left)
    shown = console()
    progress = Progress(
        *columns,
        console=shown,
        transient=True,
        disable=not shown.is_terminal,
        get_time=clock,
        speed_estimate_period=RATE_OVER_S,
    )
    try:
        with progress:
            bar = Bar(progress, words, total, unit)
            yield bar
    except KeyboardInterrupt as stop:
        stop.add_note(stopped)
        raise
    bar.end()


def duration(seconds: float) -> str:
    """A length of time in words: ``40 s``, ``12 min`` or ``3 h 20 min``."""
    minutes = round(seconds / 60)
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
