"""Small studies for tests, with real recordings."""

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import psycopg
import sqlalchemy as sa
from msgspec.structs import asdict

from avrgym.recording.configuration import BodyModel
from avrgym.recording.schema import (
    Answer,
    BodyTargets,
    Control,
    Event,
    Metrics,
    Outcome,
    Pose,
    Stream,
    StreamSamples,
    TrackingFrame,
)
from avrgym.recording.writer import RecordingWriter
from avrgym.study.design.design import read_default_design_text
from avrgym.study.people.participants import enrol_participant, record_consent, record_inclusion_answers
from avrgym.study.storage.answers import record_trial_answer
from avrgym.study.storage.attempts import begin_attempt, complete_attempt
from avrgym.study.storage.database_rows import StudySession, Trial, TrialAttempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.store import StudyStore
from helpers.studies.configurations import trial_configuration
from helpers.system.processes import kill_with_parent

STEPS = 3
METRICS = Metrics(STEPS, reward=-1.5, success=True, seconds=4.0)
TORSO_HEIGHT_M = 0.5625
OBSERVATION = [0.25, -1.0, 0.5, *[0.0] * 22]
HEARTBEATS = [[float(number)] for number in range(30)]
STREAMS = (
    Stream("heart", "Belt", "ECG", 100.0, ["ecg"], ["microvolts"]),
    Stream("gaze", "Tracker", "Gaze", 0.0, ["confidence", "norm_pos_x", "norm_pos_y"], []),
    Stream("marks", "Button box", "Markers", 0.0, [], []),
)
SAMPLES = (
    StreamSamples("heart", 0.001, [0.1 + 0.01 * number for number in range(30)], HEARTBEATS),
    StreamSamples("gaze", -0.25, [0.11, 0.13, 0.14], [[0.5, 0.25, 0.75]] * 2 + [[0.5, float("nan"), 0.75]]),
    StreamSamples("marks", 0.0, [0.2], [], [["pressed"]]),
)
"""Samples of other devices in every trial."""
USER_OF_POSTGRESQL = "nobody" if os.geteuid() == 0 else None
"""PostgreSQL's server refuses to run as root."""


def make_study(folder: Path, **changes: str) -> Path:
    """Create a study with the paper's protocol and changed values, in TOML syntax.

    The headset check is off by default.
    """
    text = read_default_design_text()
    for name, value in ({"headset_check": "false"} | changes).items():
        (line,) = (line for line in text.splitlines() if line.startswith(f"{name} = "))
        text = text.replace(line, f"{name} = {value}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "study.toml").write_text(text)
    return folder


def small_study(folder: Path) -> Path:
    """Create a study of one task with two robots and two policies: a practice trial and four trials."""
    return make_study(folder, tasks='["Feeding"]')


def eligible_answers(store: StudyStore) -> dict[str, bool]:
    """Return inclusion answers of an eligible participant."""
    return {question.id: question.required for question in store.design.inclusion}


def enrol_with_consent(store: StudyStore, simulated: bool = True, name: str = "", contact: str = "") -> str:
    """Enrol a participant with consent and an order."""
    pseudonym = enrol_participant(
        store, "woman", age_years=22, name=name, contact=contact, simulated=simulated
    )
    record_consent(store, pseudonym)
    assert record_inclusion_answers(store, pseudonym, eligible_answers(store))
    return pseudonym


def record(
    store: StudyStore, attempt: TrialAttempt, trial: Trial, *, simulated: bool = True, **changes: Any
) -> None:
    """Write a complete recording of an attempt: a few steps, frames and answers.

    ``changes`` are fields of its configuration.
    """
    values = {
        "attempt_number": attempt.number,
        "simulated": simulated,
        "joint_names": ("waist_x", "waist_y"),
        "person": BodyModel("woman", TORSO_HEIGHT_M, "fair"),
    }
    configuration = trial_configuration(store.design, trial, **values | changes)
    writer = RecordingWriter(store.resolve_path(attempt.recording), configuration)
    for step in range(1, STEPS + 1):
        time_ns = step * 100_000_000
        writer.write("/tracking", time_ns, _frame(step))
        writer.write("/body_targets", time_ns, BodyTargets([0.1 * step, -0.1]))
        terms = {"distance_m": 0.5, "action_squared": 0.0}
        control = Control(step, OBSERVATION, [0.5] * 7, -0.5, terms, step == STEPS, 0.3 / step, 1.0)
        writer.write("/control", time_ns, control)
    writer.write("/events", 100_000_000, Event("phase", "trial"))
    for stream, samples in zip(STREAMS, SAMPLES, strict=True):
        writer.write("/streams", 100_000_000, stream)
        writer.write("/samples", 400_000_000, samples)
    if not trial.practice:
        for value, item in enumerate(store.design.list_items_at_moment("after_trial"), start=3):
            writer.write("/answers", 400_000_000, Answer(item.id, min(value, item.points), 1.25))
    writer.close(Outcome(result="completed", **asdict(METRICS)))


def _frame(step: int) -> TrackingFrame:
    head = Pose([0.1, 1.2, -0.3 * step], [0.0, 0.0, 0.0, 1.0])
    left = None if step == 2 else Pose([-0.3, 0.8, -0.2], [0.5, 0.5, 0.5, 0.5])
    return TrackingFrame(
        step, step * 10.0, step / 10, moved_person=True, rejected=False, head=head, left=left, right=head
    )


def run_trial(
    store: StudyStore, session: StudySession, trial: Trial, *, simulated: bool = True, **changes: Any
) -> TrialAttempt:
    """Run one trial: attempt, recording, answers, completion."""
    attempt = begin_attempt(store, session.id, trial.position)
    record(store, attempt, trial, simulated=simulated, **changes)
    if not trial.practice:
        for value, item in enumerate(store.design.list_items_at_moment("after_trial"), start=3):
            record_trial_answer(store, attempt.id, Answer(item.id, min(value, item.points), 1.25))
    complete_attempt(store, attempt.id, METRICS)
    return attempt


def run_participant(
    store: StudyStore, pseudonym: str, trials: int | None = None, *, simulated: bool = True, **changes: Any
) -> None:
    """Run a session with a participant's remaining trials, at most ``trials``."""
    session = open_session(store, pseudonym)
    for trial in store.read_remaining_trials(pseudonym)[:trials]:
        run_trial(store, session, trial, simulated=simulated, **changes)
    close_session(store, session.id)


# PostgreSQL --------------------------------------------------------------------------------------------------------


def postgresql_programs() -> Path | None:
    """Return the folder of PostgreSQL's server programs, or ``None``."""
    folders = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name))
    if folders:
        return folders[-1]
    found = shutil.which("initdb")
    return Path(found).resolve().parent if found else None


@contextmanager
def postgresql_data(programs: Path) -> Iterator[Path]:
    """Create the data of a PostgreSQL server until the context ends. Yields the folder of data and socket."""
    folder = Path(tempfile.mkdtemp(prefix="avrgym-"))
    if USER_OF_POSTGRESQL:
        shutil.chown(folder, USER_OF_POSTGRESQL)
    options = ["-U", "avrgym", "-A", "trust", "--no-sync", "--no-locale", "-E", "UTF8"]
    initialise = [programs / "initdb", "-D", folder / "data", *options]
    try:
        subprocess.run(initialise, check=True, capture_output=True, user=USER_OF_POSTGRESQL, cwd=folder)
        yield folder
    finally:
        shutil.rmtree(folder)


@contextmanager
def postgresql_process(programs: Path, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a PostgreSQL server with the data in a folder. At the end it stops immediately, as after a crash.

    Yields its process.
    """
    options = ["-D", folder / "data", "-k", folder, "-c", "listen_addresses=", "-c", "fsync=off"]
    with subprocess.Popen(
        [programs / "postgres", *options],
        stderr=subprocess.PIPE,
        user=USER_OF_POSTGRESQL,
        cwd=folder,
        text=True,
        preexec_fn=kill_with_parent,
    ) as server:
        try:
            assert server.stderr is not None
            next(line for line in server.stderr if "ready to accept connections" in line)
            yield server
        finally:
            server.send_signal(signal.SIGQUIT)


@contextmanager
def postgresql_server(programs: Path) -> Iterator[Path]:
    """Run a PostgreSQL server until the context ends. Yields the folder of its socket."""
    with postgresql_data(programs) as folder, postgresql_process(programs, folder):
        yield folder


def new_postgresql_database(server: Path, like: str | None = None) -> str:
    """Create a database, empty or as a copy of ``like``, and return its URL."""
    name = f"study_{uuid4().hex}"
    template = sa.make_url(like).database if like else "template1"
    with psycopg.connect(host=str(server), user="avrgym", dbname="postgres", autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name} TEMPLATE {template}".encode())
    return f"postgresql://avrgym@/{name}?host={server}"
