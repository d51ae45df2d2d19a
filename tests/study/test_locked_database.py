"""A locked database: the loop does not wait for it, and a session continues only after storage."""

import sqlite3
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import replace
from pathlib import Path

import psycopg
import pytest

from avrgym.study.checking.study_checks import check_study
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import ExperimenterCommand, PhaseDescription, Stop
from helpers.studies.small_studies import enrol_with_consent, make_study, new_postgresql_database
from helpers.vr.visit import Visit

pytestmark = pytest.mark.fast_cases(1)
"""One kind of database. Tests of what differs between kinds run with both."""
PATIENCE_S = 60.0
Lock = Callable[[], AbstractContextManager[None]]


@pytest.fixture(params=["sqlite", "postgresql"])
def locked(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Lock:
    """A context manager that locks the database of a study in ``tmp_path``."""
    if request.param == "sqlite":
        monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        return lambda: sqlite_lock(tmp_path / database.DATABASE_FILE)
    url = new_postgresql_database(request.getfixturevalue("postgresql"))
    monkeypatch.setenv(database.DATABASE_URL_VARIABLE, url)
    return lambda: postgresql_lock(url)


@contextmanager
def sqlite_lock(path: Path) -> Iterator[None]:
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        yield
        connection.execute("ROLLBACK")


@contextmanager
def postgresql_lock(url: str) -> Iterator[None]:
    with psycopg.connect(url) as connection:
        connection.execute("LOCK TABLE event IN ACCESS EXCLUSIVE MODE")
        yield
        connection.rollback()


@pytest.fixture
def visit(locked: Lock, tmp_path: Path) -> Iterator[StudyVisit]:
    """A study with a practice trial and two trials of 0.5 s, stored in another thread."""
    design = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "trial_steps": "5", "free_movement_s": "0.1"}
    with (
        StudyStore(make_study(tmp_path, **design)) as store,
        ThreadPoolExecutor(1) as storing,
        StudyVisit(store, enrol_with_consent(store), storing=storing) as visit,
    ):
        yield visit


def attend(visit: StudyVisit) -> Visit:
    plan = replace(visit.plan_remaining_trials(), countdown_s=0.1)
    return Visit(Path(), plan, make=lambda send: visit.create_session(plan, send))


def await_phase(attended: Visit, phase: str) -> None:
    """Tick until the session enters a phase, with pauses for the storage thread."""
    give_up_s = time.monotonic() + PATIENCE_S
    while attended.phase != phase:
        assert time.monotonic() < give_up_s, f"still in {attended.phase}; problems: {attended.problems}"
        attended.tick()
        time.sleep(0.001)


def states(visit: StudyVisit) -> list[str]:
    return [attempt.state for attempt in visit.store.read_attempts(visit.pseudonym)]


@pytest.mark.fast_cases(2)
def test_stop_works_while_the_database_is_locked(visit: StudyVisit, locked: Lock) -> None:
    attended = attend(visit)
    attended.calibrate()
    await_phase(attended, "trial")
    with locked():
        attended.tick(5)
        attended.send(Stop())
        assert attended.phase == "paused"
        assert attended.received(PhaseDescription)[-1].name == "paused"
        attended.tick(20)
    visit.end_session().result(PATIENCE_S)
    assert states(visit) == ["stopped"]


@pytest.mark.slow
def test_next_trial_waits_until_the_last_is_stored(visit: StudyVisit, locked: Lock) -> None:
    attended = attend(visit)
    attended.calibrate()
    await_phase(attended, "trial")
    with locked():
        attended.tick(300)
        assert attended.phase in ("trial", "free_after", "loading"), attended.problems
        assert attended.session.trial_index == 0
    await_phase(attended, "countdown")
    assert attended.session.trial_index == 1
    assert states(visit) == ["completed", "running"]
    attended.send(ExperimenterCommand(name="end"))
    visit.end_session().result(PATIENCE_S)
    assert [finding.message for finding in check_study(visit.store) if finding.is_error] == []


def test_robot_waits_until_its_attempt_is_stored(visit: StudyVisit, locked: Lock) -> None:
    attended = attend(visit)
    attended.calibrate()
    await_phase(attended, "check")
    with locked():
        await_phase(attended, "free_before")
        attended.tick(100)
        assert attended.phase in ("free_before", "countdown")
    await_phase(attended, "trial")
    attended.leave()
    visit.end_session().result(PATIENCE_S)
    assert states(visit) == ["interrupted"]


def test_next_session_stores_an_unstored_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop waits for storage only until its timeout."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    monkeypatch.setattr("avrgym.study.sessions.study_visit.SESSION_END_TIMEOUT_S", 0.5)
    monkeypatch.setattr("avrgym.study.storage.sqlite.LOCK_TIMEOUT_S", 1)
    with StudyStore(
        make_study(tmp_path, tasks='["Feeding"]', robots='["Jaco"]', free_movement_s="0.1")
    ) as store:
        with ThreadPoolExecutor(1) as storing:
            visit = StudyVisit(store, enrol_with_consent(store), storing=storing)
            attended = attend(visit)
            attended.calibrate()
            await_phase(attended, "trial")
            with sqlite_lock(tmp_path / database.DATABASE_FILE):
                attended.leave()
                with pytest.raises(StudyError, match="was not stored because the database is busy"):
                    visit.close()
        with StudyVisit(store, visit.pseudonym, take_over=True):
            assert [attempt.state for attempt in store.read_attempts(visit.pseudonym)] == ["interrupted"]
            assert store.read_sessions(visit.pseudonym)[0].state != "open"
