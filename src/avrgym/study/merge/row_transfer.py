"""Copy rows and recordings of a site into the merged study."""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from avrgym.recording import answers_file
from avrgym.study.merge.site_studies import MERGED_TABLES, RowValues, SiteStudy
from avrgym.study.plan.frozen_plan import compute_sha256
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.attempts import CHECKSUM_MISMATCH_MESSAGE
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER, format_pseudonym, parse_participant_number
from avrgym.study.storage.sites import compute_merged_participant_number, compute_merged_row_id
from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.files import PRIVATE_FILE_MODE, make_private_folder, write_atomically

_IN_RECORDINGS = re.compile(rf"{RECORDINGS_FOLDER}/(sub-[0-9]{{3,9}})/")


def make_merged_recording_path(text: str, site: int) -> str:
    """Returns the path of a recording in the merged study. Text after the path, and other texts, are not changed.

    ``text``: text that begins with the path at the site. ``site``: number of the site.
    """
    match = _IN_RECORDINGS.match(text)
    if match is None:
        return text
    pseudonym = format_pseudonym(compute_merged_participant_number(site, parse_participant_number(match[1])))
    return f"{RECORDINGS_FOLDER}/{pseudonym}/{text[match.end() :]}"


@dataclass(frozen=True)
class SiteRecording:
    """A recording of a site.

    ``attempt_id``: attempt id at the site. ``participant_number``: participant number at the site. ``recording_path``:
    path in the site's study. ``source_path``: absolute path; ``None`` if it is outside the recordings. ``target_path``:
    path in the merged study. ``recording_sha256``: expected checksum; ``None`` if the file may be missing.
    """

    attempt_id: int
    participant_number: int
    recording_path: str
    source_path: Path | None
    target_path: Path
    recording_sha256: str | None

    def is_copied(self) -> bool:
        """Returns whether the merged study contains the recording with the correct checksum."""
        return (
            self.recording_sha256 is not None
            and self.target_path.is_file()
            and _checksum(self.target_path) == self.recording_sha256
        )

    def find_copy_error(self) -> str | None:
        """Returns the reason why the recording cannot be copied; ``None`` if it can be copied.

        The message begins with the recording's name.
        """
        if self.source_path is None:
            return f"{self.recording_path} is outside the study's recordings"
        if self.recording_sha256 is None:
            return None
        if not self.source_path.is_file():
            return f"{self.recording_path} is missing"
        return (
            None
            if _checksum(self.source_path) == self.recording_sha256
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
        if self.recording_sha256 not in (None, compute_sha256(data)):
            raise StudyError(f"{self.recording_path} {CHECKSUM_MISMATCH_MESSAGE} after the copy; merge again")
        make_private_folder(self.target_path.parent)
        late = answers_file.get_answers_path(self.source_path)
        if late.is_file():
            write_atomically(
                answers_file.get_answers_path(self.target_path), late.read_bytes(), PRIVATE_FILE_MODE
            )
        if self.target_path.is_file() and self.target_path.read_bytes() == data:
            return False
        write_atomically(self.target_path, data, PRIVATE_FILE_MODE)
        return True


def list_site_recordings(source: SiteStudy, site: int, folder: Path) -> Iterator[SiteRecording]:
    """Yields all recordings of a site. ``site``: number of the site. ``folder``: folder of the merged study."""
    participants = {row["id"]: row["participant"] for row in source.rows_by_table["session"]}
    for row in source.rows_by_table["attempt"]:
        name = row["recording"]
        target = folder / make_merged_recording_path(name, site)
        yield SiteRecording(
            row["id"],
            participants[row["session"]],
            name,
            _path(source, name),
            target,
            _expected_checksum(row),
        )


def _expected_checksum(row: RowValues) -> str | None:
    """Returns the stored checksum of an attempt's recording.

    For a completed attempt without a checksum, the result is a text that matches no file.
    """
    return row["sha256"] or ("none" if row["state"] == "completed" else None)


def _path(source: SiteStudy, name: str) -> Path | None:
    if not _IN_RECORDINGS.match(name) or ".." in name.split("/"):
        return None
    try:
        return source.store.resolve_path(name)
    except StudyError:
        return None


def _checksum(path: Path) -> str:
    return compute_sha256(path.read_bytes())


RowsByTable = Mapping[str, Mapping[int, RowValues]]
"""Rows by table name and primary key."""
_BY_NUMBER = (schema.PARTICIPANT_TABLE, schema.TOMBSTONE_TABLE)
_NAMING_RECORDINGS = {"attempt": "recording", "event": "detail"}


def group_rows_by_participant(source: SiteStudy, site: int) -> Mapping[int | None, RowsByTable]:
    """Returns the rows of a site with their keys in the merged study, by participant number at the site.

    The key ``None`` contains rows without a participant, and log entries. Deleted participants are omitted.
    """
    found: dict[int | None, dict[str, dict[int, RowValues]]] = defaultdict(lambda: defaultdict(dict))
    sessions = {row["id"]: row["participant"] for row in source.rows_by_table["session"]}
    for table in MERGED_TABLES:
        for row in source.rows_by_table[table.name] if table is not schema.TOMBSTONE_TABLE else ():
            moved = _moved(table, row, source, site)
            participant = None if table is schema.AUDIT_LOG_TABLE else _participant_of(row, sessions)
            found[participant][table.name][moved[hash_chain.find_primary_key_column(table).key]] = moved
    return found


def _participant_of(row: RowValues, sessions: Mapping[int, int]) -> int | None:
    """Returns the number of the row's participant; ``None`` without a participant."""
    if "enrolled_at" in row:
        return row["number"]
    if row.get("participant") is not None:
        return row["participant"]
    session = row.get("session")
    return None if session is None else sessions[session]


def _moved(table: sa.Table, row: RowValues, source: SiteStudy, site: int) -> RowValues:
    """Returns a row of a site with the primary and foreign keys that it has in the merged study."""
    moved = {column.key: _moved_key(column, row[column.key], site) for column in _columns(table)}
    if table is schema.PARTICIPANT_TABLE:
        moved |= {"site": row["site"] or source.site_name, "site_number": row["number"]}
    if table is schema.AUDIT_LOG_TABLE and row["participant"] is not None:
        moved["participant"] = compute_merged_participant_number(site, row["participant"])
    if name := _NAMING_RECORDINGS.get(table.name):
        moved[name] = make_merged_recording_path(row[name], site)
    return moved


def _columns(table: sa.Table) -> Iterable[sa.Column[Any]]:
    return (column for column in table.columns if column.key != "salt")


def _moved_key(column: sa.Column[Any], value: Any, site: int) -> Any:
    """Returns the value of a column. Primary and foreign keys become the keys in the merged study."""
    tables = [key.column.table for key in column.foreign_keys] or [column.table] * column.primary_key
    if not tables or value is None:
        return value
    return (
        compute_merged_participant_number(site, value)
        if tables[0] in _BY_NUMBER
        else compute_merged_row_id(site, value)
    )


def write_merged_rows(connection: sa.Connection, rows: RowsByTable) -> int:
    """Write new and changed rows into the merged study. Returns the number of written rows."""
    written = 0
    for table in MERGED_TABLES:
        wanted = rows.get(table.name, {})
        present = _present(connection, table, list(wanted))
        for key, row in wanted.items():
            if key not in present:
                hash_chain.insert_row(connection, table, **row)
            elif present[key] != row:
                hash_chain.update_row(connection, table, key, **row)
            written += present.get(key) != row
    return written


def _present(connection: sa.Connection, table: sa.Table, keys: list[int]) -> dict[int, RowValues]:
    columns = list(_columns(table))
    found = connection.execute(sa.select(*columns).where(hash_chain.find_primary_key_column(table).in_(keys)))
    rows = [dict(zip([column.key for column in columns], row, strict=True)) for row in found]
    return {row[hash_chain.find_primary_key_column(table).key]: row for row in rows}
