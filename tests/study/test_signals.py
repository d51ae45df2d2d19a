"""Ctrl+C, SIGTERM and SIGHUP end a command with a message, an exit code and closed connections."""

import os
import signal
import sqlite3
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol import messages
from helpers.studies.small_studies import enrol_with_consent, make_study
from helpers.system.processes import AVRGYM, kill_with_parent, running_server
from helpers.vr.time_limits import command_with_limits

IMPATIENT = (
    "avrgym.study.storage.sqlite:LOCK_TIMEOUT_S=4",
    "avrgym.study.sessions.study_visit:SESSION_END_TIMEOUT_S=2",
)
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PATIENCE_S = 60.0


@contextmanager
def participant(address: str) -> Iterator[ClientConnection]:
    """A connected client of a participant."""
    url, _, token = address.partition("/#token=")
    with connect(f"ws{url.removeprefix('http')}/ws", max_size=None, max_queue=None) as client:
        client.send(
            messages.encode_message(messages.Hello(messages.PROTOCOL_VERSION, token, "test", emulated=True))
        )
        client.recv(PATIENCE_S)
        yield client


def farewell(client: ClientConnection) -> tuple[int | None, str | None]:
    """Receive all messages and return code and reason of the close."""
    with suppress(ConnectionClosed):
        while True:
            client.recv(PATIENCE_S)
    return client.close_code, client.close_reason


@pytest.mark.slow
@pytest.mark.parametrize("number", SIGNALS)
def test_server_closes_connections_and_ends(tmp_path: Path, number: signal.Signals) -> None:
    folder = make_study(tmp_path)
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store)
    with running_server(folder, "--participant", pseudonym) as server:
        with participant(server.participant) as client:
            server.process.send_signal(number)
            assert farewell(client) == (1001, "the server has stopped")
        assert server.process.wait(PATIENCE_S) == 0


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("number", SIGNALS)
def test_interrupted_command_has_its_exit_code(number: signal.Signals) -> None:
    command = [AVRGYM, "evaluate", "avrgym/FeedingJaco-v1", "--episodes", "100000"]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=kill_with_parent
    ) as running:
        await_handlers(running.pid)
        running.send_signal(number)
        _, errors = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 128 + number
    assert errors.strip().splitlines()[-1] == "avrgym: stopped"
    assert "Traceback" not in errors


@pytest.mark.slow
def test_workers_end_with_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal sends Ctrl+C to the command and its workers."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    command = [AVRGYM, "study", "simulate", make_study(tmp_path), "--participants", "2"]
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=kill_with_parent,
        process_group=0,
    ) as running:
        await_handlers(running.pid)
        await_session(tmp_path)
        os.killpg(running.pid, signal.SIGINT)
        _, errors = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 128 + signal.SIGINT
    assert "Traceback" not in errors


@pytest.mark.slow
def test_unstored_end_of_a_session_has_exit_code_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    with StudyStore(make_study(tmp_path, tasks='["Feeding"]')) as store:
        pseudonym = enrol_with_consent(store)
        options = ["serve", "--port", "0", "--study", tmp_path, "--participant", pseudonym]
        command = [*command_with_limits(*IMPATIENT), *options]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=kill_with_parent
        ) as running:
            assert running.stdout is not None
            next(line for line in running.stdout if "Ctrl+C" in line)
            with closing(sqlite3.connect(tmp_path / database.DATABASE_FILE, isolation_level=None)) as other:
                other.execute("BEGIN EXCLUSIVE")
                running.send_signal(signal.SIGTERM)
                _, errors = running.communicate(timeout=2 * PATIENCE_S)
        assert running.returncode == 1
        assert errors.splitlines() == [
            f"avrgym: the end of ses-01 of {pseudonym} was not stored because the database is busy; "
            "the participant's next session ends it"
        ]


def await_handlers(process: int) -> None:
    """Wait until a program handles signals, by its mask in /proc."""
    give_up_s = time.monotonic() + PATIENCE_S
    caught = 1 << (signal.SIGTERM - 1)
    while time.monotonic() < give_up_s:
        status = dict(line.split(":\t") for line in Path(f"/proc/{process}/status").read_text().splitlines())
        if int(status["SigCgt"], 16) & caught:
            return
        time.sleep(0.01)
    raise TimeoutError("it listens to no signal")


def await_session(folder: Path) -> None:
    """Wait until a simulated participant's recording begins."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not any(folder.rglob("*.mcap")):
        assert time.monotonic() < give_up_s
        time.sleep(0.05)
