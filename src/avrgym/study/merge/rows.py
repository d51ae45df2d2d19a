"""Rows on their way from a site's database into that of a merged study."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

import sqlalchemy as sa

from avrgym.study.merge.recordings import merged_name
from avrgym.study.merge.sources import MERGED_TABLES, Row, Source
from avrgym.study.storage import ledger, schema
from avrgym.study.storage.sites import merged_id, merged_number

Rows = Mapping[str, Mapping[int, Row]]
"""Rows by table and key."""
_BY_NUMBER = (schema.PARTICIPANT, schema.TOMBSTONE)
_NAMING_RECORDINGS = {"attempt": "recording", "event": "detail"}


def rows_by_participant(source: Source, site: int) -> Mapping[int | None, Rows]:
    """The rows of a site as they are in the merged study, by the number there of whom they are about, if anybody.

    Tombstones are not among them. The log is of the whole site: it outlasts its participants.
    """
    found: dict[int | None, dict[str, dict[int, Row]]] = defaultdict(lambda: defaultdict(dict))
    sessions = {row["id"]: row["participant"] for row in source.rows["session"]}
    for table in MERGED_TABLES:
        for row in source.rows[table.name] if table is not schema.TOMBSTONE else ():
            moved = _moved(table, row, source, site)
            whose = None if table is schema.LOG else _whose(row, sessions)
            found[whose][table.name][moved[ledger.key_of(table).key]] = moved
    return found


def _whose(row: Row, sessions: Mapping[int, int]) -> int | None:
    """The number of the participant whom a row is about, if it is about one."""
    if "enrolled_at" in row:
        return row["number"]
    if row.get("participant") is not None:
        return row["participant"]
    session = row.get("session")
    return None if session is None else sessions[session]


def _moved(table: sa.Table, row: Row, source: Source, site: int) -> Row:
    """A row with the keys that it has in the merged study."""
    moved = {column.key: _moved_key(column, row[column.key], site) for column in _columns(table)}
    if table is schema.PARTICIPANT:
        moved |= {"site": row["site"] or source.name, "site_number": row["number"]}
    if table is schema.LOG and row["participant"] is not None:
        moved["participant"] = merged_number(site, row["participant"])
    if name := _NAMING_RECORDINGS.get(table.name):
        moved[name] = merged_name(row[name], site)
    return moved


def _columns(table: sa.Table) -> Iterable[sa.Column[Any]]:
    return (column for column in table.columns if column.key != "salt")


def _moved_key(column: sa.Column[Any], value: Any, site: int) -> Any:
    """A value, which moves with its site where it is the key of a row."""
    tables = [key.column.table for key in column.foreign_keys] or [column.table] * column.primary_key
    if not tables or value is None:
        return value
    return merged_number(site, value) if tables[0] in _BY_NUMBER else merged_id(site, value)


def store_rows(connection: sa.Connection, rows: Rows) -> int:
    """Bring the merged study's rows up to these; how many were written."""
    written = 0
    for table in MERGED_TABLES:
        wanted = rows.get(table.name, {})
        present = _present(connection, table, list(wanted))
        for key, row in wanted.items():
            if key not in present:
                ledger.insert(connection, table, **row)
            elif present[key] != row:
                ledger.update(connection, table, key, **row)
            written += present.get(key) != row
    return written


def _present(connection: sa.Connection, table: sa.Table, keys: list[int]) -> dict[int, Row]:
    columns = list(_columns(table))
    found = connection.execute(sa.select(*columns).where(ledger.key_of(table).in_(keys)))
    rows = [dict(zip([column.key for column in columns], row, strict=True)) for row in found]
    return {row[ledger.key_of(table).key]: row for row in rows}
