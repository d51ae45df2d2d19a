"""The study's database: durable transactions, one writer at a time, its ledger, seal and migrations."""

import json
import os
import sqlite3
from collections.abc import Collection, Generator, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import sqlalchemy as sa
from alembic.command import stamp, upgrade
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy.exc import SQLAlchemyError

from avrgym.study.storage import hash_chain, sqlite
from avrgym.study.storage.integrity_files import HEAD, MISMATCH, IntegrityFileError, IntegrityFiles
from avrgym.study.storage.participation import FILE as PARTICIPATION
from avrgym.study.storage.participation import REBUILT, ParticipationList
from avrgym.study.storage.reconciliation import append_transaction, chain_id, compare, reconcile
from avrgym.study.storage.schema import EVENT, METADATA, PARTICIPANT, SITE, TOMBSTONE
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.study_folder import traces_of_database
from avrgym.system.files import make_private_folder, write_new

FILE = "study.db"
BACKUPS = "backups"
CHECKSUM_WAIT_S = 1.0
"""How long a process that ends waits to seal a database that another one holds."""
URL_VARIABLE = "AVRGYM_STUDY_DATABASE"
MIGRATIONS = Path(__file__).parent / "migrations"
OLDEST = "0006_headset_check"
"""The revision of 0.2.0, the first released version."""
UNRELEASED = ("0007_records", "0008_log", "0009_consents", "0010_design")
"""Revisions of development versions, which are upgraded in one step with those of 0.2.0."""
_LOCK = 0x41565247


class Database:
    """A study's database. Every transaction is on disk when it ends, and only one writes at a time.

    ``read_only``: nothing can be written where it lies; SQLite's file is then read from a copy.
    """

    def __init__(self, folder: Path, url: str, *, read_only: bool = False, anew: bool = False) -> None:
        """Open it, make its tables or bring them up to date after a backup.

        Args:
            folder: the study's folder, for the file of SQLite, the seal and backups.
            url: that of a PostgreSQL database, or nothing for SQLite.
            read_only: refuse to write.
            anew: make it also where there was one before.

        Raises:
            StudyError: when it cannot be opened, was lost, or was made by a newer version.
        """
        if not url and not anew and not (folder / FILE).exists():
            _refuse_if_lost(folder, FILE)
        self._folder, self.read_only = folder, read_only
        self.is_sqlite = not url
        self._seal = IntegrityFiles(folder, FILE)
        self.participation = ParticipationList(folder)
        self._wrote, self._anew = False, anew
        self._held = ExitStack()
        self._path = self._readable_copy() if self.is_sqlite and read_only else folder / FILE
        self._engine = sqlite.make_engine(self._path) if self.is_sqlite else _postgresql_engine(url)
        try:
            self._bring_up_to_date()
            self._refuse_if_emptied()
        except BaseException:
            self.close()
            raise

    @contextmanager
    def read(self) -> Generator[sa.Connection]:
        """A transaction that sees one moment of the study."""
        with self._begin() as connection:
            if not self.is_sqlite:
                connection.execute(sa.text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ"))
            yield connection

    @contextmanager
    def write(self) -> Generator[sa.Connection]:
        """A transaction that no other one's writing overlaps; on disk afterwards, or undone by an error.

        Rows are written with ``ledger``'s functions, or count as changed by something else.
        """
        if self.read_only:
            raise StudyError(f"{self._folder} cannot be written: the study is only read there")
        with self._write() as connection:
            yield connection

    @contextmanager
    def _write(self) -> Generator[sa.Connection]:
        with self._lock() as connection:
            self._unseal(connection)
            hash_chain.begin_transaction(connection)
            yield connection
            written = hash_chain.written_rows(connection)
            head = hash_chain.append_entries(connection)
            if not self.read_only:
                append_transaction(self.participation, connection, written)
        if head is not None and not self.read_only:
            self._seal.note(head)

    @contextmanager
    def _lock(self, **options: float) -> Generator[sa.Connection]:
        """A transaction of which there is one at a time."""
        with self._begin(writes=True, **options) as connection:
            if not self.is_sqlite:
                connection.execute(sa.text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
            yield connection

    @contextmanager
    def _begin(self, **options: float) -> Generator[sa.Connection]:
        with (
            _database_errors(),
            self._engine.connect().execution_options(**options) as connection,
            connection.begin(),
        ):
            yield connection

    def reconcile(self) -> None:
        """Bring the database and the participation list into agreement, where they are not."""
        if self.read_only:
            return
        try:
            with self.read() as connection:
                differs = bool(compare(self.participation, connection))
        except StudyError:  # rows that cannot be read: a check names them
            return
        if differs:
            with self._write() as connection:
                reconcile(self.participation, connection)
        self.participation.remember_end()

    def erase_traces(self) -> None:
        """Overwrite what deleted rows left in the database's own files.

        Raises:
            StudyError: when another process uses the database at the same time; nothing is lost.
        """
        with self._lock() as connection:
            self._unseal(connection)
        self._engine.dispose()
        with _database_errors():
            if self.is_sqlite:
                sqlite.erase_traces(self._path)
            else:
                with self._engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
                    connection.execute(sa.text("VACUUM FULL"))

    def faults(self) -> list[tuple[str, str]]:
        """Where, and what is wrong with the database: its file, its rows, or what stands beside it."""
        faults = [*self._faults_of_seal(), *self._faults_of_file()]
        with self.read() as connection:
            faults += hash_chain.faults(connection)
        return faults

    def head(self) -> hash_chain.Head:
        """The end of the ledger's chain."""
        with self.read() as connection:
            return hash_chain.head(connection)

    def close(self) -> None:
        """Seal what was written, and give all connections back."""
        if self._wrote:
            with suppress(
                StudyError, OSError
            ):  # without a seal there is less to be noticed, and nothing wrong
                self._set_seal()
        self._engine.dispose()
        self._held.close()

    def _readable_copy(self) -> Path:
        folder = Path(self._held.enter_context(TemporaryDirectory(prefix="avrgym-study-")))
        sqlite.copy_at_rest(self._folder / FILE, folder)
        self._checksum_at_rest = None
        if (folder / FILE).exists():
            with _database_errors():
                self._checksum_at_rest = sqlite.checksum_at_rest(folder / FILE)
        return folder / FILE

    # Seal

    def _unseal(self, connection: sa.Connection) -> None:
        """Before something is written."""
        if self.is_sqlite and not self.read_only:
            self._seal.remove_checksum(lambda: sqlite.database_checksum(connection))
        self._wrote = not self.read_only

    def _set_seal(self) -> None:
        """Note only the last end of the chain, and any that it has lost; and the checksum of the file.

        For the last transaction of this process: it waits for no other for long.
        """
        with self._lock(wait_s=CHECKSUM_WAIT_S) as connection:
            with suppress(IntegrityFileError):
                ends = hash_chain.missing_heads(connection, self._seal.heads() or ())
                self._seal.set_heads([*ends, *({hash_chain.head(connection)} - {hash_chain.Head()})])
            if self.is_sqlite:
                self._seal.set_checksum(sqlite.database_checksum(connection))

    def _checksum(self, connection: sa.Connection) -> str | None:
        return self._checksum_at_rest if self.read_only else sqlite.database_checksum(connection)

    def _faults_of_seal(self) -> Iterator[tuple[str, str]]:
        try:
            heads = self._seal.heads()
            with self._lock() as connection:
                if self.is_sqlite and self._seal.checksum not in (None, self._checksum(connection)):
                    yield FILE, "was changed by another program: its checksum is another"
                known = hash_chain.head(connection)
                lost = hash_chain.missing_heads(connection, heads or ())
        except (IntegrityFileError, StudyError) as error:
            yield "database", str(error)
            return
        if self._seal.mismatch:
            yield (
                FILE,
                f"had been changed by another program; remove {MISMATCH} once that is clear",
            )
        if lost:
            yield "ledger", f"ends with entry {known.number} and lacks what {HEAD} tells of: it was set back"
        if heads is None and self.is_sqlite and known.number:
            yield HEAD, "is missing: whether the last rows were lost cannot be told"

    def _faults_of_file(self) -> Iterator[tuple[str, str]]:
        if not self.is_sqlite:
            return
        try:
            with self.read() as connection:
                yield from (("database", fault) for fault in sqlite.faults(connection))
        except StudyError as error:
            yield "database", str(error)

    # Migrations

    def _bring_up_to_date(self) -> None:
        with self.read() as connection:
            current = MigrationContext.configure(connection).get_current_revision()
        if current == ScriptDirectory(str(MIGRATIONS)).get_current_head():
            return
        if self.read_only and not self.is_sqlite:
            raise StudyError(
                f"{self._folder} cannot be written, and the study's tables must be brought up to date"
            )
        with self._write() as connection:
            self._migrate(connection)

    def _refuse_if_emptied(self) -> None:
        """Refuse tables without anybody where others were lost, as a rebuilding that broke off leaves them."""
        if self._anew:
            return
        try:
            with self.read() as connection:
                is_filled = bool(connection.execute(_SOMEBODY).scalar())
                begun_with = None if is_filled else chain_id(connection)
        except StudyError:  # tables that cannot be read: a check names them
            return
        if is_filled:
            return
        listed = self.participation.read()
        is_own = listed is None or not listed.entries or begun_with in listed.ledgers
        _refuse_if_lost(self._folder, self._called, but=(HEAD, PARTICIPATION) if is_own else (HEAD,))

    @property
    def _called(self) -> str:
        return FILE if self.is_sqlite else "the database of PostgreSQL"

    def _migrate(self, connection: sa.Connection) -> None:
        scripts = ScriptDirectory(str(MIGRATIONS))
        known = sorted({*UNRELEASED, *(script.revision for script in scripts.walk_revisions())})
        current = MigrationContext.configure(connection).get_current_revision()
        if current == scripts.get_current_head():
            return
        configuration = Config()
        configuration.set_main_option("script_location", str(MIGRATIONS))
        configuration.attributes["connection"] = connection
        if current is None:
            if not self._anew:
                _refuse_if_lost(self._folder, self._called)
            METADATA.create_all(connection)
            stamp(configuration, "head")
            return
        if current not in known:
            raise StudyError(
                f"{self._folder}: the database has revision {current}; allowed: {', '.join(known)}. Use the version "
                "of AVR Gym that wrote it"
            )
        if not self.read_only:
            self._back_up(connection, current)
        if current in UNRELEASED:
            stamp(configuration, OLDEST, purge=True)
        upgrade(configuration, "head")

    def _back_up(self, connection: sa.Connection, revision: str) -> None:
        """Copy the database as it is: SQLite as a file, others as the rows of all tables."""
        folder = self._folder / BACKUPS
        make_private_folder(folder)
        moment = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%f")
        path = folder / f"{revision}-{moment}.{'db' if self.is_sqlite else 'json'}"
        if self.is_sqlite:
            sqlite.back_up(self._path, path)
        else:
            write_new(path, json.dumps(_all_rows(connection)))


def database_url(configured: str) -> str:
    """The URL of the database to use: the environment variable's, else the design's."""
    url = os.environ.get(URL_VARIABLE, configured)
    if url and not url.startswith("postgresql://"):
        raise StudyError(f"{URL_VARIABLE}: not a database; allowed: postgresql://user@host/name")
    return url


_SOMEBODY = sa.select(
    sa.or_(
        sa.exists(sa.select(PARTICIPANT.c.number)),
        sa.exists(sa.select(TOMBSTONE.c.number)),
        sa.exists(sa.select(SITE.c.number)),
        sa.exists(sa.select(EVENT.c.id).where(EVENT.c.name == REBUILT)),
    )
)
"""Whether a database has or had participants, is that of a merge, or was rebuilt and found none."""


def _refuse_if_lost(folder: Path, database: str, but: Collection[str] = ()) -> None:
    """Raise ``StudyError`` rather than make a new database beside what one left; ``but`` is no sign of one."""
    left = [each for each in traces_of_database(folder) if each not in but]
    if left:
        raise StudyError(
            f"{folder}: {database} is lost or empty, but there are {' and '.join(left)}: put back a copy of it, or "
            f"make it anew from the recordings with `avrgym study rebuild {folder}`"
        )


@contextmanager
def _database_errors() -> Generator[None]:
    try:
        yield
    except (SQLAlchemyError, sqlite3.Error, UnicodeError, json.JSONDecodeError) as error:
        raise StudyError(f"the study's database: {getattr(error, 'orig', None) or error}") from error


def _postgresql_engine(url: str) -> sa.Engine:
    try:
        return sa.create_engine(url.replace("postgresql://", "postgresql+psycopg://", 1), pool_pre_ping=True)
    except ModuleNotFoundError as error:
        raise StudyError(
            f"{error.name} is missing; `pip install avrgym[postgresql]` brings what PostgreSQL needs"
        ) from error
    except SQLAlchemyError as error:
        raise StudyError(f"not a database's URL: {error}") from error


def _all_rows(connection: sa.Connection) -> dict[str, list[dict[str, Any]]]:
    tables = sa.MetaData()
    tables.reflect(connection)
    return {
        table.name: [dict(row) for row in connection.execute(sa.select(table)).mappings()]
        for table in tables.sorted_tables
    }
