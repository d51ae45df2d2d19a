"""The database of a study: durable transactions with one writer, hash chain, checksum and migrations."""

import json
import os
import sqlite3
import time
from collections.abc import Collection, Generator, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import sqlalchemy as sa
from alembic.command import stamp, upgrade
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy.exc import DBAPIError, OperationalError, SQLAlchemyError

from avrgym.study.storage import hash_chain, sqlite
from avrgym.study.storage.integrity_files import (
    CHECKSUM_MISMATCH_FILE,
    HASH_CHAIN_HEAD_FILE,
    IntegrityFileError,
    IntegrityFiles,
)
from avrgym.study.storage.participation_list import DATABASE_REBUILT_EVENT, ParticipationList
from avrgym.study.storage.participation_list import PARTICIPATION_LIST_FILE as PARTICIPATION
from avrgym.study.storage.reconciliation import (
    append_transaction_entries,
    compare_database_with_list,
    read_hash_chain_id,
    reconcile_list_and_database,
)
from avrgym.study.storage.schema import EVENT_TABLE, METADATA, PARTICIPANT_TABLE, SITE_TABLE, TOMBSTONE_TABLE
from avrgym.study.storage.state_transitions import LostConnectionError, StudyError
from avrgym.study.storage.study_folder import find_database_traces
from avrgym.system.files import make_private_folder, write_private_file

DATABASE_FILE = "study.db"
BACKUP_FOLDER = "backups"
"""Folder of backups before migrations, relative to the study's folder."""
CHECKSUM_LOCK_TIMEOUT_S = 1.0
"""Maximum time in seconds to wait for the database lock when the checksum is stored."""
RECONNECT_TIMEOUT_S, RECONNECT_INTERVAL_S = 30.0, 0.2
"""Maximum time in seconds to wait for a restart of PostgreSQL, and interval between two attempts to connect."""
DATABASE_URL_VARIABLE = "AVRGYM_STUDY_DATABASE"
"""Environment variable with the database URL. It replaces the URL in ``study.toml``."""
MIGRATIONS_FOLDER = Path(__file__).parent / "migrations"
"""Folder of the Alembic migrations."""
OLDEST_MIGRATION_REVISION = "0006_headset_check"
"""Database revision of AVR Gym 0.2.0, the first release."""
UNRELEASED_MIGRATION_REVISIONS = ("0007_records", "0008_log", "0009_consents", "0010_design")
"""Revisions of development versions. One migration upgrades them and revision ``OLDEST_MIGRATION_REVISION``."""
_LOCK = 0x41565247


class StudyDatabase:
    """The database of a study. A transaction is on disk when it ends. Write transactions never overlap.

    ``read_only``: the folder is read-only; SQLite then reads a copy of the database.
    """

    def __init__(self, folder: Path, url: str, *, read_only: bool = False, rebuild: bool = False) -> None:
        """Open the database. If needed, create its tables, or back it up and upgrade its tables.

        Args:
            folder: the study's folder.
            url: URL of a PostgreSQL database; empty for SQLite.
            read_only: reject write transactions.
            rebuild: create a database even if an earlier one was lost.

        Raises:
            StudyError: if the database cannot be opened, was lost, or has a newer revision.
        """
        if not url and not rebuild and not (folder / DATABASE_FILE).exists():
            _refuse_if_lost(folder, DATABASE_FILE)
        self._folder, self.is_read_only = folder, read_only
        self.is_sqlite = not url
        self._integrity = IntegrityFiles(folder, DATABASE_FILE)
        self.participation_list = ParticipationList(folder)
        self._wrote, self._rebuild, self._was_reached = False, rebuild, False
        self._held = ExitStack()
        self._path = self._readable_copy() if self.is_sqlite and read_only else folder / DATABASE_FILE
        self._engine = sqlite.make_engine(self._path) if self.is_sqlite else _postgresql_engine(url)
        try:
            self._upgrade()
            self._refuse_if_emptied()
        except BaseException:
            self.close()
            raise

    @contextmanager
    def read_transaction(self) -> Generator[sa.Connection]:
        """Context manager: a read transaction on a consistent snapshot of the database."""
        with self._begin() as connection:
            if not self.is_sqlite:
                connection.execute(sa.text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ"))
            yield connection

    @contextmanager
    def write_transaction(self) -> Generator[sa.Connection]:
        """Context manager: a write transaction. It is committed at the end, or rolled back after an error.

        Rows must be written with the functions of ``hash_chain``. Raises ``StudyError`` if the folder is read-only.
        """
        if self.is_read_only:
            raise StudyError(f"{self._folder} cannot be written: copy the study to a writable folder")
        with self._write() as connection:
            yield connection

    @contextmanager
    def _write(self) -> Generator[sa.Connection]:
        with self._lock() as connection:
            self._invalidate_checksum(connection)
            hash_chain.start_collecting_written_rows(connection)
            yield connection
            written = hash_chain.list_written_row_keys(connection)
            head = hash_chain.append_chain_entries(connection)
            if not self.is_read_only:
                append_transaction_entries(self.participation_list, connection, written)
        if head is not None and not self.is_read_only:
            self._integrity.append_chain_head(head)

    @contextmanager
    def _lock(self, **options: float) -> Generator[sa.Connection]:
        """Context manager: a transaction that holds the write lock."""
        with self._begin(writes=True, **options) as connection:
            if not self.is_sqlite:
                connection.execute(sa.text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
            yield connection

    @contextmanager
    def _begin(self, **options: float) -> Generator[sa.Connection]:
        with (
            _database_errors(),
            self._connect().execution_options(**options) as connection,
            connection.begin(),
        ):
            self._was_reached = True
            yield connection

    def _connect(self) -> sa.Connection:
        """Returns a connection. Waits for PostgreSQL, if this process was connected to it before."""
        ends_s = time.monotonic() + RECONNECT_TIMEOUT_S
        while True:
            try:
                return self._engine.connect()
            except OperationalError as error:
                if self.is_sqlite or not self._was_reached:
                    raise
                if time.monotonic() > ends_s:
                    raise LostConnectionError(
                        f"the study's database cannot be reached: {error.orig or error}; check the database server"
                    ) from error
            time.sleep(RECONNECT_INTERVAL_S)

    def reconcile_participation(self) -> None:
        """Make the participation list and the database consistent; see ``reconciliation``."""
        if self.is_read_only:
            return
        try:
            with self.read_transaction() as connection:
                differs = bool(compare_database_with_list(self.participation_list, connection))
        except StudyError:  # a check reports unreadable rows
            return
        if differs:
            with self._write() as connection:
                reconcile_list_and_database(self.participation_list, connection)
        self.participation_list.store_last_entry()

    def erase_deleted_data(self) -> None:
        """Overwrite the contents of deleted rows in the database's files.

        Raises:
            StudyError: if another process uses the database. The deleted contents then remain on disk.
        """
        with self._lock() as connection:
            self._invalidate_checksum(connection)
        self._engine.dispose()
        with _database_errors():
            if self.is_sqlite:
                sqlite.erase_deleted_data(self._path)
            else:
                with self._engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
                    connection.execute(sa.text("VACUUM FULL"))

    def find_integrity_errors(self) -> list[tuple[str, str]]:
        """Returns the errors of the database, its rows and its integrity files, as pairs: place, message."""
        faults = [*self._integrity_faults(), *self._file_faults()]
        with self.read_transaction() as connection:
            faults += hash_chain.find_hash_chain_errors(connection)
        return faults

    def read_chain_head(self) -> hash_chain.HashChainHead:
        """Returns the head of the hash chain: number and digest of its last entry."""
        with self.read_transaction() as connection:
            return hash_chain.read_chain_head(connection)

    def close(self) -> None:
        """Store the checksum of the database, and close all connections."""
        if self._wrote:
            with suppress(StudyError, OSError):  # a missing checksum is not an error
                self._store_integrity()
        self._engine.dispose()
        self._held.close()

    def _readable_copy(self) -> Path:
        folder = Path(self._held.enter_context(TemporaryDirectory(prefix="avrgym-study-")))
        sqlite.copy_closed_database(self._folder / DATABASE_FILE, folder)
        self._checksum_at_rest = None
        if (folder / DATABASE_FILE).exists():
            with _database_errors():
                self._checksum_at_rest = sqlite.compute_closed_database_checksum(folder / DATABASE_FILE)
        return folder / DATABASE_FILE

    # Integrity files

    def _invalidate_checksum(self, connection: sa.Connection) -> None:
        """Remove the stored checksum before a write."""
        if self.is_sqlite and not self.is_read_only:
            self._integrity.invalidate_checksum(lambda: sqlite.compute_database_checksum(connection))
        self._wrote = not self.is_read_only

    def _store_integrity(self) -> None:
        """Store the file's checksum and the head of the hash chain. Stored heads that the chain lacks remain."""
        with self._lock(wait_s=CHECKSUM_LOCK_TIMEOUT_S) as connection:
            with suppress(IntegrityFileError):
                ends = hash_chain.find_missing_chain_heads(
                    connection, self._integrity.read_chain_heads() or ()
                )
                self._integrity.replace_chain_heads(
                    [*ends, *({hash_chain.read_chain_head(connection)} - {hash_chain.HashChainHead()})]
                )
            if self.is_sqlite:
                self._integrity.set_checksum(sqlite.compute_database_checksum(connection))

    def _checksum(self, connection: sa.Connection) -> str | None:
        return self._checksum_at_rest if self.is_read_only else sqlite.compute_database_checksum(connection)

    def _integrity_faults(self) -> Iterator[tuple[str, str]]:
        try:
            heads = self._integrity.read_chain_heads()
            with self._lock() as connection:
                if self.is_sqlite and self._integrity.stored_database_checksum not in (
                    None,
                    self._checksum(connection),
                ):
                    yield DATABASE_FILE, "was changed by another program: its checksum differs"
                known = hash_chain.read_chain_head(connection)
                lost = hash_chain.find_missing_chain_heads(connection, heads or ())
        except (IntegrityFileError, StudyError) as error:
            yield "database", str(error)
            return
        if self._integrity.has_checksum_mismatch:
            yield (
                DATABASE_FILE,
                f"had been changed by another program; find the cause, then remove {CHECKSUM_MISMATCH_FILE}",
            )
        if lost:
            yield (
                "ledger",
                f"ends with entry {known.number} and lacks an entry in {HASH_CHAIN_HEAD_FILE}: an older copy "
                f"replaced it",
            )
        if heads is None and self.is_sqlite and known.number:
            yield HASH_CHAIN_HEAD_FILE, "is missing: whether the last rows were lost is unknown"

    def _file_faults(self) -> Iterator[tuple[str, str]]:
        if not self.is_sqlite:
            return
        try:
            with self.read_transaction() as connection:
                yield from (("database", fault) for fault in sqlite.find_sqlite_errors(connection))
        except StudyError as error:
            yield "database", str(error)

    # Migrations

    def _upgrade(self) -> None:
        with self.read_transaction() as connection:
            current = MigrationContext.configure(connection).get_current_revision()
        if current == _scripts(MIGRATIONS_FOLDER).get_current_head():
            return
        if self.is_read_only and not self.is_sqlite:
            raise StudyError(
                f"{self._folder} is read-only, but the study's tables must be upgraded; make it writable"
            )
        with self._write() as connection:
            self._migrate(connection)

    def _refuse_if_emptied(self) -> None:
        """Raises ``StudyError`` if the tables are empty because an earlier database was lost."""
        if self._rebuild:
            return
        try:
            with self.read_transaction() as connection:
                is_filled = bool(connection.execute(_SOMEBODY).scalar())
                begun_with = None if is_filled else read_hash_chain_id(connection)
        except StudyError:  # a check reports unreadable tables
            return
        if is_filled:
            return
        listed = self.participation_list.read_entries()
        is_own = listed is None or not listed.entries or begun_with in listed.hash_chain_ids
        _refuse_if_lost(
            self._folder,
            self._called,
            ignored=(HASH_CHAIN_HEAD_FILE, PARTICIPATION) if is_own else (HASH_CHAIN_HEAD_FILE,),
        )

    @property
    def _called(self) -> str:
        return DATABASE_FILE if self.is_sqlite else "the database of PostgreSQL"

    def _migrate(self, connection: sa.Connection) -> None:
        scripts, context = _scripts(MIGRATIONS_FOLDER), MigrationContext.configure(connection)
        known = sorted(
            {*UNRELEASED_MIGRATION_REVISIONS, *(script.revision for script in scripts.walk_revisions())}
        )
        current = context.get_current_revision()
        if current == scripts.get_current_head():
            return
        if current is None:
            if not self._rebuild:
                _refuse_if_lost(self._folder, self._called)
            METADATA.create_all(connection)
            context.stamp(scripts, "head")
            return
        if current not in known:
            raise StudyError(
                f"{self._folder}: the database has revision {current}; allowed: {', '.join(known)}. Use the version "
                "of AVR Gym that wrote it"
            )
        if not self.is_read_only:
            self._back_up(connection, current)
        configuration = Config()
        configuration.set_main_option("script_location", str(MIGRATIONS_FOLDER))
        configuration.attributes["connection"] = connection
        if current in UNRELEASED_MIGRATION_REVISIONS:
            stamp(configuration, OLDEST_MIGRATION_REVISION, purge=True)
        upgrade(configuration, "head")

    def _back_up(self, connection: sa.Connection, revision: str) -> None:
        """Back up the database: the SQLite file, or the rows of all tables as JSON."""
        folder = self._folder / BACKUP_FOLDER
        make_private_folder(folder)
        moment = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%f")
        path = folder / f"{revision}-{moment}.{'db' if self.is_sqlite else 'json'}"
        if self.is_sqlite:
            sqlite.back_up_database(self._path, path)
        else:
            write_private_file(path, json.dumps(_all_rows(connection)))


@cache
def _scripts(folder: Path) -> ScriptDirectory:
    return ScriptDirectory(str(folder))


def find_database_url(configured: str) -> str:
    """Returns the URL of the study's database: the environment variable, or the design's URL if it is not set."""
    url = os.environ.get(DATABASE_URL_VARIABLE, configured)
    if url and not url.startswith("postgresql://"):
        raise StudyError(
            f"{DATABASE_URL_VARIABLE} is not a database URL; allowed: postgresql://user@host/name"
        )
    return url


_SOMEBODY = sa.select(
    sa.or_(
        sa.exists(sa.select(PARTICIPANT_TABLE.c.number)),
        sa.exists(sa.select(TOMBSTONE_TABLE.c.number)),
        sa.exists(sa.select(SITE_TABLE.c.number)),
        sa.exists(sa.select(EVENT_TABLE.c.id).where(EVENT_TABLE.c.name == DATABASE_REBUILT_EVENT)),
    )
)
"""Query: whether the database contains participants, deleted participants or sites, or was rebuilt."""


def _refuse_if_lost(folder: Path, database: str, ignored: Collection[str] = ()) -> None:
    """Raises ``StudyError`` if the folder contains traces of an earlier database that are not in ``ignored``."""
    traces = [each for each in find_database_traces(folder) if each not in ignored]
    if traces:
        raise StudyError(
            f"{folder}: {database} is missing or empty, but there are {' and '.join(traces)}: restore a backup, or run "
            f"`avrgym study rebuild {folder}` to rebuild it from the recordings"
        )


@contextmanager
def _database_errors() -> Generator[None]:
    try:
        yield
    except (SQLAlchemyError, sqlite3.Error, UnicodeError, json.JSONDecodeError) as error:
        lost = isinstance(error, DBAPIError) and error.connection_invalidated
        kind = LostConnectionError if lost else StudyError
        raise kind(f"the study's database: {getattr(error, 'orig', None) or error}") from error


def _postgresql_engine(url: str) -> sa.Engine:
    try:
        return sa.create_engine(url.replace("postgresql://", "postgresql+psycopg://", 1), pool_pre_ping=True)
    except ModuleNotFoundError as error:
        raise StudyError(f"{error.name} is missing; run `pip install avrgym[postgresql]`") from error
    except SQLAlchemyError as error:
        raise StudyError(f"invalid database URL: {error}; allowed: postgresql://user@host/name") from error


def _all_rows(connection: sa.Connection) -> dict[str, list[dict[str, Any]]]:
    tables = sa.MetaData()
    tables.reflect(connection)
    return {
        table.name: [dict(row) for row in connection.execute(sa.select(table)).mappings()]
        for table in tables.sorted_tables
    }
