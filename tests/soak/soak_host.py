"""Many participants of a hosted study at the same time, while processes and services fail.

Session processes and the host are killed, PostgreSQL restarts, and the object store does not answer for a minute. Run
one with other numbers: ``python tests/soak/soak_host.py PARTICIPANTS KILLS HOST_KILLS DATABASE_RESTARTS STORE_STOPS``.
"""

import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from avrgym.study.people.invitations import create_invitations
from avrgym.study.storage.database import DATABASE_URL_VARIABLE
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.hosting.hosted_participants import (
    DESIGN,
    SETTINGS,
    Counts,
    figures,
    take_part_in_other_process,
)
from helpers.hosting.served_host import Served, host_process
from helpers.studies.object_store_server import object_store_server, set_object_store, stop_for
from helpers.studies.small_studies import (
    make_study,
    new_postgresql_database,
    postgresql_data,
    postgresql_process,
    postgresql_programs,
)
from helpers.system.processes import free_port

_Fault = Callable[[], bool]
"""A function that causes a fault. Returns whether it could."""
FIRST_FAULT_S, FAULT_INTERVAL_S, DATABASE_STOP_S, STORE_STOP_S = 20.0, 8.0, 3.0, 60.0
UPLOAD_TIMEOUT_S = 120.0


def test_participants_with_killed_sessions(tmp_path: Path) -> None:
    found = host_with_faults(tmp_path / "study", participants=6, kills=4)
    print(json.dumps(found, indent=2))
    assert (found["completed"], found["lost_trials"], found["faults"]) == (6, 0, [])


def test_participants_with_killed_host_and_failing_services(tmp_path: Path) -> None:
    found = host_with_faults(tmp_path / "study", 4, host_kills=2, database_restarts=2, store_stops=1)
    print(json.dumps(found, indent=2))
    assert (found["completed"], found["lost_trials"], found["faults"]) == (4, 0, [])
    assert found["recordings_not_uploaded"] == []


def host_with_faults(
    folder: Path,
    participants: int,
    kills: int = 0,
    host_kills: int = 0,
    database_restarts: int = 0,
    store_stops: int = 0,
) -> dict[str, Any]:
    """Host a study for emulated participants who come at once. Returns figures about them."""
    make_study(folder, **DESIGN)
    (folder / "host.toml").write_text(SETTINGS)
    with ExitStack() as stack:
        faults: list[_Fault] = []
        if database_restarts:
            faults += [stack.enter_context(_postgresql())] * database_restarts
        if store_stops:
            faults += [stack.enter_context(_object_store())] * store_stops
        store = stack.enter_context(StudyStore(folder))
        host = stack.enter_context(_Host(store))
        faults += [host.kill] * host_kills + [lambda: _kill_session(store)] * kills
        random.Random(1).shuffle(faults)
        invitations = [each.token for each in create_invitations(store, [""] * participants, days=1)]
        watch = _Watch(host, store, faults)
        began_s = time.monotonic()
        people = stack.enter_context(ThreadPoolExecutor(1)).submit(
            take_part_in_other_process, f"http://localhost:{host.served.host.public_port}", invitations
        )
        watch.run(people.done)  # in this thread: started processes end with the thread that started them
        outcomes, seconds = people.result(), time.monotonic() - began_s
        return figures(store, outcomes, watch.counts) | {
            "seconds": round(seconds, 1),
            "killed_sessions": kills,
            "killed_hosts": host_kills,
            "restarted_databases": database_restarts,
            "stopped_object_stores": store_stops,
            "recordings_not_uploaded": _not_uploaded(store),
            "omitted_faults": len(watch.faults),
        }


class _Host:
    """Context manager: a host process, which is started again at the same ports when it is killed."""

    def __init__(self, store: StudyStore) -> None:
        self._store, self._open = store, ExitStack()

    def __enter__(self) -> "_Host":
        self._start(0, 0)
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def kill(self) -> bool:
        """Kill the host, and start it again."""
        self._open.close()
        self._start(self._process.port, self._process.experimenter_port)
        return True

    def _start(self, port: int, experimenter_port: int) -> None:
        self._process, self.served = self._open.enter_context(
            host_process(self._store, port=port, experimenter_port=experimenter_port)
        )


@contextmanager
def _postgresql() -> Iterator[_Fault]:
    """Store studies in a PostgreSQL database. Yields a function that restarts its server."""
    programs = postgresql_programs()
    assert programs is not None, "PostgreSQL's server is not installed"
    with postgresql_data(programs) as folder, ExitStack() as running:
        running.enter_context(postgresql_process(programs, folder))
        os.environ[DATABASE_URL_VARIABLE] = new_postgresql_database(folder)

        def restart() -> bool:
            running.close()
            time.sleep(DATABASE_STOP_S)
            running.enter_context(postgresql_process(programs, folder))
            return True

        try:
            yield restart
        finally:
            del os.environ[DATABASE_URL_VARIABLE]


@contextmanager
def _object_store() -> Iterator[_Fault]:
    """Store recordings in an object store. Yields a function that stops its process for ``STORE_STOP_S``."""
    port = free_port()
    with object_store_server(port) as process, pytest.MonkeyPatch.context() as patch, ExitStack() as timers:
        set_object_store(patch, port)

        def stop() -> bool:
            timers.callback(stop_for(process, STORE_STOP_S).join)
            return True

        yield stop


def _not_uploaded(store: StudyStore) -> list[str]:
    """Wait until all recordings are uploaded. Returns those that are not after ``UPLOAD_TIMEOUT_S``."""
    if store.object_store is None:
        return []
    ends_s = time.monotonic() + UPLOAD_TIMEOUT_S
    attempts = [each for one in store.read_participants() for each in store.read_attempts(one.pseudonym)]
    paths = {each.recording: store.resolve_path(each.recording) for each in attempts}
    missing = {name: path.stat().st_size for name, path in paths.items() if path.exists()}
    while missing and time.monotonic() < ends_s:
        time.sleep(1.0)
        with suppress(StudyError):
            uploaded = store.object_store.list_file_sizes()
            missing = {name: size for name, size in missing.items() if uploaded.get(name) != size}
    return sorted(missing)


def _kill_session(store: StudyStore) -> bool:
    """Kill the process of a session with a running attempt. Returns whether there was one."""
    sessions = [each for one in store.read_participants() for each in store.read_sessions(one.pseudonym)]
    attempts = [each for one in store.read_participants() for each in store.read_attempts(one.pseudonym)]
    running = {each.session for each in attempts if each.state == "running"}
    processes = [each.process_id for each in sessions if each.state == "open" and each.id in running]
    if not processes:
        return False
    with suppress(ProcessLookupError):
        os.kill(random.choice(processes), signal.SIGKILL)
    return True


class _Watch:
    """Counts sessions and ticks, and causes one fault after another. ``faults``: those that remain."""

    def __init__(self, host: _Host, store: StudyStore, faults: list[_Fault]) -> None:
        self.counts, self.faults = Counts(), faults
        self._host, self._store, self._restarts = host, store, 0

    def run(self, is_over: Callable[[], bool]) -> None:
        """Watch until the end."""
        next_fault_s = time.monotonic() + FIRST_FAULT_S
        while not is_over():
            time.sleep(1.0)
            with suppress(httpx.HTTPError, KeyError):
                self._count(self._host.served)
            if self.faults and time.monotonic() > next_fault_s and self.faults[0]():
                self._restarts += self.faults.pop(0) == self._host.kill
                next_fault_s = time.monotonic() + FAULT_INTERVAL_S

    def _count(self, served: Served) -> None:
        experimenter = served.host.tokens.experimenter
        sessions = served.request("GET", "/api/sessions", experimenter, experimenter=True).json()["sessions"]
        self.counts.most = max(self.counts.most, len(sessions))
        for each in sessions:
            self.counts.count(
                (each["id"], each["crashes"], self._restarts),
                60.0 * each["minutes"],
                each["missed_ticks"],
                each["cpu_share"],
                in_trial=each["phase"] == "trial",
            )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        print(json.dumps(host_with_faults(Path(temporary) / "study", *map(int, sys.argv[1:])), indent=2))
