"""Measures CPU steal: periods in which the host runs other virtual machines and stops a processor of this one.

On each processor, a real-time process repeatedly sleeps for a millisecond, with a priority above all other processes.
If a sleep takes longer, this processor was stopped in the meantime.
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

MONITOR_SLEEP_S = 0.001
"""Requested duration in seconds of each sleep of the monitoring process."""
STEAL_THRESHOLD_S = 0.001
"""Maximum delay of a sleep in seconds that the operating system causes. Longer delays are considered CPU steal."""
MONITOR_PRIORITY = 50
"""Real-time priority of the monitoring process, 1 to 99. It is higher than that of the simulation."""

TimeSpan = tuple[float, float]
"""A period: its start and end in seconds, on the system's monotonic clock."""


class CpuStealMonitor:
    """Context manager that monitors CPU steal on every processor.

    At its exit, ``steal_spans`` are the periods in which a processor was stopped, sorted and disjoint. Monitoring needs
    Linux, and root or the limit ``rtprio``; otherwise ``steal_spans`` is ``None``.
    """

    def __init__(self) -> None:
        self.steal_spans: list[TimeSpan] | None = None
        self._watchers: list[Connection] = []
        self._processes = ExitStack()

    def __enter__(self) -> "CpuStealMonitor":
        processors = sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else []
        context = multiprocessing.get_context("spawn")
        for processor in processors:
            here, there = context.Pipe()
            process = context.Process(target=monitor_processor, args=(processor, there), daemon=True)
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
        self.steal_spans = merge_spans(seen) if self._watchers else None

    def _end(self) -> list[TimeSpan]:
        spans: list[TimeSpan] = []
        for watcher in self._watchers:
            watcher.send(True)
            spans += watcher.recv()
        self._processes.close()
        return spans


def monitor_processor(processor: int, end: Connection) -> None:
    """Main function of the process that monitors one processor.

    Sends to ``end`` whether the system allows monitoring. When a message arrives from ``end``, sends the periods in
    which the processor was stopped, and exits.
    """
    spans: list[TimeSpan] = []
    allowed = _keep_to(processor)
    end.send(allowed)
    before_s = time.monotonic()
    while not end.poll(None if not allowed else 0.0):
        time.sleep(MONITOR_SLEEP_S)
        now_s = time.monotonic()
        if now_s - before_s > MONITOR_SLEEP_S + STEAL_THRESHOLD_S:
            spans.append((before_s + MONITOR_SLEEP_S, now_s))
        before_s = now_s
    end.send(spans)


def _keep_to(processor: int) -> bool:
    """Runs this process on one processor with real-time priority. Returns whether the system allows this."""
    try:
        os.sched_setaffinity(0, {processor})
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(MONITOR_PRIORITY))
    except OSError:
        return False
    return True


def merge_spans(spans: list[TimeSpan]) -> list[TimeSpan]:
    """Merges overlapping periods. Returns sorted, disjoint periods."""
    apart: list[TimeSpan] = []
    for began_s, ended_s in sorted(spans):
        if apart and began_s <= apart[-1][1]:
            apart[-1] = apart[-1][0], max(apart[-1][1], ended_s)
        else:
            apart.append((began_s, ended_s))
    return apart


def compute_overlap_s(spans: list[TimeSpan], began_s: float, ended_s: float) -> float:
    """Returns the total overlap in seconds between disjoint spans and the period from ``began_s`` to ``ended_s``."""
    return sum(max(0.0, min(end_s, ended_s) - max(begin_s, began_s)) for begin_s, end_s in spans)


def find_undisturbed_periods(spans: list[TimeSpan], began_s: FloatArray, ended_s: FloatArray) -> BoolArray:
    """Returns a boolean mask (n,): periods from ``began_s`` (n,) to ``ended_s`` (n,) that overlap no span.

    The spans are sorted and disjoint.
    """
    begins_s, ends_s = np.array([*spans, (np.inf, np.inf)]).T
    return ended_s < begins_s[np.searchsorted(ends_s, began_s)]
