"""What a study holds of the sites that it was merged from.

Participant 3 of site 2 has the number 2003. The ids of all other rows of site 2 begin at 2 · 10⁹; below 10⁹ are rows of
the merged study's own.
"""

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.rows import StudyEvent
from avrgym.study.storage.schema import now
from avrgym.study.storage.store import find_all

PEOPLE_PER_SITE, ROWS_PER_SITE = 1_000, 10**9
SITE_DIFFERS = "site differs"
"""The event that a site's study was merged though it differs; its detail says in what."""
RECORDING_LEFT_OUT = "recording left out"
"""The event that an attempt's recording was damaged or missing at its site; its detail says which and why."""


def merged_number(site: int, number: int) -> int:
    """The number in the merged study of someone with this number at a site."""
    return site * PEOPLE_PER_SITE + number


def site_of(number: int) -> int:
    """The number of the site of a participant of a merged study."""
    return number // PEOPLE_PER_SITE


def merged_id(site: int, row: int) -> int:
    """The id in the merged study of any other row of a site."""
    return site * ROWS_PER_SITE + row


def record_once(connection: sa.Connection, name: str, detail: str, **about: int) -> None:
    """Store an event of the merged study's own, unless it is there."""
    events = find_all(connection, StudyEvent)
    if any((each.name, each.detail, each.attempt) == (name, detail, about.get("attempt")) for each in events):
        return
    own = max((each.id for each in events if each.id < ROWS_PER_SITE), default=0)
    hash_chain.insert(connection, schema.EVENT, id=own + 1, at=now(), name=name, detail=detail, **about)
