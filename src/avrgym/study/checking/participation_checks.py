"""Check the participation list, and that no deleted participant has data in the study."""

from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta

from avrgym.study.checking.finding import Finding
from avrgym.study.storage import signing
from avrgym.study.storage.data_loss import PARTICIPATION_CONFIRMED_EVENT
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER, format_pseudonym
from avrgym.study.storage.participation_list import (
    DELETED_STATE,
    PARTICIPATION_LIST_FILE,
    EntryContent,
    ParticipationEntries,
)
from avrgym.study.storage.reconciliation import OLDER_STUDY_COPY_EVENT, PARTICIPATION_STATE_RESTORED_EVENT
from avrgym.study.storage.state_transitions import UNKNOWN_PARTICIPATION_STATE
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import get_user_data_folder


def check_participation(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about the participation list, and about differences between list, database and recordings."""
    yield from _check_list(store)
    yield from _check_events(store)
    for participant in store.read_participants():
        if participant.state == UNKNOWN_PARTICIPATION_STATE:
            message = (
                "consent, withdrawal or deletion is unknown since the database was rebuilt; they are in no analysis. "
                "Run `avrgym study confirm-participation` or `avrgym study withdraw`"
            )
            yield Finding(participant.pseudonym, message)
    for gone in store.read_deleted_participants():
        if any((store.folder / RECORDINGS_FOLDER / format_pseudonym(gone.number)).rglob("*")):
            yield Finding(format_pseudonym(gone.number), format_restored_recordings_message(gone.deleted_at))


def _check_list(store: StudyStore) -> Iterator[Finding]:
    for path in store.database.participation_list.find_invalid_copies():
        yield Finding(
            path.name,
            f"is an invalid {PARTICIPATION_LIST_FILE} that was replaced; find the cause, then remove the file",
        )
    listed = store.read_participation_list()
    if listed is None:
        return
    if listed.error_message:
        yield Finding(PARTICIPATION_LIST_FILE, listed.error_message)
        return
    yield from _check_beginning(store, listed)
    people = {each.number for each in store.read_participants()}
    known = people | {each.number for each in store.read_deleted_participants()}
    for number, content in listed.latest_content_by_participant.items():
        if number not in known:
            message = f"contains {format_pseudonym(number)}, who is not in the database: restore a later copy"
            yield Finding(PARTICIPATION_LIST_FILE, message)
        elif content["state"] == DELETED_STATE and number in people:
            message = (
                f"was deleted at {content['at']}, but is in the database again; `avrgym study delete-participant` "
                "removes the data"
            )
            yield Finding(format_pseudonym(number), message)


def _check_beginning(store: StudyStore, listed: ParticipationEntries) -> Iterator[Finding]:
    """Yields a finding if the participation list was started after the first enrolment."""
    first = min((each.enrolled_at for each in store.read_participants()), default=listed.started_at)
    if first < listed.started_at:
        detail = listed.contents_without_participant[0]["detail"]
        why = f" and {detail}" if detail else ""
        yield Finding(
            PARTICIPATION_LIST_FILE,
            f"was started at {listed.started_at} with the contents of the database{why}",
            is_error=False,
        )


def _check_events(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about restored states, older copies of the study, and confirmed participation."""
    for event in store.read_events():
        where = format_pseudonym(event.participant) if event.participant else "study"
        if event.name == PARTICIPATION_STATE_RESTORED_EVENT:
            yield Finding(where, f"was {event.detail}; the database did not contain it", is_error=False)
        elif event.name == OLDER_STUDY_COPY_EVENT:
            yield Finding(where, f"was set back: at {event.recorded_at} {event.detail}", is_error=False)
        elif event.name == PARTICIPATION_CONFIRMED_EVENT:
            message = (
                f"participation was confirmed at {event.recorded_at} by the experimenter: {event.detail}"
            )
            yield Finding(where, message, is_error=False)


_CLOCK = timedelta(minutes=1)
"""Largest allowed difference between the clocks of two computers."""


def find_participation_list_error(
    store: StudyStore, listed: ParticipationEntries | None, beginnings: Mapping[int, datetime]
) -> str:
    """Returns the error of the participation list, such as "is missing"; empty if the list is valid.

    ``beginnings``: start time of each participant's first recording, by participant number.
    """
    if listed is None:
        return "is missing"
    if listed.error_message:
        return listed.error_message
    if not listed.is_signed_by_user():
        return f"is not signed with this user's key ({get_user_data_folder() / signing.SIGNING_KEY_FILE})"
    if not store.database.is_sqlite:
        return "may lack entries of other stations, which stored them in PostgreSQL"
    return next(_faults(store, listed, beginnings), "")


def format_restored_recordings_message(deleted_at: str) -> str:
    """Returns the error message about existing recordings of a deleted participant. ``deleted_at``: time of the
    deletion.
    """
    return (
        f"was deleted at {deleted_at}, but there are recordings of them, for example from a backup. They are ignored; "
        "`avrgym study delete-participant` removes them"
    )


def _faults(
    store: StudyStore, listed: ParticipationEntries, beginnings: Mapping[int, datetime]
) -> Iterator[str]:
    end = signing.read_last_entry(store.folder) or signing.find_last_entry_of_moved_study(listed.list_id)
    if end is not None and end.list_id != listed.list_id:
        yield "belongs to another study than the earlier list in this folder"
    elif end is not None and not listed.contains_digest(end.digest):
        yield "was replaced by an older copy: this computer has stored later entries"
    for number, began in beginnings.items():
        content = listed.latest_content_by_participant.get(number)
        if content is None:
            yield f"does not contain {format_pseudonym(number)}, a participant with recordings"
        elif content["state"] not in (DELETED_STATE, UNKNOWN_PARTICIPATION_STATE) and not _consented_before(
            content, began
        ):
            yield f"contains no consent of {format_pseudonym(number)} from before their first recording"


def _consented_before(content: EntryContent, began: datetime) -> bool:
    at = content.get("consented_at")
    return at is not None and datetime.fromisoformat(at) <= began + _CLOCK
