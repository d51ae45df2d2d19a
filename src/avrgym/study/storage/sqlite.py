"""What only SQLite needs: durable connections with a write-ahead log, copies, and traces to erase."""

import hashlib
import shutil
import sqlite3
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.event import listens_for

from avrgym.study.storage.states import StudyError
from avrgym.system.files import private_opener

WAIT_S = 60
"""How long a station waits for another one's writing."""
_LOG = "-wal"
_PRAGMAS = ("synchronous = FULL", "foreign_keys = ON", "secure_delete = ON")


def make_engine(path: Path) -> sa.Engine:
    """Connections to a database's file, which is made when it is missing, for its owner alone."""
    with suppress(FileExistsError):
        open(path, "xb", opener=private_opener).close()
    engine = sa.create_engine(sa.URL.create("sqlite", database=str(path)), connect_args={"timeout": WAIT_S})

    @listens_for(engine, "connect")
    def set_up(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # the driver would begin and commit at moments of its own
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


def database_checksum(connection: sa.Connection) -> str:
    """That of the database's file with all that is in its log.

    The file is read through SQLite: opening and closing it beside would let go of SQLite's locks on it.
    """
    driver = connection.connection.driver_connection
    assert isinstance(driver, sqlite3.Connection)
    return hashlib.sha256(driver.serialize()).hexdigest()


def checksum_at_rest(path: Path) -> str:
    """That of a database that nobody uses; ``sqlite3.Error`` where it cannot be read."""
    with closing(sqlite3.connect(path)) as connection:
        return hashlib.sha256(connection.serialize()).hexdigest()


def faults(connection: sa.Connection) -> list[str]:
    """What SQLite finds wrong with its file."""
    found = connection.exec_driver_sql("PRAGMA integrity_check").scalars().all()
    strays = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
    return [text for text in found if text != "ok"] + [
        f"{table} {row} belongs to {parent} that is not there" for table, row, parent, _ in strays
    ]


def erase_traces(path: Path) -> None:
    """Write a file anew without what deleted rows left; ``StudyError`` while somebody else uses it."""
    with closing(sqlite3.connect(path, timeout=WAIT_S, isolation_level=None)) as connection:
        connection.execute("PRAGMA secure_delete = ON")
        connection.execute("VACUUM")
        busy, *_ = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    if busy:
        raise StudyError("the study is in use: stop what uses it and delete again, so that no trace stays")


def back_up(source: Path, target: Path) -> None:
    """Copy a database that may be in use."""
    open(target, "xb", opener=private_opener).close()
    with closing(sqlite3.connect(source)) as old, closing(sqlite3.connect(target)) as new:
        old.backup(new)


def copy_at_rest(source: Path, folder: Path) -> None:
    """Copy a database that nobody can write to into a folder, with the log that a crash may have left."""
    for path in (source, source.with_name(source.name + _LOG)):
        if path.exists():
            shutil.copyfile(path, folder / path.name)


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
