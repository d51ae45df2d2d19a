"""CPU steal, when processors stood still: the host of a virtual machine lets others run on them, and tells nobody when.

On each processor a process sleeps for a millisecond again and again, and goes before all else that the system runs
there. Where it sleeps for longer, nothing ran there at all.
"""

import multiprocessing
import os
import sys
import time
from contextlib import ExitStack
from multiprocessing.connection import Connection
from types import TracebackType

import numpy as np

from avrgym.array_types import BoolArray, FloatArray

SLEEP_S = 0.001
LEAST_S = 0.001
"""What sleeps may last longer than asked for, for reasons that are the system's own."""
PRIORITY = 50
"""Among the system's real-time processes, 1 to 99: before the simulation's."""

Span = tuple[float, float]
"""Beginning and end, seconds of the system's monotonic clock."""


class CpuSteal:
    """Watches every processor from its entering to its leaving; then ``spans`` are when any of them stood still.

    They are in order and apart from each other; ``None`` where the system does not let itself be watched: that takes
    Linux, and root or a limit ``rtprio``.
    """

    def __init__(self) -> None:
        self.spans: list[Span] | None = None
        self._watchers: list[Connection] = []
        self._processes = ExitStack()

    def __enter__(self) -> "CpuSteal":
        processors = sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else []
        context = multiprocessing.get_context("spawn")
        for processor in processors:
            here, there = context.Pipe()
            process = context.Process(target=watch, args=(processor, there), daemon=True)
            process.start()
            self._processes.callback(process.join)
            self._watchers.append(here)
        if not all([watcher.recv() for watcher in self._watchers]):
            self._end()
            self._watchers = []
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        seen = self._end()
        self.spans = merged(seen) if self._watchers else None

    def _end(self) -> list[Span]:
        spans: list[Span] = []
        for watcher in self._watchers:
            watcher.send(True)
            spans += watcher.recv()
        self._processes.close()
        return spans


def watch(processor: int, end: Connection) -> None:
    """A process that watches one processor: says whether it may, and once told to end, when that stood still."""
    spans: list[Span] = []
    allowed = _keep_to(processor)
    end.send(allowed)
    before_s = time.monotonic()
    while not end.poll(None if not allowed else 0.0):
        time.sleep(SLEEP_S)
        now_s = time.monotonic()
        if now_s - before_s > SLEEP_S + LEAST_S:
            spans.append((before_s + SLEEP_S, now_s))
        before_s = now_s
    end.send(spans)


def _keep_to(processor: int) -> bool:
    """Run on one processor, before all else; whether that is allowed."""
    try:
        os.sched_setaffinity(0, {processor})
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return False
    return True


def merged(spans: list[Span]) -> list[Span]:
    """The same times in order and apart."""
    apart: list[Span] = []
    for began_s, ended_s in sorted(spans):
        if apart and began_s <= apart[-1][1]:
            apart[-1] = apart[-1][0], max(apart[-1][1], ended_s)
        else:
            apart.append((began_s, ended_s))
    return apart


def within_s(spans: list[Span], began_s: float, ended_s: float) -> float:
    """How much of the time from one moment to another lies in spans that are apart."""
    return sum(max(0.0, min(end_s, ended_s) - max(begin_s, began_s)) for begin_s, end_s in spans)


def outside(spans: list[Span], began_s: FloatArray, ended_s: FloatArray) -> BoolArray:
    """Which of n stretches of time, by their beginnings and ends (n,), no span touches; spans in order and apart."""
    begins_s, ends_s = np.array([*spans, (np.inf, np.inf)]).T
    return ended_s < begins_s[np.searchsorted(ends_s, began_s)]
