"""Computers that run sessions. By default, this is only the computer of the host."""

import multiprocessing
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Protocol

from avrgym.hosting.capacity import SessionCapacity
from avrgym.hosting.session_process import SessionRequest, run_session
from avrgym.system.child_processes import block_terminal_signals


class SessionProcess(Protocol):
    """The process of a session, on any computer. ``pid``: its id there; ``None`` while it starts."""

    @property
    def pid(self) -> int | None: ...

    def is_alive(self) -> bool: ...

    def join(self, timeout: float | None = None) -> None: ...

    def kill(self) -> None: ...


class Computer(Protocol):
    """A computer that runs sessions. ``capacity``: its capacity."""

    capacity: SessionCapacity

    def start_session(self, request: SessionRequest) -> tuple[SessionProcess, Connection]:
        """Start a session. Returns its process and the host's end of the pipe. The pipe ends with the process."""
        ...


class LocalComputer:
    """The host's own computer. Each session is a child process of the host."""

    def __init__(self, run: Callable[[SessionRequest, Connection], None] = run_session) -> None:
        """``run``: the function that runs in a session's process."""
        self.capacity, self._run = SessionCapacity(), run
        self._processes = _process_context()

    def start_session(self, request: SessionRequest) -> tuple[SessionProcess, Connection]:
        """Start the process of a session; see ``Computer``."""
        pipe, theirs = self._processes.Pipe()
        process = self._processes.Process(target=self._run, args=(request, theirs))
        with block_terminal_signals():
            process.start()
        theirs.close()
        return process, pipe


def _process_context() -> Any:
    """Returns the context that starts processes. Except on Windows, a server with imported modules forks them."""
    if sys.platform == "win32":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["avrgym.hosting.session_process"])
    return context
