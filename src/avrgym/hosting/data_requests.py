"""Requests of participants about their data, made on their own page: deletion, and a copy.

The host deletes the data as soon as no session runs, because the traces in the database can be erased only then. A copy
is handed over by an experimenter, who first searches it for names of other people: ``avrgym study participant-data``.
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
    """Returns the pseudonyms of participants with a request of this name."""
    with store.database.read_transaction() as connection:
        numbers = {each.participant for each in find_rows(connection, StudyEvent, name=name)}
    return [pseudonym_of(number) for number in sorted(filter(None, numbers))]


class RequestedDeletions:
    """Context manager: a thread that deletes the data of participants who requested it, while no session runs."""

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
        """Delete all requested data. What fails, for example in a busy database, is tried again later."""
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
