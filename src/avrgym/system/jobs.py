"""Work that is spread over processes."""

import multiprocessing
import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing.sharedctypes import Synchronized
from typing import Any, TypeVar

from avrgym.system.child_processes import block_terminal_signals, exit_with_parent

Result = TypeVar("Result")

LOOK_EVERY_S = 0.5
_add: Callable[[int], None] | None = None
"""Where a process that works for another counts what it reports."""


def cores() -> int:
    """How many of the machine's cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_all(
    function: Callable[..., Result],
    arguments: Sequence[tuple[Any, ...]],
    jobs: int,
    tell: Callable[[int], None] = lambda done: None,
) -> list[Result]:
    """What a function gives of each arguments, in their order, from so many processes at the same time.

    The processes end with this one, however that ends; the first error ends all.

    Args:
        function: of a module, so that the processes find it.
        arguments: one tuple for each call.
        jobs: how many processes, 1 or more; there are no more than calls.
        tell: told again and again how much the calls have reported so far.
    """
    if not arguments:
        return []
    context = multiprocessing.get_context("spawn")
    done: Synchronized[int] = context.Value("q", 0)
    with ProcessPoolExecutor(min(jobs, len(arguments)), context, _begin, (done,)) as pool:
        with block_terminal_signals():
            calls = [pool.submit(function, *each) for each in arguments]
        try:
            running: set[Future[Result]] = set(calls)
            while running:
                finished, running = wait(running, LOOK_EVERY_S)
                for call in finished:
                    call.result()
                tell(done.value)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
    return [call.result() for call in calls]


def report(done: int) -> None:
    """In a process that works for another: so much more is done."""
    assert _add is not None
    _add(done)


@contextmanager
def counting() -> Generator[Callable[[], int]]:
    """Count what is reported in this context; gives how much it was so far."""
    global _add
    before, counts = _add, [0]
    _add = counts.append
    try:
        yield lambda: sum(counts)
    finally:
        _add = before


def _begin(done: "Synchronized[int]") -> None:
    """Have this process end with the one that started it; a terminal's signals are for that one."""

    def add(more: int) -> None:
        with done.get_lock():
            done.value += more

    global _add
    _add = add
    exit_with_parent()
