"""Requests of participants on their page: to delete their data, or to receive a copy.

The host deletes the data when no session is running. Only then can the database erase all traces. An experimenter
creates the copy with ``avrgym study participant-data``, and removes names of other people before sending it.
"""

import threading
from typing import Self

from avrgym.hosting.session_pool import SessionPool
from avrgym.study.people.deletion import delete_participant
from avrgym.study.storage.audit_log import add_log_entry, process_user
from avrgym.study.storage.rows import StudyEvent, pseudonym_of
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_rows

DELETION_REQUESTED = "deletion requested"
COPY_REQUESTED = "copy of data requested"
INTERVAL_S = 30.0


def requested(store: Store, name: str) -> list[str]:
    """Returns the pseudonyms of participants with a request. ``name``: name of the request's event."""
    with store.database.read_transaction() as connection:
        numbers = {each.participant for each in find_rows(connection, StudyEvent, name=name)}
    return [pseudonym_of(number) for number in sorted(filter(None, numbers))]


class RequestedDeletions:
    """Context manager: a thread that deletes data at the request of participants, while no session is running."""

    def __init__(self, store: Store, pool: SessionPool, interval_s: float = INTERVAL_S) -> None:
        self._store, self._pool, self._interval_s = store, pool, interval_s
        self._unfinished: set[str] = set()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="requested deletions", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._closed.wait(self._interval_s):
            if not self._pool.sessions:
                self.delete()

    def delete(self) -> None:
        """Delete all requested data. A failed deletion, for example in a locked database, is repeated later."""
        try:
            self._unfinished.update(requested(self._store, DELETION_REQUESTED))
        except StudyError:
            return
        for pseudonym in sorted(self._unfinished):
            try:
                delete_participant(self._store, pseudonym)
                add_log_entry(self._store, process_user(), "delete participant", pseudonym, "on request")
            except (StudyError, OSError):
                continue
            self._unfinished.discard(pseudonym)
