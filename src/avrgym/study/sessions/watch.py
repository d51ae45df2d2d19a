"""Watching a session that runs: somebody in another process or at another station may end it."""

import threading
from contextlib import suppress

from avrgym.study.storage.rows import StudySession
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_all

LOOK_EVERY_S = 0.5


class Watch:
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
        while not self._closed.wait(LOOK_EVERY_S) and not self.called_off:
            with suppress(StudyError):  # a database that cannot be read shows when something is to be stored
                self._look()

    def _look(self) -> None:
        with self._store.database.read() as connection:
            still_open = find_all(connection, StudySession, id=self._session_id, state="open")
        self.called_off = not still_open
