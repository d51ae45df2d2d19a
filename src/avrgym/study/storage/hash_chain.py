"""Hash chain over all rows of a study (table ``ledger``). It reveals changes by other programs.

Each transaction appends an entry for every row that it wrote. The entry contains the checksum of the row, or no
checksum for a deleted row. The entry's digest covers the digest of the previous entry.

These errors reveal a change by another program:

* a row differs from its latest entry
* a row has no entry
* an entry has no row
* a digest is wrong

Rows contain a random salt. The checksum of a deleted row therefore reveals nothing about its contents.

A head is the number and digest of the last entry. The chain uses no secret key: another program can recompute all
digests. Only an earlier head that is stored elsewhere then reveals the change.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from avrgym.study.storage.schema import AUDIT_LOG_TABLE, LEDGER_TABLE, METADATA

CHAINED_TABLES: Mapping[str, sa.Table] = {
    table.name: table for table in METADATA.sorted_tables if table is not LEDGER_TABLE
}
"""Tables with rows in the hash chain, by name."""
_WRITTEN = "rows that the transaction wrote"


@dataclass(frozen=True)
class HashChainHead:
    """Number and digest of the last entry in a hash chain."""

    number: int = 0
    digest: str = ""

    def compute_next_head(self, table: str, key: int, content: str | None) -> "HashChainHead":
        """Returns the head after one more entry.

        ``key``: primary key of the row. ``content``: checksum of the row; ``None`` for a deleted row.
        """
        return HashChainHead(
            self.number + 1, compute_json_sha256([self.digest, self.number + 1, table, key, content])
        )


# Writing ------------------------------------------------------------------------------------------------------------


def insert_row(connection: sa.Connection, table: sa.Table, **values: Any) -> int:
    """Insert a row with these column values within a transaction. Returns its primary key."""
    inserted = connection.execute(sa.insert(table).values(values)).inserted_primary_key
    assert inserted is not None
    _wrote(connection, table, inserted[0])
    return inserted[0]


def update_row(connection: sa.Connection, table: sa.Table, key: int, **values: Any) -> None:
    """Set columns of a row within a transaction. ``key``: primary key of the row."""
    connection.execute(sa.update(table).where(find_primary_key_column(table) == key).values(values))
    _wrote(connection, table, key)


def delete_rows(connection: sa.Connection, table: sa.Table, *conditions: sa.ColumnElement[bool]) -> None:
    """Delete the rows that satisfy all conditions, within a transaction."""
    for key in (
        connection.execute(sa.select(find_primary_key_column(table)).where(*conditions)).scalars().all()
    ):
        _wrote(connection, table, key)
    connection.execute(sa.delete(table).where(*conditions))


def start_collecting_written_rows(connection: sa.Connection) -> None:
    """Start to collect the keys of the rows that a transaction writes."""
    connection.info[_WRITTEN] = set()


def list_written_row_keys(connection: sa.Connection) -> frozenset[tuple[str, int]]:
    """Returns the table and primary key of each row that the transaction has written so far."""
    return frozenset(connection.info[_WRITTEN])


def append_chain_entries(connection: sa.Connection) -> HashChainHead | None:
    """Append an entry for each row that a transaction wrote. Returns the new head; ``None`` if nothing was written."""
    rows = sorted(connection.info.pop(_WRITTEN))
    if not rows:
        return None
    entries: list[dict[str, Any]] = []
    after = read_chain_head(connection)
    for name, group in groupby(rows, key=lambda row: row[0]):
        keys = [key for _, key in group]
        contents = _contents(connection, CHAINED_TABLES[name], keys)
        for key in keys:
            content = contents.get(key)
            after = after.compute_next_head(name, key, content)
            entries.append({"table": name, "key": key, "content": content, **asdict(after)})
    connection.execute(sa.insert(LEDGER_TABLE), entries)
    return after


def read_chain_head(connection: sa.Connection) -> HashChainHead:
    """Returns the number and digest of the last entry in the hash chain."""
    last = (
        sa.select(LEDGER_TABLE.c.number, LEDGER_TABLE.c.digest)
        .order_by(LEDGER_TABLE.c.number.desc())
        .limit(1)
    )
    row = connection.execute(last).first()
    return HashChainHead(*row) if row else HashChainHead()


def find_missing_chain_heads(
    connection: sa.Connection, known: Collection[HashChainHead]
) -> list[HashChainHead]:
    """Returns the heads in ``known`` that the hash chain does not contain."""
    first = min((each.number for each in known), default=0)
    later = sa.select(LEDGER_TABLE.c.number, LEDGER_TABLE.c.digest).where(LEDGER_TABLE.c.number >= first)
    held = {number: digest for number, digest in connection.execute(later)} if known else {}
    return [each for each in known if held.get(each.number) != each.digest]


# Checking -----------------------------------------------------------------------------------------------------------


def find_hash_chain_errors(connection: sa.Connection) -> Iterator[tuple[str, str]]:
    """Yields the errors of the hash chain and of rows, as pairs: name of table and row, and message."""
    try:
        entries = _rows(connection, LEDGER_TABLE)
    except (SQLAlchemyError, ValueError, TypeError) as error:
        yield LEDGER_TABLE.name, f"cannot be read: {_reason(error)}"
        return
    if (broken := _first_break(entries)) is not None:
        yield (
            LEDGER_TABLE.name,
            f"entry {broken} does not follow the previous entry: an entry was changed or is missing",
        )
    for key, times in Counter(
        entry["key"] for entry in entries if entry["table"] == AUDIT_LOG_TABLE.name
    ).items():
        if times > 1:
            yield (
                f"{AUDIT_LOG_TABLE.name} {key}",
                "was changed or deleted; entries of the log must not change",
            )
    latest = {(entry["table"], entry["key"]): entry["content"] for entry in entries}
    for name, table in CHAINED_TABLES.items():
        expected = {
            key: content for (of, key), content in latest.items() if of == name and content is not None
        }
        yield from _faults_of(connection, table, expected)


def find_unchanged_row_keys(connection: sa.Connection, table: sa.Table) -> set[int]:
    """Returns the primary keys of the rows that no other program changed; empty if the hash chain is unreadable."""
    try:
        entries = _rows(connection, LEDGER_TABLE)
        found = _contents(connection, table)
    except (SQLAlchemyError, ValueError, TypeError):
        return set()
    latest = {entry["key"]: entry["content"] for entry in entries if entry["table"] == table.name}
    return {key for key, content in found.items() if latest.get(key) == content}


def _first_break(entries: list[sa.RowMapping]) -> int | None:
    """Returns the number of the first entry that does not match the entries before it; ``None`` if all match."""
    before = HashChainHead()
    for entry in entries:
        after = before.compute_next_head(entry["table"], entry["key"], entry["content"])
        if (entry["number"], entry["digest"]) != (after.number, after.digest):
            return before.number + 1
        before = after
    return None


def _faults_of(
    connection: sa.Connection, table: sa.Table, expected: Mapping[int, str]
) -> Iterator[tuple[str, str]]:
    try:
        found = _contents(connection, table)
    except (SQLAlchemyError, ValueError, TypeError) as error:
        yield table.name, f"cannot be read: {_reason(error)}"
        return
    for key in sorted(expected.keys() | found.keys(), key=str):
        if key not in found:
            yield f"{table.name} {key}", "was deleted by another program"
        elif key not in expected:
            yield f"{table.name} {key}", "was added by another program"
        elif found[key] != expected[key]:
            yield f"{table.name} {key}", "was changed by another program"


def find_primary_key_column(table: sa.Table) -> sa.Column[int]:
    """Returns the single primary key column of a table (an integer)."""
    (key,) = table.primary_key.columns
    return key


def _contents(connection: sa.Connection, table: sa.Table, keys: list[int] | None = None) -> dict[int, str]:
    """Returns the checksums of a table's rows, by primary key. ``keys``: only these rows; default: all rows.

    Columns without a value are ignored, because later versions may add columns.
    """
    name = find_primary_key_column(table).name
    return {
        row[name]: compute_json_sha256(
            [table.name, {column: value for column, value in row.items() if value is not None}]
        )
        for row in _rows(connection, table, keys)
    }


def _rows(connection: sa.Connection, table: sa.Table, keys: list[int] | None = None) -> list[sa.RowMapping]:
    """Returns the rows of a table. An error does not end the transaction."""
    query = sa.select(table).order_by(find_primary_key_column(table))
    if keys is not None:
        query = query.where(find_primary_key_column(table).in_(keys))
    with connection.begin_nested():
        return list(connection.execute(query).mappings())


def _wrote(connection: sa.Connection, table: sa.Table, key: int) -> None:
    connection.info[_WRITTEN].add((table.name, key))


def compute_json_sha256(value: Any) -> str:
    """Returns the SHA-256 (hexadecimal) of a value as compact JSON with sorted keys."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def _reason(error: Exception) -> str:
    return str(getattr(error, "orig", None) or error).splitlines()[0]
