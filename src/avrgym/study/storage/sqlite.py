"""SQLite databases: durable connections with a write-ahead log (WAL), checksums, copies and secure deletion."""

import hashlib
import shutil
import sqlite3
import time
from contextlib import closing, suppress
from functools import cache
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.event import listens_for

from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.files import open_privately

LOCK_TIMEOUT_S = 60
"""Maximum time in seconds to wait for the write lock."""
_LOG = "-wal"
_PRAGMAS = ("synchronous = FULL", "foreign_keys = ON", "secure_delete = ON")
_COMPILED: dict[Any, Any] = {}
"""Compiled SQL statements, shared by all databases of the process."""


def make_engine(path: Path) -> sa.Engine:
    """Returns an SQLAlchemy engine for a database file. A missing file is created; only its owner can read it."""
    with suppress(FileExistsError):
        open(path, "xb", opener=open_privately).close()
    template = _template()

    def connect() -> Any:
        return sqlite3.connect(path, timeout=LOCK_TIMEOUT_S, check_same_thread=False)

    pool = sa.QueuePool(connect, dialect=template.dialect)
    engine = sa.Engine(pool, template.dialect, sa.URL.create("sqlite", database=str(path)))
    engine.update_execution_options(compiled_cache=_COMPILED)

    @listens_for(engine, "connect")
    def set_up(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # the driver starts no transactions itself
        _write_ahead(connection)
        for pragma in _PRAGMAS:
            connection.execute(f"PRAGMA {pragma}")

    @listens_for(engine, "begin")
    def begin(connection: sa.Connection) -> None:
        options = connection.get_execution_options()
        if "wait_s" in options:
            connection.exec_driver_sql(f"PRAGMA busy_timeout = {round(1000.0 * options['wait_s'])}")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get("writes", False) else "BEGIN")

    return engine


@cache
def _template() -> sa.Engine:
    """Returns an engine with an initialised SQL dialect."""
    engine = sa.create_engine("sqlite://")
    engine.connect().close()
    return engine


def compute_database_checksum(connection: sa.Connection) -> str:
    """Returns the SHA-256 (hexadecimal) of an open database, including its write-ahead log.

    SQLite reads the file, because closing another file handle would release SQLite's locks.
    """
    driver = connection.connection.driver_connection
    assert isinstance(driver, sqlite3.Connection)
    return hashlib.sha256(driver.serialize()).hexdigest()


def compute_closed_database_checksum(path: Path) -> str:
    """Returns the SHA-256 (hexadecimal) of a closed database. Raises ``sqlite3.Error`` if it cannot be read."""
    with closing(sqlite3.connect(path)) as connection:
        return hashlib.sha256(connection.serialize()).hexdigest()


def find_sqlite_errors(connection: sa.Connection) -> list[str]:
    """Returns the errors that SQLite's integrity checks report."""
    found = connection.exec_driver_sql("PRAGMA integrity_check").scalars().all()
    strays = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
    return [text for text in found if text != "ok"] + [
        f"{table} {row} refers to a missing row of {parent}" for table, row, parent, _ in strays
    ]


def erase_deleted_data(path: Path) -> None:
    """Rewrite a database file without the contents of deleted rows.

    Raises ``StudyError`` if another process uses the file.
    """
    with closing(sqlite3.connect(path, timeout=LOCK_TIMEOUT_S, isolation_level=None)) as connection:
        connection.execute("PRAGMA secure_delete = ON")
        connection.execute("VACUUM")
        busy, *_ = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    if busy:
        raise StudyError(
            "another program uses the study, so deleted data can still be recovered: stop it, then delete again"
        )


def back_up_database(source: Path, target: Path) -> None:
    """Copy a database to a new file. Other processes may use the database during the copy."""
    open(target, "xb", opener=open_privately).close()
    with closing(sqlite3.connect(source)) as old, closing(sqlite3.connect(target)) as new:
        old.backup(new)


def copy_closed_database(source: Path, folder: Path) -> None:
    """Copy a closed database and its write-ahead log into a folder."""
    for path in (source, source.with_name(source.name + _LOG)):
        if path.exists():
            shutil.copyfile(path, folder / path.name)


def _write_ahead(connection: sqlite3.Connection) -> None:
    """Enable the write-ahead log.

    If another process is creating the same file, retry for up to ``LOCK_TIMEOUT_S``; SQLite does not wait here.
    """
    ends_s = time.monotonic() + LOCK_TIMEOUT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > ends_s:
                raise
        time.sleep(0.01)
