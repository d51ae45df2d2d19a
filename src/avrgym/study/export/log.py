"""The log of a study as rows of a table, with participants by pseudonym."""

from collections.abc import Iterator
from typing import Any

from avrgym.study.export.records import Extras
from avrgym.study.storage.audit_log import ADD_EXPERIMENTER, REVOKE_EXPERIMENTER, site_names
from avrgym.study.storage.rows import pseudonym_of
from avrgym.study.storage.sites import ROWS_PER_SITE
from avrgym.study.storage.store import Store


def log_rows(store: Store, extras: Extras) -> Iterator[dict[str, Any]]:
    """Every entry; experimenters by numbers, or by names with the extras."""
    entries, sites = store.log(), site_names(store)
    people = dict.fromkeys((entry.id // ROWS_PER_SITE, entry.person, entry.known_by) for entry in entries)
    codes = {person: f"person {number}" for number, person in enumerate(people, start=1)}
    for entry in entries:
        site = entry.id // ROWS_PER_SITE
        names_somebody = entry.name in (ADD_EXPERIMENTER, REVOKE_EXPERIMENTER)
        yield {
            "entry": entry.id,
            "site": sites.get(site) or store.design.site or None,
            "at": entry.at,
            "person": entry.person if extras.free_text else codes[site, entry.person, entry.known_by],
            "known_by": entry.known_by,
            "name": entry.name,
            "participant": None if entry.participant is None else pseudonym_of(entry.participant),
            "detail": None if names_somebody and not extras.free_text else entry.detail or None,
            "completed": entry.completed,
            "planned": entry.planned,
        }
