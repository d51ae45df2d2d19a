"""The study's database: durable transactions, one writer at a time, and its migrations."""

import json
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from alembic.command import upgrade
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy.event import listens_for
from sqlalchemy.exc import SQLAlchemyError

from avrgym.study.states import StudyError

FILE = "study.db"
BACKUPS = "backups"
URL_VARIABLE = "AVRGYM_STUDY_DATABASE"
MIGRATIONS = Path(__file__).parent / "migrations"
WAIT_S = 60
"""How long a station waits for another one's writing."""
_LOCK = 0x41565247
_PRAGMAS = ("synchronous = FULL", "foreign_keys = ON", "secure_delete = ON")


class Database:
    """A study's database. Every transaction is on disk when it ends, and only one writes at a time."""

    def __init__(self, folder: Path, url: str) -> None:
        """Open it, make its tables or bring them up to date after a backup.

        Args:
            folder: the study's folder, for the file of SQLite and for backups.
            url: that of a PostgreSQL database, or nothing for SQLite.

        Raises:
            StudyError: when it cannot be opened, or was made by a newer version.
        """
        self._folder = folder
        self.is_sqlite = not url
        self._engine = _sqlite_engine(folder / FILE) if self.is_sqlite else _postgresql_engine(url)
        try:
            with self.write() as connection:
                self._migrate(connection)
        except BaseException:
            self.close()
            raise

    @contextmanager
    def read(self) -> Iterator[sa.Connection]:
        """A transaction that sees one moment of the study."""
        with self._begin() as connection:
            if not self.is_sqlite:
                connection.execute(sa.text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ"))
            yield connection

    @contextmanager
    def write(self) -> Iterator[sa.Connection]:
        """A transaction that no other one's writing overlaps; on disk afterwards, or undone by an error."""
        with self._begin(writes=True) as connection:
            if not self.is_sqlite:
                connection.execute(sa.text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
            yield connection

    @contextmanager
    def _begin(self, **options: bool) -> Iterator[sa.Connection]:
        with (
            _database_errors(),
            self._engine.connect().execution_options(**options) as connection,
            connection.begin(),
        ):
            yield connection

    def erase_traces(self) -> None:
        """Overwrite what deleted rows left in the database's own files.

        Raises:
            StudyError: when another process uses the database at the same time; nothing is lost.
        """
        self._engine.dispose()
        with _database_errors():
            if self.is_sqlite:
                _erase_traces_of_sqlite(self._folder / FILE)
            else:
                with self._engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
                    connection.execute(sa.text("VACUUM FULL"))

    def faults(self) -> list[str]:
        """What the database finds wrong with its own file."""
        if not self.is_sqlite:
            return []
        with self.read() as connection:
            found = connection.execute(sa.text("PRAGMA integrity_check")).scalars().all()
        return [text for text in found if text != "ok"]

    def close(self) -> None:
        """Give all connections back."""
        self._engine.dispose()

    def _migrate(self, connection: sa.Connection) -> None:
        scripts = ScriptDirectory(str(MIGRATIONS))
        known = {script.revision for script in scripts.walk_revisions()}
        current = MigrationContext.configure(connection).get_current_revision()
        if current == scripts.get_current_head():
            return
        if current is not None and current not in known:
            raise StudyError(
                f"{self._folder} was made by a newer AVR Gym ({current}); this one knows {', '.join(sorted(known))}"
            )
        if current is not None:
            self._back_up(connection, current)
        configuration = Config()
        configuration.set_main_option("script_location", str(MIGRATIONS))
        configuration.attributes["connection"] = connection
        upgrade(configuration, "head")

    def _back_up(self, connection: sa.Connection, revision: str) -> None:
        """Copy the database as it is: SQLite as a file, others as the rows of all tables."""
        folder = self._folder / BACKUPS
        folder.mkdir(mode=0o700, exist_ok=True)
        moment = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%f")
        path = folder / f"{revision}-{moment}.{'db' if self.is_sqlite else 'json'}"
        if self.is_sqlite:
            _copy_sqlite(self._folder / FILE, path)
        else:
            path.write_text(json.dumps(_all_rows(connection)), encoding="utf-8")


def database_url(configured: str) -> str:
    """The URL of the database to use: the environment variable's, else the design's."""
    url = os.environ.get(URL_VARIABLE, configured)
    if url and not url.startswith("postgresql://"):
        raise StudyError(f"{URL_VARIABLE}: not a database; allowed: postgresql://user@host/name")
    return url


@contextmanager
def _database_errors() -> Iterator[None]:
    try:
        yield
    except (SQLAlchemyError, sqlite3.Error) as error:
        raise StudyError(f"the study's database: {getattr(error, 'orig', None) or error}") from error


def _sqlite_engine(path: Path) -> sa.Engine:
    engine = sa.create_engine(sa.URL.create("sqlite", database=str(path)), connect_args={"timeout": WAIT_S})

    @listens_for(engine, "connect")
    def set_up(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # the driver would begin and commit at moments of its own
        _write_ahead(connection)
        for pragma in _PRAGMAS:
            connection.execute(f"PRAGMA {pragma}")

    @listens_for(engine, "begin")
    def begin(connection: sa.Connection) -> None:
        writes = connection.get_execution_options().get("writes", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def _write_ahead(connection: sqlite3.Connection) -> None:
    """Use a write-ahead log; while another process makes the same new file, SQLite does not wait by itself."""
    ends_s = time.monotonic() + WAIT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > ends_s:
                raise
        time.sleep(0.01)


def _postgresql_engine(url: str) -> sa.Engine:
    try:
        return sa.create_engine(url.replace("postgresql://", "postgresql+psycopg://", 1), pool_pre_ping=True)
    except ModuleNotFoundError as error:
        raise StudyError(
            f"{error.name} is missing; `pip install avrgym[postgresql]` brings what PostgreSQL needs"
        ) from error
    except SQLAlchemyError as error:
        raise StudyError(f"not a database's URL: {error}") from error


def _erase_traces_of_sqlite(path: Path) -> None:
    with closing(sqlite3.connect(path, timeout=WAIT_S, isolation_level=None)) as connection:
        connection.execute("PRAGMA secure_delete = ON")
        connection.execute("VACUUM")
        busy, *_ = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    if busy:
        raise StudyError("the study is in use: stop what uses it and delete again, so that no trace stays")


def _copy_sqlite(source: Path, target: Path) -> None:
    with closing(sqlite3.connect(source)) as old, closing(sqlite3.connect(target)) as new:
        old.backup(new)


def _all_rows(connection: sa.Connection) -> dict[str, list[dict[str, Any]]]:
    tables = sa.MetaData()
    tables.reflect(connection)
    return {
        table.name: [dict(row) for row in connection.execute(sa.select(table)).mappings()]
        for table in tables.sorted_tables
    }
