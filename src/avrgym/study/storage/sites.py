"""Numbers of participants and rows in a study that was merged from sites.

Participant 3 of site 2 has the number 2003. The ids of all other rows of site 2 begin at 2 · 10⁹. Ids below 10⁹ belong
to the merged study itself.
"""

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.rows import StudyEvent
from avrgym.study.storage.schema import now
from avrgym.study.storage.store import find_all

PEOPLE_PER_SITE, ROWS_PER_SITE = 1_000, 10**9
SITE_DIFFERS = "site differs"
"""Event: a site's study was merged although it differs; the detail is the difference."""
RECORDING_LEFT_OUT = "recording left out"
"""Event: an attempt's recording was damaged or missing at its site; the detail is the reason."""


def merged_number(site: int, number: int) -> int:
    """The number in the merged study of a participant of a site."""
    return site * PEOPLE_PER_SITE + number


def site_of(number: int) -> int:
    """The site number of a participant of a merged study."""
    return number // PEOPLE_PER_SITE


def merged_id(site: int, row: int) -> int:
    """The id in the merged study of another row of a site."""
    return site * ROWS_PER_SITE + row


def record_once(connection: sa.Connection, name: str, detail: str, **about: int) -> None:
    """Store an event of the merged study, unless it is stored already."""
    events = find_all(connection, StudyEvent)
    if any((each.name, each.detail, each.attempt) == (name, detail, about.get("attempt")) for each in events):
        return
    own = max((each.id for each in events if each.id < ROWS_PER_SITE), default=0)
    hash_chain.insert(connection, schema.EVENT, id=own + 1, at=now(), name=name, detail=detail, **about)
