"""Runs function calls in several processes of this computer."""

import multiprocessing
import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing.sharedctypes import Synchronized
from typing import Any, TypeVar

from avrgym.system.child_processes import block_terminal_signals, exit_with_parent

Result = TypeVar("Result")

POLL_INTERVAL_S = 0.5
_add: Callable[[int], None] | None = None
"""Function that receives the progress reports of this process; ``None`` if reports are not counted."""


def count_available_cores() -> int:
    """Returns the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def starmap(
    function: Callable[..., Result],
    arguments: Sequence[tuple[Any, ...]],
    jobs: int,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Result]:
    """Call a function for each tuple of arguments. Returns the results in the order of the tuples.

    If a call raises an exception, all other calls are cancelled. The worker processes end when this process ends, even
    if it is killed.

    Args:
        function: a function that processes can import from its module.
        arguments: one tuple for each call.
        jobs: maximum number of processes, 1 or more. At most one process per call is started.
        progress: called repeatedly with the sum of all progress reports until now.
    """
    if not arguments:
        return []
    context = multiprocessing.get_context("spawn")
    done: Synchronized[int] = context.Value("q", 0)
    with ProcessPoolExecutor(min(jobs, len(arguments)), context, _start, (done,)) as pool:
        with block_terminal_signals():
            calls = [pool.submit(function, *each) for each in arguments]
        try:
            running: set[Future[Result]] = set(calls)
            while running:
                finished, running = wait(running, POLL_INTERVAL_S)
                for call in finished:
                    call.result()
                progress(done.value)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
    return [call.result() for call in calls]


def report_progress(done: int) -> None:
    """Report the progress of a call: ``done`` is the amount of work since the previous report."""
    assert _add is not None
    _add(done)


@contextmanager
def count_progress() -> Generator[Callable[[], int]]:
    """Context manager that sums progress reports. Yields a function that returns the sum."""
    global _add
    before, counts = _add, [0]
    _add = counts.append
    try:
        yield lambda: sum(counts)
    finally:
        _add = before


def _start(done: "Synchronized[int]") -> None:
    """Prepare a worker process: add its progress reports to ``done``, and exit when the parent process exits."""

    def add(more: int) -> None:
        with done.get_lock():
            done.value += more

    global _add
    _add = add
    exit_with_parent()
