"""A PostgreSQL server that restarts: actions wait for it, and an interrupted action is repeated."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psycopg
import pytest

from avrgym.study.sessions.session_threads import StorageQueue
from avrgym.study.storage import database
from avrgym.study.storage.state_transitions import LostConnectionError, StudyError
from avrgym.study.storage.store import StudyStore, record_event
from helpers.studies.small_studies import new_postgresql_database, small_study

PATIENCE_S = 60.0


class Server:
    """The server of a study's database. Its connections to this database can be closed and refused."""

    def __init__(self, folder: Path, url: str) -> None:
        self._folder, self._name = folder, url.partition("@/")[2].partition("?")[0]

    def close_connections(self) -> None:
        self._execute(
            f"SELECT pg_terminate_backend(pid, 10000) FROM pg_stat_activity WHERE datname = '{self._name}'"
        )

    def accept(self, allowed: bool) -> None:
        self._execute(f"ALTER DATABASE {self._name} WITH ALLOW_CONNECTIONS {allowed}")

    def _execute(self, statement: str) -> None:
        with psycopg.connect(
            host=str(self._folder), user="avrgym", dbname="postgres", autocommit=True
        ) as connection:
            connection.execute(statement.encode())


@pytest.fixture
def server(postgresql: Path, monkeypatch: pytest.MonkeyPatch) -> Server:
    url = new_postgresql_database(postgresql)
    monkeypatch.setenv(database.DATABASE_URL_VARIABLE, url)
    return Server(postgresql, url)


@pytest.fixture
def store(server: Server, tmp_path: Path) -> Iterator[StudyStore]:
    with StudyStore(small_study(tmp_path)) as store:
        yield store


def test_interrupted_task_is_stored_once(store: StudyStore, server: Server) -> None:
    calls: list[int] = []

    def task() -> None:
        with store.write_transaction() as connection:
            record_event(connection, "tested", "", {})
            calls.append(len(calls))
            if len(calls) == 1:
                server.close_connections()

    with ThreadPoolExecutor(1) as thread:
        StorageQueue(thread).submit(task).result(PATIENCE_S)
    assert calls == [0, 1]
    assert [each.name for each in store.read_events()] == ["tested"]
    assert store.database.find_integrity_errors() == []


def test_actions_wait_while_the_server_is_away(
    store: StudyStore, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that was never connected reports the error immediately."""
    server.accept(False)
    server.close_connections()
    threading.Timer(0.5, server.accept, [True]).start()
    with pytest.raises(StudyError, match="not currently accepting connections"), StudyStore(store.folder):
        pass
    assert store.read_participants() == []
    monkeypatch.setattr(database, "RECONNECT_TIMEOUT_S", 0.1)
    server.accept(False)
    server.close_connections()
    with pytest.raises(LostConnectionError, match="not currently accepting connections"):
        store.read_participants()
    server.accept(True)
