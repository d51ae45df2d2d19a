"""Scheduled deletion of data of people after the end of the retention period."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime

from avrgym.study.design.retention import ALL_DATA, IDENTITY_DATA, RECORDING_DATA
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.storage import identity_file
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER as FOLDER
from avrgym.study.storage.database_rows import StudyEvent, parse_participant_number
from avrgym.study.storage.remote_recordings import remove_recordings
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_rows, record_event

DELETION_EVENT_BY_DATA_KIND = {
    IDENTITY_DATA: "identity deleted by schedule",
    RECORDING_DATA: "recordings deleted by schedule",
}
"""Event of a scheduled deletion, by kind of data. A deletion of ``ALL_DATA`` creates a tombstone instead."""
DATA_KIND_LABELS = {IDENTITY_DATA: "names and contacts", RECORDING_DATA: "recordings", ALL_DATA: "all data"}


@dataclass(frozen=True)
class ScheduledDeletion:
    """The deletion of one kind of data.

    ``due_date``: first day after the retention period. ``pseudonyms``: pseudonyms of participants with such data.
    """

    data_kind: str
    due_date: date
    pseudonyms: tuple[str, ...]

    def is_due(self, day: date) -> bool:
        """Returns whether the retention period has ended on ``day``."""
        return bool(self.pseudonyms) and self.due_date <= day


def today_utc() -> date:
    """Returns the current date in UTC. Retention periods are compared with it."""
    return datetime.now(UTC).date()


def list_scheduled_deletions(store: StudyStore) -> list[ScheduledDeletion]:
    """Returns all scheduled deletions of people's data."""
    people = [each.pseudonym for each in store.read_participants() if not each.simulated]
    known = identity_file.read_pseudonyms_with_identity(store.folder)
    present = {
        IDENTITY_DATA: [name for name in people if name in known],
        RECORDING_DATA: [name for name in people if _has_recordings(store, name)],
        ALL_DATA: people,
    }
    return [
        ScheduledDeletion(kind, day, tuple(present[kind]))
        for kind, day in store.design.retention.deletion_date_by_data_kind.items()
    ]


def list_due_deletions(store: StudyStore, day: date) -> list[ScheduledDeletion]:
    """Returns the scheduled deletions whose retention period has ended on ``day``."""
    return [each for each in list_scheduled_deletions(store) if each.is_due(day)]


def describe_due_deletions(store: StudyStore, day: date) -> Iterator[str]:
    """Yields a message for each kind of data that must be deleted. Also yields a message if the end date is missing."""
    retention = store.design.retention
    for each in list_due_deletions(store, day):
        number = len(each.pseudonyms)
        yield (
            f"{DATA_KIND_LABELS[each.data_kind]} of {number} participant{'' if number == 1 else 's'} must be "
            f"deleted since "
            f"{each.due_date}: `avrgym study retention {store.folder} --delete` deletes them"
        )
    if retention.months_by_data_kind and retention.last_study_day is None and _is_complete(store):
        yield "all planned participants have completed the study: set ended_on in [retention] of study.toml"


def delete_due_data(store: StudyStore, day: date) -> Iterator[tuple[str, str]]:
    """Delete all data that are due on ``day``. Yields kind of data and pseudonym after each deletion.

    ``delete_participant`` deletes data of the kind ``ALL_DATA``. After a crash, a second call completes the deletions.

    Raises:
        StudyError: if a session took place after the study's end; nothing is deleted then. Also if participants could
            not be deleted; this is raised after all other deletions.
    """
    _check_ended(store)
    errors: list[str] = []
    for each in list_due_deletions(store, day):
        for pseudonym in each.pseudonyms:
            try:
                _delete(store, each.data_kind, pseudonym)
            except StudyError as error:
                errors.append(str(error))
            else:
                yield each.data_kind, pseudonym
    if errors:
        raise StudyError("; ".join(errors))


def read_recording_deletion_times(store: StudyStore) -> Mapping[int, str]:
    """Returns the time of the scheduled deletion of recordings, by participant number."""
    with store.database.read_transaction() as connection:
        events = find_rows(connection, StudyEvent, name=DELETION_EVENT_BY_DATA_KIND[RECORDING_DATA])
    return {event.participant: event.recorded_at for event in events if event.participant is not None}


def _delete(store: StudyStore, kind: str, pseudonym: str) -> None:
    if kind == ALL_DATA:
        delete_participant(store, pseudonym)
        return
    with store.database.write_transaction() as connection:
        record_event(
            connection,
            DELETION_EVENT_BY_DATA_KIND[kind],
            "",
            {"participant": parse_participant_number(pseudonym)},
        )
        if kind == IDENTITY_DATA:
            identity_file.remove_identity(store.folder, pseudonym)
    if kind == RECORDING_DATA:
        remove_recordings(store, pseudonym)


def _has_recordings(store: StudyStore, pseudonym: str) -> bool:
    """Returns whether recordings of a participant remain here, or may remain in the object store."""
    if (store.folder / FOLDER / pseudonym).exists():
        return True
    is_deleted = parse_participant_number(pseudonym) in read_recording_deletion_times(store)
    return store.object_store is not None and not is_deleted and bool(store.read_attempts(pseudonym))


def _check_ended(store: StudyStore) -> None:
    end = store.design.retention.last_study_day
    people = [each.pseudonym for each in store.read_participants() if not each.simulated]
    days = [session.opened_at[:10] for name in people for session in store.read_sessions(name)]
    if end is not None and max(days, default="") > end.isoformat():
        raise StudyError(
            f"a session took place on {max(days)}, after the study's end on {end}: nothing was deleted; correct "
            "ended_on in [retention] of study.toml"
        )


def _is_complete(store: StudyStore) -> bool:
    people = [each for each in store.read_participants() if not each.simulated]
    return sum(each.state == "completed" for each in people) >= store.design.participants
