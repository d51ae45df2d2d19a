"""Why a participation list does not tell who takes part in a study whose database is lost."""

from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta

from avrgym.study.storage import signing
from avrgym.study.storage.participation import DELETED, Content, Participation
from avrgym.study.storage.rows import pseudonym_of
from avrgym.study.storage.states import UNKNOWN
from avrgym.study.storage.store import Store
from avrgym.system.files import data_folder

_CLOCK = timedelta(minutes=1)
"""By so much the clocks of two computers may differ."""


def list_fault(store: Store, listed: Participation | None, beginnings: Mapping[int, datetime]) -> str:
    """Why the list proves nothing, as a clause of which it is the subject; empty where it is sound.

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


def came_back(deleted_at: str) -> str:
    """What is wrong with recordings of somebody who was deleted."""
    return (
        f"was deleted at {deleted_at}, and recordings of them are back, as from a backup; they are not taken up; "
        "delete-participant removes them"
    )


def _faults(store: Store, listed: Participation, beginnings: Mapping[int, datetime]) -> Iterator[str]:
    end = signing.known_end(store.folder) or signing.moved_end(listed.list_digest)
    if end is not None and end.list_digest != listed.list_digest:
        yield "is of another study than was in this folder"
    elif end is not None and not listed.has(end.digest):
        yield "was set back: this computer knows later entries"
    for number, began in beginnings.items():
        content = listed.latest.get(number)
        if content is None:
            yield f"does not contain {pseudonym_of(number)}, but there are recordings of them"
        elif content["state"] not in (DELETED, UNKNOWN) and not _consented_before(content, began):
            yield f"contains no consent of {pseudonym_of(number)} from before their first recording"


def _consented_before(content: Content, began: datetime) -> bool:
    at = content.get("consented_at")
    return at is not None and datetime.fromisoformat(at) <= began + _CLOCK
