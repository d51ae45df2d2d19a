"""Participant numbers and row ids in a merged study.

Participant 3 of site 2 has the number 2003. The ids of all other rows of site 2 begin at 2 · 10⁹. Ids below 10⁹ belong
to the merged study itself.
"""

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.rows import StudyEvent
from avrgym.study.storage.schema import utc_timestamp
from avrgym.study.storage.store import find_rows

PARTICIPANTS_PER_SITE, ROWS_PER_SITE = 1_000, 10**9
"""Distance between the participant numbers, and between the row ids, of two sites in a merged study."""
SITE_DIFFERENCE_EVENT = "site differs"
"""Name of the event for an accepted difference between merged studies. Its detail describes the difference."""
OMITTED_RECORDING_EVENT = "recording left out"
"""Name of the event for a damaged or missing recording that was not merged. Its detail is the reason."""


def merged_participant_number(site: int, number: int) -> int:
    """Returns a participant's number in the merged study. ``number``: participant number at the site."""
    return site * PARTICIPANTS_PER_SITE + number


def site_number_of(number: int) -> int:
    """Returns the site number of a participant. ``number``: participant number in the merged study."""
    return number // PARTICIPANTS_PER_SITE


def merged_row_id(site: int, row: int) -> int:
    """Returns a row's id in the merged study. ``row``: id of the row at the site."""
    return site * ROWS_PER_SITE + row


def record_event_once(connection: sa.Connection, name: str, detail: str, **about: int) -> None:
    """Store an event of the merged study, unless an event with the same name, detail and attempt exists."""
    events = find_rows(connection, StudyEvent)
    if any((each.name, each.detail, each.attempt) == (name, detail, about.get("attempt")) for each in events):
        return
    own = max((each.id for each in events if each.id < ROWS_PER_SITE), default=0)
    hash_chain.insert(
        connection,
        schema.EVENT_TABLE,
        id=own + 1,
        recorded_at=utc_timestamp(),
        name=name,
        detail=detail,
        **about,
    )
