"""Requests of participants on their page: to delete their data, or to receive a copy.

The host deletes the data when no session is running. Only then can the database erase all traces. An experimenter
creates the copy with ``avrgym study participant-data``, and removes names of other people before sending it.
"""

from contextlib import suppress

from avrgym.hosting.session_pool import SessionPool
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.storage.audit_log import add_log_entry, find_process_user
from avrgym.study.storage.database_rows import StudyEvent, format_pseudonym
from avrgym.study.storage.polling_thread import PollingThread
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_rows

DELETION_REQUESTED_EVENT = "deletion requested"
DATA_COPY_REQUESTED_EVENT = "copy of data requested"
DELETION_CHECK_INTERVAL_S = 30.0


def find_requesting_participants(store: StudyStore, name: str) -> list[str]:
    """Returns the pseudonyms of participants with a request. ``name``: name of the request's event."""
    with store.database.read_transaction() as connection:
        numbers = {each.participant for each in find_rows(connection, StudyEvent, name=name)}
    return [format_pseudonym(number) for number in sorted(filter(None, numbers))]


class DeletionThread(PollingThread):
    """Context manager: a thread that deletes data at the request of participants, while no session is running."""

    def __init__(self, store: StudyStore, pool: SessionPool) -> None:
        super().__init__("requested deletions", DELETION_CHECK_INTERVAL_S)
        self._store, self._pool = store, pool
        self._unfinished: set[str] = set()

    def poll(self) -> None:
        """Delete all requested data. A failed deletion, for example in a locked database, is repeated later."""
        if self._pool.sessions:
            return
        self._unfinished.update(find_requesting_participants(self._store, DELETION_REQUESTED_EVENT))
        for pseudonym in sorted(self._unfinished):
            with suppress(StudyError, OSError):
                delete_participant(self._store, pseudonym)
                add_log_entry(self._store, find_process_user(), "delete participant", pseudonym, "on request")
                self._unfinished.discard(pseudonym)
