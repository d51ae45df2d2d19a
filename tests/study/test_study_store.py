"""The store of a study on SQLite and PostgreSQL: valid and invalid actions, and crashes."""

import itertools
import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from avrgym.recording.schema import Answer, Metrics
from avrgym.study.design.allocation import make_trial_orders
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import (
    add_note,
    enrol_participant,
    record_consent,
    record_inclusion_answers,
    withdraw_participant,
)
from avrgym.study.storage import database, hash_chain, schema
from avrgym.study.storage.answers import record_session_answer, record_trial_answer
from avrgym.study.storage.attempts import (
    INCOMPLETE_END_STATES,
    begin_attempt,
    complete_attempt,
    end_incomplete_attempt,
)
from avrgym.study.storage.database_rows import Trial
from avrgym.study.storage.sessions import close_session, open_session, record_session_event, skip_trial
from avrgym.study.storage.state_transitions import TRANSITIONS_BY_TABLE, StudyError, check_transition
from avrgym.study.storage.store import StudyStore
from avrgym.system.processes import is_process_running
from helpers.studies.small_studies import (
    METRICS,
    eligible_answers,
    enrol_with_consent,
    make_study,
    new_postgresql_database,
    record,
    run_participant,
    run_trial,
    small_study,
)
from helpers.system.paths import DATA, TESTS
from helpers.system.processes import kill_with_parent

pytestmark = pytest.mark.fast_cases(1)
"""One kind of database. Tests of what differs between kinds run with both."""
OLD_STUDY = DATA / "study-of-0.2.0"
ITEMS = ("L1", "L2", "L3", "L4")


@pytest.fixture(params=["sqlite", "postgresql"])
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The kind of database of the test."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    if request.param == "postgresql":
        server = request.getfixturevalue("postgresql")
        monkeypatch.setenv(database.DATABASE_URL_VARIABLE, new_postgresql_database(server))
    return request.param


@pytest.fixture
def store(kind: str, tmp_path: Path) -> Iterator[StudyStore]:
    with StudyStore(small_study(tmp_path / "study")) as opened:
        yield opened


def contents(store: StudyStore) -> dict[str, list]:
    """All rows of all tables."""
    with store.database.read_transaction() as connection:
        return {
            table.name: [tuple(row) for row in connection.execute(sa.select(table))]
            for table in schema.METADATA.sorted_tables
        }


def refused(store: StudyStore, action: Callable[[], object], message: str) -> None:
    """Assert that the action raises and changes no rows or files."""
    rows, files = contents(store), sorted(store.folder.rglob("*.mcap"))
    with pytest.raises(StudyError, match=message):
        action()
    assert contents(store) == rows
    assert sorted(store.folder.rglob("*.mcap")) == files


# The whole life


@pytest.mark.fast_cases(2)
def test_participant_from_enrolment_to_the_last_answer(store: StudyStore) -> None:
    pseudonym = enrol_participant(store, "man", age_years=24)
    record_consent(store, pseudonym)
    assert record_inclusion_answers(store, pseudonym, eligible_answers(store))
    session = open_session(store, pseudonym)
    planned = store.read_remaining_trials(pseudonym)
    assert [trial.position for trial in planned] == [1, 2, 3, 4, 5]
    for trial in planned:
        run_trial(store, session, trial)
    add_note(store, pseudonym, "laughed at the spoon", session.id)
    record_session_event(store, session.id, "reconnected", "after 0.4 s")
    close_session(store, session.id)

    participant = store.read_participant(pseudonym)
    assert (participant.state, participant.sex, participant.age_years) == ("completed", "man", 24)
    assert participant.consent_version == "1"
    assert store.read_remaining_trials(pseudonym) == []
    assert {trial.state for trial in store.read_trials(pseudonym)} == {"completed"}
    attempts = store.read_attempts(pseudonym)
    assert [attempt.recording for attempt in attempts] == [
        f"recordings/sub-001/ses-01/trial-{number:02}_attempt-1.mcap" for number in range(1, 6)
    ]
    assert all(attempt.metrics == METRICS and len(attempt.sha256 or "") == 64 for attempt in attempts)
    assert Counter(answer.item for answer in store.read_answers(pseudonym)) == dict.fromkeys(ITEMS, 4)
    assert [note.text for note in store.read_notes(pseudonym)] == ["laughed at the spoon"]
    names = [event.name for event in store.read_events()]
    assert names[:4] == [
        "participant enrolled",
        "participant consented",
        "participant allocated",
        "session open",
    ]
    assert names[-3:] == ["reconnected", "session closed", "participant completed"]
    assert Counter(names)["attempt completed"] == Counter(names)["trial completed"] == 5


def test_stored_data_remain_after_reopening(kind: str, tmp_path: Path) -> None:
    folder = small_study(tmp_path)
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), trials=2)
        before = contents(store)
    with StudyStore(folder) as store:
        assert contents(store) == before


def test_interrupted_attempts_are_repeated_and_skipped_trials_are_last(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    session = open_session(store, pseudonym)
    practice, first, *_ = store.read_remaining_trials(pseudonym)
    run_trial(store, session, practice)
    for number, state in enumerate(INCOMPLETE_END_STATES, start=1):
        attempt = begin_attempt(store, session.id, first.position)
        assert attempt.number == number
        record(store, attempt, first)
        end_incomplete_attempt(store, attempt.id, state, Metrics(steps=1))
    skip_trial(store, session.id, first.position)
    assert [trial.position for trial in store.read_remaining_trials(pseudonym)] == [3, 4, 5, 2]
    assert run_trial(store, session, first).number == len(INCOMPLETE_END_STATES) + 1
    assert [a.state for a in store.read_attempts(pseudonym)] == [
        "completed",
        *INCOMPLETE_END_STATES,
        "completed",
    ]
    assert all(attempt.sha256 for attempt in store.read_attempts(pseudonym))


def test_answers_about_a_session_are_separate(kind: str, tmp_path: Path) -> None:
    folder = small_study(tmp_path)
    with open(folder / "study.toml", "a") as file:
        file.write('[[questionnaires]]\nname = "end"\nwhen = "after_session"\n')
        file.write('items = [{ id = "E1", text = "Again?", points = 5, low = "never", high = "soon" }]\n')
    with StudyStore(folder) as store:
        session = open_session(store, enrol_with_consent(store))
        refused(
            store,
            lambda: record_session_answer(store, session.id, Answer("L1", 3, 1.0)),
            "no item 'L1'; allowed: E1",
        )
        refused(store, lambda: record_session_answer(store, session.id, Answer("E1", 6, 1.0)), "from 1 to 5")
        record_session_answer(store, session.id, Answer("E1", 5, 1.0))
        refused(
            store, lambda: record_session_answer(store, session.id, Answer("E1", 4, 1.0)), "answered already"
        )
        (answer,) = store.read_answers("sub-001")
        assert (answer.session, answer.attempt, answer.item, answer.value) == (session.id, None, "E1", 5)


# What may not happen


@pytest.mark.fast_cases(len(TRANSITIONS_BY_TABLE))
@pytest.mark.parametrize("table", TRANSITIONS_BY_TABLE)
def test_only_defined_transitions_are_allowed(table: str) -> None:
    states = TRANSITIONS_BY_TABLE[table]
    for before in states:
        for after in states:
            if after in states[before]:
                check_transition(table, "it", before, after)
            else:
                with pytest.raises(StudyError, match=f"it is {before} and cannot become {after}; allowed"):
                    check_transition(table, "it", before, after)


def test_trial_requires_consent(store: StudyStore) -> None:
    pseudonym = enrol_participant(store, "woman")
    refused(store, lambda: open_session(store, pseudonym), "is enrolled; only allocated participants")
    answers = eligible_answers(store)
    refused(
        store,
        lambda: record_inclusion_answers(store, pseudonym, answers),
        "is enrolled and cannot become allocated",
    )
    record_consent(store, pseudonym)
    refused(store, lambda: open_session(store, pseudonym), "is consented; only allocated participants")
    refused(store, lambda: record_consent(store, pseudonym), "is consented and cannot become consented")
    record_inclusion_answers(store, pseudonym, answers)
    open_session(store, pseudonym)


def test_excluded_participant_has_no_order(store: StudyStore) -> None:
    pseudonym = enrol_participant(store, "woman")
    record_consent(store, pseudonym)
    refused(
        store,
        lambda: record_inclusion_answers(store, pseudonym, {"adult": True}),
        "for each of adult, stop",
    )
    assert not record_inclusion_answers(store, pseudonym, eligible_answers(store) | {"epilepsy": True})
    participant = store.read_participant(pseudonym)
    assert (participant.state, participant.cell, store.read_trials(pseudonym)) == ("excluded", None, [])
    assert participant.inclusion is not None
    assert participant.inclusion["epilepsy"]
    assert store.read_participant(enrol_with_consent(store)).cell == 0


def test_simulated_participants_do_not_use_cells_of_people(store: StudyStore) -> None:
    cells = [
        store.read_participant(enrol_with_consent(store, simulated=simulated)).cell
        for simulated in (True, True, False, True, False)
    ]
    assert cells == [0, 1, 0, 2, 1]


def test_withdrawal_ends_attempt_and_session(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    session = open_session(store, pseudonym)
    attempt = begin_attempt(store, session.id, 1)
    withdraw_participant(store, pseudonym, "felt sick")
    assert [a.state for a in store.read_attempts(pseudonym)] == ["stopped"]
    assert [s.state for s in store.read_sessions(pseudonym)] == ["closed"]
    assert store.read_attempts(pseudonym)[0].sha256 is None
    assert "felt sick" in [event.detail for event in store.read_events()]
    for action in (
        lambda: complete_attempt(store, attempt.id, METRICS),
        lambda: record_trial_answer(store, attempt.id, Answer("L1", 3, 1.0)),
        lambda: begin_attempt(store, session.id, 1),
        lambda: open_session(store, pseudonym),
        lambda: withdraw_participant(store, pseudonym),
    ):
        refused(store, action, "is (stopped|closed|withdrawn)")


def test_session_rejects_actions_out_of_order(store: StudyStore) -> None:
    pseudonym, other = enrol_with_consent(store), enrol_with_consent(store)
    session = open_session(store, pseudonym)
    refused(store, lambda: open_session(store, pseudonym), "is open at .*; close it at that station first")
    refused(store, lambda: begin_attempt(store, session.id, 9), "there is no trial 9")
    refused(store, lambda: begin_attempt(store, 99, 1), "there is no session 99")
    refused(store, lambda: add_note(store, other, "x", session.id), "is not a session of sub-002")
    refused(
        store, lambda: record_session_event(store, session.id, "x", attempt_id=1), "there is no attempt 1"
    )
    practice, first, *_ = store.read_remaining_trials(pseudonym)
    run_trial(store, session, practice)
    refused(store, lambda: begin_attempt(store, session.id, 1), "trial 1 of sub-001 is completed and cannot")
    refused(store, lambda: skip_trial(store, session.id, 1), "is completed and cannot become skipped")
    attempt = begin_attempt(store, session.id, 2)
    refused(store, lambda: begin_attempt(store, session.id, 2), "is running and cannot become running")
    refused(store, lambda: begin_attempt(store, session.id, 3), "is running; end it before")
    refused(
        store,
        lambda: end_incomplete_attempt(store, attempt.id, "completed"),
        "allowed: stopped, paused, interrupted",
    )
    refused(
        store,
        lambda: record_trial_answer(store, attempt.id, Answer("L9", 3, 1.0)),
        "no item 'L9'; allowed: L1, L2, L3, L4",
    )
    refused(
        store, lambda: record_trial_answer(store, attempt.id, Answer("L1", 8, 1.0)), "integers from 1 to 7"
    )
    refused(
        store,
        lambda: record_trial_answer(store, attempt.id, Answer("L1", 3, -1.0)),
        "response time is -1.0 s; allowed",
    )
    for item in ITEMS[:3]:
        record_trial_answer(store, attempt.id, Answer(item, 3, 1.0))
    refused(
        store, lambda: record_trial_answer(store, attempt.id, Answer("L1", 4, 1.0)), "L1 is answered already"
    )
    refused(
        store, lambda: complete_attempt(store, attempt.id, METRICS), "cannot be completed: recordings/sub-001"
    )
    record(store, attempt, first)
    refused(
        store,
        lambda: complete_attempt(store, attempt.id, Metrics(reward=float("nan"))),
        "reward is nan; allowed",
    )
    complete_attempt(store, attempt.id, METRICS)
    refused(
        store,
        lambda: complete_attempt(store, attempt.id, METRICS),
        "is completed; allowed: a running attempt",
    )


@pytest.mark.fast_cases(8)
@pytest.mark.parametrize(
    "pseudonym", ["sub-002", "sub-1", "../..", "sub-000", "sub-001/..", "", "sub-٠٠١", "sub-001\n"]
)
def test_unknown_participant_is_rejected(store: StudyStore, pseudonym: str) -> None:
    enrol_with_consent(store)
    for action in (open_session, withdraw_participant, record_consent, StudyStore.read_participant):
        refused(store, lambda action=action: action(store, pseudonym), "not a pseudonym|there is no sub-002")


def test_stray_file_is_not_overwritten(store: StudyStore) -> None:
    session = open_session(store, enrol_with_consent(store))
    stray = store.resolve_path("recordings/sub-001/ses-01/trial-01_attempt-1.mcap")
    stray.parent.mkdir(parents=True)
    stray.write_text("precious")
    attempt = begin_attempt(store, session.id, 1)
    assert attempt.recording == "recordings/sub-001/ses-01/trial-01_attempt-2.mcap"
    assert stray.read_text() == "precious"


def test_attempt_uses_its_opened_file(store: StudyStore, tmp_path: Path) -> None:
    session = open_session(store, enrol_with_consent(store))
    folder = store.resolve_path(session.recordings_folder)
    folder.mkdir(parents=True)
    for path in (
        folder / "missing.mcap",
        tmp_path / "x.mcap",
        folder / ".." / "x.mcap",
        store.folder / "study.toml",
    ):
        if path.name == "x.mcap":
            path.write_bytes(b"")
        refused(store, lambda path=path: begin_attempt(store, session.id, 1, path), "is not a file in")
    opened = folder / "trial-01_attempt-7.mcap"
    opened.write_bytes(b"")
    attempt = begin_attempt(store, session.id, 1, opened)
    assert (attempt.number, attempt.recording) == (1, f"{session.recordings_folder}/trial-01_attempt-7.mcap")


def test_recordings_are_not_written_through_symbolic_links(store: StudyStore, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    session = open_session(store, enrol_with_consent(store))
    (store.folder / "recordings").mkdir()
    (store.folder / "recordings" / "sub-001").symlink_to(elsewhere)
    refused(store, lambda: begin_attempt(store, session.id, 1), "is outside the study's folder")
    assert list(elsewhere.iterdir()) == []


def test_protocol_is_fixed_after_the_first_allocation(kind: str, tmp_path: Path) -> None:
    folder = small_study(tmp_path)
    StudyStore(folder).close()
    make_study(folder, tasks='["Feeding"]', seed="5")
    with StudyStore(folder) as store:
        enrol_with_consent(store)
    make_study(folder, tasks='["Drinking"]', seed="5")
    with pytest.raises(
        StudyError,
        match=r"tasks changed after the first participant was allocated; allowed: the earlier value \['Feeding'\]",
    ):
        StudyStore(folder)
    make_study(folder, tasks='["Feeding"]', seed="5", title='"Another title"')
    StudyStore(folder).close()


# Crashes


CRASH = """
import os, sys
from pathlib import Path
from avrgym.study.storage.attempts import begin_attempt
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.store import StudyStore
store = StudyStore(Path(sys.argv[1]))
begin_attempt(store, open_session(store, sys.argv[2]).id, 1)
os._exit(9)
"""


@pytest.mark.slow
def test_session_of_a_dead_process_is_taken_over(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    assert subprocess.run([sys.executable, "-c", CRASH, store.folder, pseudonym]).returncode == 9
    session = open_session(store, pseudonym)
    assert session.number == 2
    assert [visit.state for visit in store.read_sessions(pseudonym)] == ["interrupted", "open"]
    assert [attempt.state for attempt in store.read_attempts(pseudonym)] == ["interrupted"]
    attempt = begin_attempt(store, session.id, 1)
    assert attempt.recording == "recordings/sub-001/ses-02/trial-01_attempt-2.mcap"


def test_session_of_another_station_ends_only_on_request(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    store.station_name = "elsewhere"
    open_session(store, pseudonym)
    store.station_name = "here"
    refused(store, lambda: open_session(store, pseudonym), "is open at elsewhere")
    assert open_session(store, pseudonym, take_over=True).number == 2


def test_finished_trial_is_completed_after_a_crash(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    session = open_session(store, pseudonym)
    practice, first, second, *_ = store.read_remaining_trials(pseudonym)
    run_trial(store, session, practice)
    attempt = begin_attempt(store, session.id, first.position)
    record(store, attempt, first)
    for item in ITEMS:
        record_trial_answer(store, attempt.id, Answer(item, 3, 1.0))
    session = open_session(store, pseudonym, take_over=True)
    assert [a.state for a in store.read_attempts(pseudonym)] == ["completed", "completed"]
    assert store.read_attempts(pseudonym)[1].metrics == METRICS
    attempt = begin_attempt(store, session.id, second.position)
    record(store, attempt, second)
    open_session(store, pseudonym, take_over=True)
    third = store.read_attempts(pseudonym)[2]
    assert third.state == "completed"
    given = [each.value for each in store.read_answers(pseudonym) if each.attempt == third.id]
    assert given == [3 + number for number in range(len(ITEMS))]


WORKER = """
import sys
import time
from pathlib import Path
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import run_participant
with StudyStore(Path(sys.argv[1])) as store:
    print("ready", flush=True)
    run_participant(store, "sub-001")
"""


@pytest.mark.slow
def test_kills_lose_no_trial(kind: str, tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding", "Drinking"]')
    rng = random.Random(7)
    with StudyStore(folder) as store:
        enrol_with_consent(store)
        planned = [_plan(trial) for trial in store.read_trials("sub-001")]
        completed: set[int] = set()
        for _ in range(5):
            _run_and_kill(folder, rng.uniform(0.0, 0.4))
            now_completed = {
                trial.position for trial in store.read_trials("sub-001") if trial.state == "completed"
            }
            assert completed <= now_completed
            completed = now_completed
            assert [_plan(trial) for trial in store.read_trials("sub-001")] == planned
        if store.read_participant("sub-001").state == "allocated":
            run_participant(store, "sub-001")
        attempts = store.read_attempts("sub-001")
        numbers = Counter(attempt.trial for attempt in attempts)
        for attempt in attempts:
            assert attempt.number <= numbers[attempt.trial]
        assert len({(attempt.trial, attempt.number) for attempt in attempts}) == len(attempts)
        assert Counter(a.state for a in attempts)["completed"] == len(planned)
        assert [t.state for t in store.read_trials("sub-001")] == ["completed"] * len(planned)
        assert len(store.read_answers("sub-001")) >= 8 * len(ITEMS)
    print(
        f"{kind}: {len(completed)} trials despite kills, {len(attempts) - len(planned)} attempts broken off"
    )


def _run_and_kill(folder: Path, after_s: float) -> None:
    """Run a session in another process, and kill it at a random time."""
    command = [sys.executable, "-c", WORKER, folder]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=TESTS, preexec_fn=kill_with_parent) as worker:
        assert worker.stdout is not None
        assert worker.stdout.readline() == b"ready\n"
        time.sleep(after_s)
        worker.kill()


def _plan(trial: Trial) -> tuple:
    return trial.position, trial.environment, trial.policy, trial.seed, trial.practice


# Deletion


def test_deletion_keeps_only_a_tombstone(store: StudyStore) -> None:
    for _ in range(2):
        run_participant(store, enrol_with_consent(store), trials=2)
    add_note(store, "sub-001", "a note")
    kept = store.read_trials("sub-002"), store.read_attempts("sub-002"), store.read_answers("sub-002")
    delete_participant(store, "sub-001")
    assert [participant.pseudonym for participant in store.read_participants()] == ["sub-002"]
    assert (
        store.read_trials("sub-002"),
        store.read_attempts("sub-002"),
        store.read_answers("sub-002"),
    ) == kept
    assert {event.participant for event in store.read_events()} == {2}
    assert [tombstone.number for tombstone in store.read_deleted_participants()] == [1]
    assert len(contents(store)["attempt"]) == len(kept[1])
    refused(store, lambda: delete_participant(store, "sub-003"), "there is no sub-003")


# Several stations


STATION = """
import json, sys
from pathlib import Path
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent
with StudyStore(Path(sys.argv[1])) as store:
    print(json.dumps([enrol_with_consent(store) for _ in range(int(sys.argv[2]))]))
"""


@pytest.mark.slow
def test_parallel_stations_have_distinct_allocations(kind: str, tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding", "Drinking"]')
    each, stations = 4, 3
    command = [sys.executable, "-c", STATION, folder, str(each)]
    running = [
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=TESTS) for _ in range(stations)
    ]
    given = [json.loads(process.communicate(timeout=120)[0]) for process in running]
    assert {process.returncode for process in running} == {0}
    everyone = [pseudonym for pseudonyms in given for pseudonym in pseudonyms]
    assert len(set(everyone)) == each * stations
    with StudyStore(folder) as store:
        participants = store.read_participants()
        filled = Counter(participant.cell for participant in participants)
        assert len(participants) == each * stations
        assert set(filled.values()) == {each * stations // len(make_trial_orders(store.design))}
        seeds = [trial.seed for p in participants for trial in store.read_trials(p.pseudonym)]
        assert len(set(seeds)) == len(seeds)


# Migrations


def latest_revision() -> str | None:
    return ScriptDirectory(str(Path(database.__file__).parent / "migrations")).get_current_head()


@pytest.fixture
def newer(tmp_path: Path) -> Path:
    """The migrations with an additional later one."""
    folder = tmp_path / "migrations"
    shutil.copytree(database.MIGRATIONS_FOLDER, folder, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "versions" / "9999_colour.py").write_text(
        "import sqlalchemy as sa\nfrom alembic import op\n"
        f"revision, down_revision = '9999_colour', '{latest_revision()}'\n"
        "def upgrade():\n    op.add_column('note', sa.Column('colour', sa.String))\n"
    )
    return folder


@pytest.mark.fast_cases(2)
def test_migrations_create_the_tables(store: StudyStore) -> None:
    with store.database.write_transaction() as connection:
        assert compare_metadata(MigrationContext.configure(connection), schema.METADATA) == []


def test_older_study_is_upgraded_after_a_backup(
    store: StudyStore, newer: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_participant(store, enrol_with_consent(store), trials=2)
    before = contents(store)
    store.close()
    monkeypatch.setattr(database, "MIGRATIONS_FOLDER", newer)
    with StudyStore(store.folder) as again:
        assert contents(again) == before
        with again.database.read_transaction() as connection:
            columns = sa.inspect(connection).get_columns("note")
        assert "colour" in {column["name"] for column in columns}
    (backup,) = (store.folder / "backups").iterdir()
    assert backup.name.startswith(f"{latest_revision()}-")
    if kind == "sqlite":
        copy = store.folder / "copy"
        copy.mkdir()
        shutil.copy(store.folder / "study.toml", copy)
        shutil.copy(backup, copy / "study.db")
        monkeypatch.undo()
        with StudyStore(copy) as restored:
            assert contents(restored) == before
    else:
        rows = json.loads(backup.read_text())
        assert {name: len(rows[name]) for name in before} == {name: len(before[name]) for name in before}
        assert rows["participant"][0]["number"] == 1


def study_of_0_2_0(tmp_path: Path, kind: str) -> Path:
    """A study of 0.2.0; on PostgreSQL, tables and rows are copied from its SQLite file."""
    folder = Path(shutil.copytree(OLD_STUDY, tmp_path / "old"))
    if kind == "postgresql":
        url = os.environ[database.DATABASE_URL_VARIABLE].replace("postgresql://", "postgresql+psycopg://")
        old, new = sa.create_engine(f"sqlite:///{folder / 'study.db'}"), sa.create_engine(url)
        with old.begin() as source, new.begin() as target:
            tables = sa.MetaData()
            tables.reflect(source)
            tables.create_all(target)
            for table in tables.sorted_tables:
                if rows := [dict(row) for row in source.execute(sa.select(table)).mappings()]:
                    target.execute(sa.insert(table), rows)
                if rows and "id" in table.c:
                    following = "SELECT setval(pg_get_serial_sequence(:table, 'id'), :last)"
                    target.execute(
                        sa.text(following), {"table": table.name, "last": max(row["id"] for row in rows)}
                    )
        old.dispose()
        new.dispose()
        (folder / "study.db").unlink()
    return folder


@pytest.mark.fast_cases(2)
def test_study_of_0_2_0_is_upgraded(tmp_path: Path, kind: str) -> None:
    folder = study_of_0_2_0(tmp_path, kind)
    with StudyStore(folder) as store:
        assert store.database.find_integrity_errors() == []
        consented = [each for each in store.read_participants() if each.consented_at is not None]
        for participant in consented:
            (consent,) = store.read_consents(participant.pseudonym)
            assert (consent.decided_at, consent.version) == (
                participant.consented_at,
                participant.consent_version,
            )
        assert [attempt.state for attempt in store.read_attempts("sub-001")] == ["completed"]
        assert len(consented) == 1
        with store.database.write_transaction() as connection:
            assert compare_metadata(MigrationContext.configure(connection), schema.METADATA) == []
        enrol_participant(store, "woman")
        assert store.database.find_integrity_errors() == []
    (backup,) = (folder / "backups").iterdir()
    assert backup.name.startswith("0006_headset_check-")


ADDED = {
    "0014_invitations": ["DROP TABLE invitation_use", "DROP TABLE invitation"],
    "0013_caregivers": [
        f"ALTER TABLE {table} DROP COLUMN {column}"
        for table, column in (
            ("participant", "respondent"),
            ("answer", "respondent"),
            ("consent", "role"),
            ("link", "role"),
        )
    ],
    "0012_input_profiles": [
        f"ALTER TABLE {table} DROP COLUMN input_profile" for table in ("participant", "attempt")
    ],
    "0011_links": ["DROP TABLE link"],
    "0010_design": ["DROP TABLE design"],
    "0009_consents": ["DROP TABLE consent", "DROP TABLE consent_text"],
    "0008_log": ["DROP TABLE log", "DROP TABLE experimenter"],
    "0007_records": ["DROP TABLE adverse_event", "ALTER TABLE participant DROP COLUMN functioning"],
}
"""Statements that undo each revision after 0.2.0, newest first."""


@pytest.mark.fast_cases(5)
@pytest.mark.parametrize("revision", database.UNRELEASED_MIGRATION_REVISIONS)
def test_study_of_a_development_version_is_upgraded(store: StudyStore, revision: str) -> None:
    pseudonym = enrol_with_consent(store)
    with store.database.write_transaction() as connection:
        hash_chain.delete_rows(connection, schema.DESIGN_TABLE)
        hash_chain.delete_rows(connection, schema.CONSENT_TEXT_TABLE)
    before, consents = contents(store), store.read_consents(pseudonym)
    with store.database.write_transaction() as connection:
        for undone in itertools.takewhile(lambda each: each != revision, ADDED):
            for statement in ADDED[undone]:
                connection.execute(sa.text(statement))
        connection.execute(sa.text(f"UPDATE alembic_version SET version_num = '{revision}'"))
    store.close()
    newly_written: dict[str, list] = {"consent": [], "ledger": []}
    with StudyStore(store.folder) as again:
        assert {**contents(again), **newly_written} == {**before, **newly_written}
        assert [(each.decided_at, each.sha256) for each in again.read_consents(pseudonym)] == [
            (each.decided_at, each.sha256) for each in consents
        ]
        assert again.database.find_integrity_errors() == []


def test_study_of_a_newer_version_is_rejected(
    store: StudyStore, newer: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(store)
    store.close()
    with monkeypatch.context() as later:
        later.setattr(database, "MIGRATIONS_FOLDER", newer)
        StudyStore(store.folder).close()
    with pytest.raises(
        StudyError,
        match=r"has revision 9999_colour; allowed: 0006_headset_check, 0007_records.*Use the version of AVR Gym that",
    ):
        StudyStore(store.folder)
    monkeypatch.setattr(database, "MIGRATIONS_FOLDER", newer)
    with StudyStore(store.folder) as again:
        assert contents(again) == before


def test_folder_without_a_design_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"contains no study.toml; `avrgym study new"):
        StudyStore(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_unreachable_database_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = small_study(tmp_path)
    monkeypatch.setenv(database.DATABASE_URL_VARIABLE, "mysql://host/name")
    with pytest.raises(
        StudyError, match="AVRGYM_STUDY_DATABASE is not a database URL; allowed: postgresql://"
    ):
        StudyStore(folder)
    monkeypatch.setenv(database.DATABASE_URL_VARIABLE, f"postgresql://nobody@/none?host={tmp_path}")
    with pytest.raises(StudyError, match=r"the study's database: .*connection"):
        StudyStore(folder)
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE)
    (folder / "study.db").write_bytes(b"not a database at all" * 100)
    with pytest.raises(StudyError, match="the study's database: file is not a database"):
        StudyStore(folder)


def test_writes_are_flushed_to_disk(tmp_path: Path) -> None:
    with StudyStore(small_study(tmp_path)) as store, store.database.write_transaction() as connection:
        pragmas = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("synchronous", "journal_mode")
        }
        assert pragmas == {"synchronous": 2, "journal_mode": "wal"}


def test_ended_process_is_not_running() -> None:
    """Also for a zombie process."""
    assert is_process_running(os.getpid())
    with subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.read()
        discard_attempt = time.monotonic() + 60.0
        while is_process_running(process.pid):
            assert time.monotonic() < discard_attempt
            time.sleep(0.01)
        assert process.returncode is None
    assert not is_process_running(process.pid)
