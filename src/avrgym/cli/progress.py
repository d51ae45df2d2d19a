"""Show the progress of long work: a bar on a terminal, lines of text in a file."""

import time
from collections import deque
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from avrgym.cli.terminal import escape_control_characters, make_console, print_line

if TYPE_CHECKING:
    from rich.progress import Progress

LINE_INTERVAL_S = 10.0
"""Minimum time in seconds between two lines of text in a file."""
RATE_SAMPLE_INTERVAL_S, RATE_WINDOW_S = 1.0, 300.0
"""Time between samples of the completed work, and time window of the average rate, in seconds."""
RESTART_HINT = "nothing was written; run the same command again"
CONTINUE_HINT = "finished work is stored; the same command continues"
Clock = Callable[[], float]


class WorkRate:
    """Rate of work, computed from samples of the completed amount over a time window."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque()

    def add_sample(self, now_s: float, done: float) -> None:
        """Add a sample: the completed amount ``done`` at the time ``now_s`` in seconds."""
        if len(self._samples) > 1 and now_s - self._samples[-2][0] < RATE_SAMPLE_INTERVAL_S:
            self._samples.pop()
        self._samples.append((now_s, done))
        while len(self._samples) > 2 and self._samples[1][0] <= now_s - RATE_WINDOW_S:
            self._samples.popleft()

    @property
    def work_per_s(self) -> float:
        """Amount of work per second; 0 with only one sample."""
        (first_s, first), (last_s, last) = self._samples[0], self._samples[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else 0.0


class ProgressBar:
    """The progress of long work, shown as a bar or as lines."""

    def __init__(self, progress: "Progress", label: str, total: float | None, unit: str) -> None:
        self._progress, self._label, self._unit = progress, escape_control_characters(label), unit
        progress.add_task(self._label, total=total, left="")
        (self._task,) = progress.tasks
        self._started_s = self._line_s = progress.get_time()
        self._rate = WorkRate()

    def advance(self, by: float = 1) -> None:
        """Add ``by`` to the completed amount."""
        if not self._task.completed:
            self._rate.add_sample(self._started_s, 0.0)
        self.update(self._task.completed + by)

    def update(self, done: float, total: float | None = None, label: str | None = None) -> None:
        """Set the completed amount, and also total and label if they are given."""
        now_s = self._progress.get_time()
        self._rate.add_sample(now_s, done)
        description = None if label is None else escape_control_characters(label)
        self._progress.update(self._task.id, completed=done, total=total, description=description)
        self._progress.update(self._task.id, left=self._left())
        if not self._progress.console.is_terminal and now_s - self._line_s >= LINE_INTERVAL_S:
            self._line_s = now_s
            print_line(self._line())

    def finish(self) -> None:
        """Print the duration of the work if the progress was printed as lines."""
        if self._line_s > self._started_s:
            print_line(
                f"{self._label}: done in {format_duration(self._progress.get_time() - self._started_s)}"
            )

    def _left(self) -> str:
        per_s, total = self._rate.work_per_s, self._task.total
        remaining = (total or 0.0) - self._task.completed
        return f"{format_duration(remaining / per_s)} left" if per_s and remaining > 0.0 else ""

    def _line(self) -> str:
        """Returns the progress as text.

        Example: ``avrgym/FeedingJaco-v1: 38400 of 300000 steps (13 %), 1250 a second, 4 min left``.
        """
        task, per_s = self._task, self._rate.work_per_s
        done = f"{task.completed:.0f} {self._unit}"
        if task.total:
            share = 100 * task.completed / task.total
            done = f"{task.completed:.0f} of {task.total:.0f} {self._unit} ({share:.0f} %)"
        rate = f"{per_s:{'.0f' if per_s >= 10 else '.2g'}} a second" if per_s else ""
        return f"{task.description}: {', '.join(filter(None, (done, rate, self._left())))}"


@contextmanager
def show_progress_bar(
    label: str,
    total: float | None = None,
    unit: str = "",
    stopped: str = RESTART_HINT,
    clock: Clock = time.monotonic,
) -> Generator[ProgressBar]:
    """Context manager: show the progress of long work. Yields the bar.

    Args:
        label: name of the work.
        total: amount of work; ``None`` if it is unknown.
        unit: unit of the amount, such as ``steps``.
        stopped: message after an interruption: the stored results, and the command that continues the work.
        clock: a function that returns the time in seconds.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    label_column, left_column = (
        TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[left]}")
    )
    shown = make_console()
    progress = Progress(
        label_column,
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
            bar = ProgressBar(progress, label, total, unit)
            yield bar
    except KeyboardInterrupt as stop:
        stop.add_note(stopped)
        raise
    bar.finish()


def format_duration(seconds: float) -> str:
    """Returns a duration as text, such as ``40 s``, ``12 min`` or ``3 h 20 min``."""
    minutes = round(seconds / 60)
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
