"""Participant numbers and row ids in a merged study.

Participant 3 of site 2 has the number 2003. The ids of all other rows of site 2 begin at 2 · 10⁹. Ids below 10⁹ belong
to the merged study itself.
"""

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database_rows import StudyEvent
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.store import find_rows

PARTICIPANT_NUMBER_STRIDE, ROW_ID_STRIDE = 1_000, 10**9
"""Distance between the participant numbers, and between the row ids, of two sites in a merged study."""
SITE_DIFFERENCE_EVENT = "site differs"
"""Name of the event for an accepted difference between merged studies. Its detail describes the difference."""
OMITTED_RECORDING_EVENT = "recording left out"
"""Name of the event for a damaged or missing recording that was not merged. Its detail is the reason."""


def compute_merged_participant_number(site: int, number: int) -> int:
    """Returns a participant's number in the merged study. ``number``: participant number at the site."""
    return site * PARTICIPANT_NUMBER_STRIDE + number


def compute_site_number(number: int) -> int:
    """Returns the site number of a participant. ``number``: participant number in the merged study."""
    return number // PARTICIPANT_NUMBER_STRIDE


def compute_merged_row_id(site: int, row: int) -> int:
    """Returns a row's id in the merged study. ``row``: id of the row at the site."""
    return site * ROW_ID_STRIDE + row


def record_event_once(connection: sa.Connection, name: str, detail: str, **about: int) -> None:
    """Store an event of the merged study, unless an event with the same name, detail and attempt exists."""
    events = find_rows(connection, StudyEvent)
    if any((each.name, each.detail, each.attempt) == (name, detail, about.get("attempt")) for each in events):
        return
    own = max((each.id for each in events if each.id < ROW_ID_STRIDE), default=0)
    hash_chain.insert_row(
        connection,
        schema.EVENT_TABLE,
        id=own + 1,
        recorded_at=make_utc_timestamp(),
        name=name,
        detail=detail,
        **about,
    )
