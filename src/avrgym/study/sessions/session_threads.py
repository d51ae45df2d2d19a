"""Threads of a session: one stores events in order, another checks whether the session is still open."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar

from avrgym.study.storage.database_rows import StudySession
from avrgym.study.storage.polling_thread import PollingThread
from avrgym.study.storage.state_transitions import LostConnectionError
from avrgym.study.storage.store import StudyStore, find_rows

Result = TypeVar("Result")


class StorageThread(ThreadPoolExecutor):
    """A single thread that stores events in order.

    Waiting tasks are cancelled at the end of its context. A busy database therefore does not delay a program's end.
    Callers must wait for results inside the context.
    """

    def __init__(self) -> None:
        super().__init__(1, "storing")

    def __exit__(self, *_: object) -> None:
        self.shutdown(cancel_futures=True)


class StorageQueue:
    """A queue of storage tasks, which run one after another."""

    def __init__(self, thread: Executor) -> None:
        """``thread``: executor that runs tasks in order: a ``StorageThread``, or an ``ImmediateExecutor``."""
        self._thread = thread
        self._pending: deque[Future[None]] = deque()

    def submit_checked(self, store: Callable[[], None]) -> None:
        """Add a task. If it fails, ``is_done`` raises its error."""
        self._pending.append(self.submit(store))

    def submit(self, store: Callable[[], None]) -> Future[None]:
        """Add a task. Returns its future. If the task fails, only the future raises the error.

        A task that fails because the connection to the database is lost is repeated.
        """
        return self._thread.submit(repeat_interrupted, store)

    def is_done(self) -> bool:
        """Returns whether all tasks of ``submit_checked`` are done. Raises the error of a failed task once."""
        failures = [error for future in self._take_done() if (error := future.exception())]
        if failures:
            raise failures[0]
        return not self._pending

    def _take_done(self) -> Iterator[Future[None]]:
        while self._pending and self._pending[0].done():
            yield self._pending.popleft()


def repeat_interrupted(task: Callable[[], Result]) -> Result:
    """Run a task. Repeat it if the connection to the database is lost. Returns its result."""
    for _ in range(MAX_TASK_REPEATS):
        with suppress(LostConnectionError):
            return task()
    return task()


MAX_TASK_REPEATS = 2
"""Maximum number of repeats of a task after a lost connection. Each repeat waits for the database."""
SESSION_POLL_INTERVAL_S = 0.5
"""Interval in seconds between two checks of the session's state."""


class SessionMonitor(PollingThread):
    """A thread that polls the database to check whether a session is still open.

    ``is_ended_elsewhere``: whether another process has ended the session, by a withdrawal or a newer session.
    """

    def __init__(self, store: StudyStore, session_id: int) -> None:
        super().__init__("watch session", SESSION_POLL_INTERVAL_S)
        self.is_ended_elsewhere = False
        self._store, self._session_id = store, session_id
        self.start()

    def poll(self) -> None:
        """Read the session's state."""
        with self._store.database.read_transaction() as connection:
            still_open = find_rows(connection, StudySession, id=self._session_id, state="open")
        if not still_open:
            self.is_ended_elsewhere = True
            self.close()
