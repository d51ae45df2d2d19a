"""How far long work is: a bar on a terminal, plain lines where output goes into a file, and what is kept of it."""

import time
from collections import deque
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from avrgym.cli.terminal import console, printable, say

if TYPE_CHECKING:
    from rich.progress import Progress

LINE_EVERY_S = 10.0
"""What is done sooner says nothing in a file but its results."""
SEE_EVERY_S, RATE_OVER_S = 1.0, 300.0
"""How often the rate is measured anew, and over how long: it may differ from stage to stage."""
BEGINS_ANEW = "nothing was written; the same command begins anew"
GOES_ON = "what is done is kept; the same command goes on"
Clock = Callable[[], float]


class Pace:
    """How fast work goes, from how much was done when."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque()

    def see(self, now_s: float, done: float) -> None:
        """So much is done now. What was done at the first time counts as done before."""
        if len(self._seen) > 1 and now_s - self._seen[-2][0] < SEE_EVERY_S:
            self._seen.pop()
        self._seen.append((now_s, done))
        while len(self._seen) > 2 and self._seen[1][0] <= now_s - RATE_OVER_S:
            self._seen.popleft()

    @property
    def per_s(self) -> float:
        """How much is done a second; 0 before that is known."""
        (first_s, first), (last_s, last) = self._seen[0], self._seen[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else 0.0


class Bar:
    """How far long work is."""

    def __init__(self, progress: "Progress", words: str, total: float | None, unit: str) -> None:
        self._progress, self._words, self._unit = progress, printable(words), unit
        progress.add_task(self._words, total=total, left="")
        (self._task,) = progress.tasks
        self._began_s = self._told_s = progress.get_time()
        self._pace = Pace()

    def advance(self, by: float = 1) -> None:
        """So many more are done."""
        if not self._task.completed:
            self._pace.see(self._began_s, 0.0)
        self.show(self._task.completed + by)

    def show(self, done: float, total: float | None = None, words: str | None = None) -> None:
        """So many are done, of so many where that was not known, in other words where they changed."""
        now_s = self._progress.get_time()
        self._pace.see(now_s, done)
        description = None if words is None else printable(words)
        self._progress.update(self._task.id, completed=done, total=total, description=description)
        self._progress.update(self._task.id, left=self._left())
        if not self._progress.console.is_terminal and now_s - self._told_s >= LINE_EVERY_S:
            self._told_s = now_s
            say(self._line())

    def end(self) -> None:
        """Say how long it took, where lines told of it."""
        if self._told_s > self._began_s:
            say(f"{self._words}: done in {duration(self._progress.get_time() - self._began_s)}")

    def _left(self) -> str:
        per_s, total = self._pace.per_s, self._task.total
        remaining = (total or 0.0) - self._task.completed
        return f"{duration(remaining / per_s)} left" if per_s and remaining > 0.0 else ""

    def _line(self) -> str:
        """Such as ``avrgym/FeedingJaco-v1: 38400 of 300000 steps (13 %), 1250 a second, 4 min left``."""
        task, per_s = self._task, self._pace.per_s
        done = f"{task.completed:.0f} {self._unit}"
        if task.total:
            share = 100 * task.completed / task.total
            done = f"{task.completed:.0f} of {task.total:.0f} {self._unit} ({share:.0f} %)"
        rate = f"{per_s:{'.0f' if per_s >= 10 else '.2g'}} a second" if per_s else ""
        return f"{task.description}: {', '.join(filter(None, (done, rate, self._left())))}"


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
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    words_column, left_column = (
        TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[left]}")
    )
    shown = console()
    progress = Progress(
        words_column,
        BarColumn(),
        MofNCompleteColumn(),
        left_column,
        console=shown,
        transient=True,
        disable=not shown.is_terminal,
        get_time=clock,
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
