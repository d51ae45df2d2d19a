"""Copy rows and recordings of a site into the merged study."""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from avrgym.recording import answers_file
from avrgym.study.merge.source_studies import MERGED_TABLES, Row, SiteStudy
from avrgym.study.plan.frozen_plan import sha256
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.attempts import CHECKSUM_MISMATCH_MESSAGE
from avrgym.study.storage.rows import RECORDINGS, participant_number, pseudonym_of
from avrgym.study.storage.sites import merged_participant_number, merged_row_id
from avrgym.study.storage.states import StudyError
from avrgym.system.files import PRIVATE_FILE_MODE, make_private_folder, write_atomically

_IN_RECORDINGS = re.compile(rf"{RECORDINGS}/(sub-[0-9]{{3,9}})/")


def merged_recording_path(text: str, site: int) -> str:
    """Returns the path of a recording in the merged study. Text after the path, and other texts, are not changed.

    ``text``: text that begins with the path at the site. ``site``: number of the site.
    """
    match = _IN_RECORDINGS.match(text)
    if match is None:
        return text
    pseudonym = pseudonym_of(merged_participant_number(site, participant_number(match[1])))
    return f"{RECORDINGS}/{pseudonym}/{text[match.end() :]}"


@dataclass(frozen=True)
class SiteRecording:
    """A recording of a site.

    ``attempt_id``: attempt id at the site. ``participant_number``: participant number at the site. ``recording_path``:
    path in the site's study. ``source_path``: absolute path; ``None`` if it is outside the recordings. ``target_path``:
    path in the merged study. ``sha256``: expected checksum; ``None`` if the file may be missing.
    """

    attempt_id: int
    participant_number: int
    recording_path: str
    source_path: Path | None
    target_path: Path
    sha256: str | None

    def is_copied(self) -> bool:
        """Returns whether the merged study contains the recording with the correct checksum."""
        return (
            self.sha256 is not None
            and self.target_path.is_file()
            and _checksum(self.target_path) == self.sha256
        )

    def find_copy_error(self) -> str | None:
        """Returns the reason why the recording cannot be copied; ``None`` if it can be copied.

        The message begins with the recording's name.
        """
        if self.source_path is None:
            return f"{self.recording_path} is outside the study's recordings"
        if self.sha256 is None:
            return None
        if not self.source_path.is_file():
            return f"{self.recording_path} is missing"
        return (
            None
            if _checksum(self.source_path) == self.sha256
            else f"{self.recording_path} {CHECKSUM_MISMATCH_MESSAGE}"
        )

    def copy_file(self) -> bool:
        """Copy the recording atomically. Returns whether the copy is new or differs from an earlier copy.

        Raises:
            StudyError: if the checksum is wrong.
        """
        if self.source_path is None or not self.source_path.is_file():
            return False
        data = self.source_path.read_bytes()
        if self.sha256 not in (None, sha256(data)):
            raise StudyError(f"{self.recording_path} {CHECKSUM_MISMATCH_MESSAGE} after the copy; merge again")
        make_private_folder(self.target_path.parent)
        late = answers_file.answers_path(self.source_path)
        if late.is_file():
            write_atomically(
                answers_file.answers_path(self.target_path), late.read_bytes(), PRIVATE_FILE_MODE
            )
        if self.target_path.is_file() and self.target_path.read_bytes() == data:
            return False
        write_atomically(self.target_path, data, PRIVATE_FILE_MODE)
        return True


def site_recordings(source: SiteStudy, site: int, folder: Path) -> Iterator[SiteRecording]:
    """Yields all recordings of a site. ``site``: number of the site. ``folder``: folder of the merged study."""
    participants = {row["id"]: row["participant"] for row in source.rows_by_table["session"]}
    for row in source.rows_by_table["attempt"]:
        name = row["recording"]
        target = folder / merged_recording_path(name, site)
        yield SiteRecording(
            row["id"],
            participants[row["session"]],
            name,
            _path(source, name),
            target,
            _expected_checksum(row),
        )


def _expected_checksum(row: Row) -> str | None:
    """Returns the stored checksum of an attempt's recording.

    For a completed attempt without a checksum, the result is a text that matches no file.
    """
    return row["sha256"] or ("none" if row["state"] == "completed" else None)


def _path(source: SiteStudy, name: str) -> Path | None:
    if not _IN_RECORDINGS.match(name) or ".." in name.split("/"):
        return None
    try:
        return source.store.absolute_path(name)
    except StudyError:
        return None


def _checksum(path: Path) -> str:
    return sha256(path.read_bytes())


RowsByTable = Mapping[str, Mapping[int, Row]]
"""Rows by table name and primary key."""
_BY_NUMBER = (schema.PARTICIPANT_TABLE, schema.TOMBSTONE_TABLE)
_NAMING_RECORDINGS = {"attempt": "recording", "event": "detail"}


def rows_by_participant(source: SiteStudy, site: int) -> Mapping[int | None, RowsByTable]:
    """Returns the rows of a site with their keys in the merged study, by participant number at the site.

    The key ``None`` contains rows without a participant, and log entries. Deleted participants are omitted.
    """
    found: dict[int | None, dict[str, dict[int, Row]]] = defaultdict(lambda: defaultdict(dict))
    sessions = {row["id"]: row["participant"] for row in source.rows_by_table["session"]}
    for table in MERGED_TABLES:
        for row in source.rows_by_table[table.name] if table is not schema.TOMBSTONE_TABLE else ():
            moved = _moved(table, row, source, site)
            participant = None if table is schema.LOG_TABLE else _participant_of(row, sessions)
            found[participant][table.name][moved[hash_chain.primary_key(table).key]] = moved
    return found


def _participant_of(row: Row, sessions: Mapping[int, int]) -> int | None:
    """Returns the number of the row's participant; ``None`` without a participant."""
    if "enrolled_at" in row:
        return row["number"]
    if row.get("participant") is not None:
        return row["participant"]
    session = row.get("session")
    return None if session is None else sessions[session]


def _moved(table: sa.Table, row: Row, source: SiteStudy, site: int) -> Row:
    """Returns a row of a site with the primary and foreign keys that it has in the merged study."""
    moved = {column.key: _moved_key(column, row[column.key], site) for column in _columns(table)}
    if table is schema.PARTICIPANT_TABLE:
        moved |= {"site": row["site"] or source.name, "site_number": row["number"]}
    if table is schema.LOG_TABLE and row["participant"] is not None:
        moved["participant"] = merged_participant_number(site, row["participant"])
    if name := _NAMING_RECORDINGS.get(table.name):
        moved[name] = merged_recording_path(row[name], site)
    return moved


def _columns(table: sa.Table) -> Iterable[sa.Column[Any]]:
    return (column for column in table.columns if column.key != "salt")


def _moved_key(column: sa.Column[Any], value: Any, site: int) -> Any:
    """Returns the value of a column. Primary and foreign keys become the keys in the merged study."""
    tables = [key.column.table for key in column.foreign_keys] or [column.table] * column.primary_key
    if not tables or value is None:
        return value
    return merged_participant_number(site, value) if tables[0] in _BY_NUMBER else merged_row_id(site, value)


def store_rows(connection: sa.Connection, rows: RowsByTable) -> int:
    """Write new and changed rows into the merged study. Returns the number of written rows."""
    written = 0
    for table in MERGED_TABLES:
        wanted = rows.get(table.name, {})
        present = _present(connection, table, list(wanted))
        for key, row in wanted.items():
            if key not in present:
                hash_chain.insert(connection, table, **row)
            elif present[key] != row:
                hash_chain.update(connection, table, key, **row)
            written += present.get(key) != row
    return written


def _present(connection: sa.Connection, table: sa.Table, keys: list[int]) -> dict[int, Row]:
    columns = list(_columns(table))
    found = connection.execute(sa.select(*columns).where(hash_chain.primary_key(table).in_(keys)))
    rows = [dict(zip([column.key for column in columns], row, strict=True)) for row in found]
    return {row[hash_chain.primary_key(table).key]: row for row in rows}
