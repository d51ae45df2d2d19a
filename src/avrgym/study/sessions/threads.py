"""Threads of a session: one stores facts in order, one watches whether the session is still open."""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress

from avrgym.study.storage.rows import StudySession
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_all


class StorageThread(ThreadPoolExecutor):
    """The one thread that stores.

    On leaving its context it drops what has not begun: whoever had to know it stored has waited for it before, and a
    database that is busy for minutes keeps no program from ending.
    """

    def __init__(self) -> None:
        super().__init__(1, "storing")

    def __exit__(self, *_: object) -> None:
        self.shutdown(cancel_futures=True)


class StorageQueue:
    """Hands what is to be stored to an executor of one thread."""

    def __init__(self, thread: Executor) -> None:
        """``thread`` does what is submitted in order: a pool of one thread, or at once in simulated time."""
        self._thread = thread
        self._asked: deque[Future[None]] = deque()

    def ask(self, store: Callable[[], None]) -> None:
        """Have something stored after all that was asked before; ``done`` tells how that went."""
        self._asked.append(self.submit(store))

    def submit(self, store: Callable[[], None]) -> Future[None]:
        """Have something stored after all that was asked before; only the future tells how that went."""
        return self._thread.submit(store)

    def done(self) -> bool:
        """Whether all is on disk that was asked so far; raises once what could not be."""
        failures = [error for future in self._take_done() if (error := future.exception())]
        if failures:
            raise failures[0]
        return not self._asked

    def _take_done(self) -> Iterator[Future[None]]:
        while self._asked and self._asked[0].done():
            yield self._asked.popleft()


CHECK_EVERY_S = 0.5


class SessionWatch:
    """Looks again and again, on a thread of its own, whether a session is still open in the study.

    ``called_off``: somebody else has ended it, by withdrawing the participant or by taking over.
    """

    def __init__(self, store: Store, session_id: int) -> None:
        self.called_off = False
        self._store, self._session_id = store, session_id
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch session", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Look no longer."""
        self._closed.set()

    def _run(self) -> None:
        while not self._closed.wait(CHECK_EVERY_S) and not self.called_off:
            with suppress(StudyError):  # a database that cannot be read shows when something is to be stored
                self._look()

    def _look(self) -> None:
        with self._store.database.read() as connection:
            still_open = find_all(connection, StudySession, id=self._session_id, state="open")
        self.called_off = not still_open
