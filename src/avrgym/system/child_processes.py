"""Configures child processes: they exit with their parent, and ignore signals of the terminal."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager

TERMINAL_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGHUP") if hasattr(signal, name))
"""Signals that a terminal sends to a process and its children: interrupt (Ctrl+C) and hang-up."""


@contextmanager
def block_terminal_signals() -> Generator[None]:
    """Context manager: processes that are started in this context ignore signals of the terminal."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def exit_with_parent() -> None:
    """Exit this process when its parent process exits, even if the parent is killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="watch parent", daemon=True).start()
