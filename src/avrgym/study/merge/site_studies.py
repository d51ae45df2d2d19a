"""Read the sites' studies before a merge, and check that they are different studies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import sqlalchemy as sa

from avrgym.study.design.toml_validation import NAME_PATTERN
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database_rows import Participant, Site, format_pseudonym
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.sites import PARTICIPANT_NUMBER_STRIDE, compute_site_number
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore

RowValues = Mapping[str, Any]
"""Values of a database row, by column name."""
MERGED_TABLES = tuple(
    table
    for table in schema.METADATA.sorted_tables
    if table
    not in (
        schema.STUDY_TABLE,
        schema.SITE_TABLE,
        schema.EXPERIMENTER_TABLE,
        schema.INVITATION_TABLE,
        schema.INVITATION_USE_TABLE,
        schema.LEDGER_TABLE,
    )
)
"""Tables to merge. A table follows all tables to which its foreign keys refer."""


@dataclass(frozen=True)
class SiteStudy:
    """A site's study, read in one transaction.

    ``site_name``: name of the site. ``rows_by_table``: rows by table name. ``hash_chain_head``: last entry of the
    study's hash chain.
    """

    site_name: str
    store: StudyStore
    rows_by_table: Mapping[str, Sequence[RowValues]]
    hash_chain_head: hash_chain.HashChainHead

    @property
    def enrolment_times(self) -> dict[int, str]:
        """Enrolment times, by participant number. Number and time together identify a participant."""
        return {row["number"]: row["enrolled_at"] for row in self.rows_by_table["participant"]}

    @property
    def site_names(self) -> set[str]:
        """Names of the sites of all participants."""
        return {self.site_name, *(row["site"] for row in self.rows_by_table["participant"] if row["site"])}


def read_site_study(store: StudyStore) -> SiteStudy:
    """Returns the contents of a site's study for a merge.

    Raises:
        StudyError: if the study is a merged study, has no valid site name, or was changed by another program.
    """
    name = store.design.site or store.folder.name
    if store.read_sites():
        raise StudyError(f"{store.folder} was merged from sites; merge these sites instead")
    if not NAME_PATTERN.fullmatch(name):
        raise StudyError(
            f"{store.folder}: {name!r} is not a valid site name; set `site` in study.toml to at most "
            "40 letters, digits, - and _"
        )
    for where, what in store.database.find_integrity_errors():
        raise StudyError(
            f"nothing was merged: {store.folder}: {where} {what}; run `avrgym study check {store.folder}`"
        )
    fetch_recordings(store)
    with store.database.read_transaction() as connection:
        rows = {table.name: _rows(connection, table) for table in MERGED_TABLES}
        source = SiteStudy(name, store, rows, hash_chain.read_chain_head(connection))
    most = max((row["number"] for table in ("participant", "tombstone") for row in rows[table]), default=0)
    if most >= PARTICIPANT_NUMBER_STRIDE:
        raise StudyError(
            f"{store.folder} has {format_pseudonym(most)}; allowed: participant numbers up to "
            f"{PARTICIPANT_NUMBER_STRIDE - 1}"
        )
    return source


def _rows(connection: sa.Connection, table: sa.Table) -> list[dict[str, Any]]:
    """Returns all rows of a table without salts. The merged study creates new salts."""
    names = [column.key for column in table.columns]
    found = connection.execute(sa.select(table).order_by(hash_chain.find_primary_key_column(table)))
    rows = [dict(zip(names, row, strict=True)) for row in found]
    return [{name: value for name, value in row.items() if name != "salt"} for row in rows]


def check_distinct_studies(sources: Sequence[SiteStudy]) -> None:
    """Raises ``StudyError`` if two studies are the same, or have the same site name."""
    for a, b in combinations(sources, 2):
        both = f"{a.store.folder} and {b.store.folder}"
        twice = sorted(set(a.enrolment_times.items()) & set(b.enrolment_times.items()))
        if a.store.folder == b.store.folder or twice:
            raise StudyError(f"{both} are the same site; list each site once")
        if shared := sorted(a.site_names & b.site_names):
            raise StudyError(
                f"{both} have the same site {shared[0]!r}; set different values of `site` in their study.toml"
            )


def check_site_continuation(source: SiteStudy, known: Sequence[Site], people: Sequence[Participant]) -> None:
    """Raises ``StudyError`` unless the site is new, or its study is a later state of the merged site.

    Args:
        source: the site's study.
        known: the sites in the merged study.
        people: the participants in the merged study.
    """
    before = next((site for site in known if site.name == source.site_name), None)
    others = [each for each in people if before is None or compute_site_number(each.number) != before.number]
    for each in others:
        if (each.site_number, each.enrolled_at) in source.enrolment_times.items():
            raise StudyError(
                f"{source.store.folder}: the merged study contains its participant {each.pseudonym_at_site} under "
                f"another "
                f"site; set `site` in its study.toml to this site: {', '.join(site.name for site in known)}"
            )
    taken = {each.site for each in others} | {site.name for site in known if site is not before}
    if shared := sorted(source.site_names & taken):
        raise StudyError(
            f"{source.store.folder}: the merged study has another site {shared[0]!r}; set a different `site` in "
            "its study.toml"
        )
    if before is not None and before.num_entries:
        _check_not_set_back(source, before)


def _check_not_set_back(source: SiteStudy, before: Site) -> None:
    with source.store.database.read_transaction() as connection:
        if hash_chain.find_missing_chain_heads(
            connection, [hash_chain.HashChainHead(before.num_entries, before.last_digest)]
        ):
            raise StudyError(
                f"{source.store.folder}: the site {source.site_name!r} differs from the merged study, or is an older "
                f"copy. "
                "Restore the latest copy, or merge into a new folder"
            )
