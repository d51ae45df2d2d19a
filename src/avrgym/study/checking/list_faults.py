"""Faults of a participation list, which make participation unknown when the database is lost."""

from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta

from avrgym.study.storage import signing
from avrgym.study.storage.participation import DELETED, Content, Participation
from avrgym.study.storage.rows import pseudonym_of
from avrgym.study.storage.states import UNKNOWN
from avrgym.study.storage.store import Store
from avrgym.system.data_folder import data_folder

_CLOCK = timedelta(minutes=1)
"""Allowed difference between the clocks of two computers."""


def list_fault(store: Store, listed: Participation | None, beginnings: Mapping[int, datetime]) -> str:
    """The fault of the list, as a clause whose subject is the list; empty if the list is valid.

    ``beginnings`` are those of each participant's first recording.
    """
    if listed is None:
        return "is missing"
    if listed.fault:
        return listed.fault
    if not listed.is_signed_here():
        return f"is not signed with this user's key ({data_folder() / signing.KEY})"
    if not store.database.is_sqlite:
        return "may lack what other stations stored in PostgreSQL"
    return next(_faults(store, listed, beginnings), "")


def recordings_came_back(deleted_at: str) -> str:
    """The fault of recordings of a participant who was deleted."""
    return (
        f"was deleted at {deleted_at}, but there are recordings of them, for example from a backup; they are ignored; "
        "delete-participant removes them"
    )


def _faults(store: Store, listed: Participation, beginnings: Mapping[int, datetime]) -> Iterator[str]:
    end = signing.known_end(store.folder) or signing.moved_end(listed.list_digest)
    if end is not None and end.list_digest != listed.list_digest:
        yield "is of another study than the earlier list in this folder"
    elif end is not None and not listed.has(end.digest):
        yield "was set back to an older copy: this computer has stored later entries"
    for number, began in beginnings.items():
        content = listed.latest.get(number)
        if content is None:
            yield f"does not contain {pseudonym_of(number)}, but there are recordings of them"
        elif content["state"] not in (DELETED, UNKNOWN) and not _consented_before(content, began):
            yield f"contains no consent of {pseudonym_of(number)} from before their first recording"


def _consented_before(content: Content, began: datetime) -> bool:
    at = content.get("consented_at")
    return at is not None and datetime.fromisoformat(at) <= began + _CLOCK
