"""Checks find edits and damage by other programs, and no changes by AVR Gym."""

import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import sqlalchemy as sa

from avrgym.study.checking.finding import Finding
from avrgym.study.checking.study_checks import check_study
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import add_note, enrol_participant, withdraw_participant
from avrgym.study.storage import database, integrity_files, schema
from avrgym.study.storage.attempts import begin_attempt, complete_attempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.flipped_bits import flip_bit, is_detected
from helpers.studies.small_studies import (
    METRICS,
    TORSO_HEIGHT_M,
    enrol_with_consent,
    new_postgresql_database,
    record,
    run_participant,
    small_study,
)
from helpers.system.paths import DATA
from helpers.system.processes import kill_with_parent

OLD = DATA / "study-of-0.2.0"


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A study in each kind of database, and its URL on a server; tests use copies."""
    on_server = request.param == "postgresql"
    url = new_postgresql_database(request.getfixturevalue("postgresql")) if on_server else ""
    return _study(tmp_path_factory.mktemp("made") / "study", url), url


@pytest.fixture
def folder(
    request: pytest.FixtureRequest, made: tuple[Path, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Path:
    """A study in each kind of database: one participant has finished, one has begun."""
    study, url = made
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    if url:
        copy = new_postgresql_database(request.getfixturevalue("postgresql"), like=url)
        monkeypatch.setenv(database.DATABASE_URL_VARIABLE, copy)
    return Path(shutil.copytree(study, tmp_path / "study"))


@pytest.fixture(scope="module")
def made_on_sqlite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _study(tmp_path_factory.mktemp("made") / "study", "")


@pytest.fixture
def on_sqlite(made_on_sqlite: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    return Path(shutil.copytree(made_on_sqlite, tmp_path / "study"))


def _study(folder: Path, url: str) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        if url:
            patch.setenv(database.DATABASE_URL_VARIABLE, url)
        with StudyStore(small_study(folder)) as store:
            run_participant(store, enrol_with_consent(store))
            run_participant(
                store, enrol_with_consent(store, simulated=False, name="Ada"), trials=2, simulated=False
            )
            add_note(store, "sub-002", "laughed")
    return folder


def wrong(folder: Path) -> list[Finding]:
    with StudyStore(folder) as store:
        return [finding for finding in check_study(store) if finding.is_error]


def run_sql(folder: Path, *statements: str) -> None:
    """Edit the database directly."""
    with StudyStore(folder) as store, store.database._engine.begin() as connection:
        for statement in statements:
            connection.execute(sa.text(statement))


# Edits

EDITS = {
    "policies swapped": "UPDATE trial SET policy = CASE policy WHEN 'revised' THEN 'original' ELSE 'revised' END",
    "a better reward": """UPDATE attempt SET figures = '{"steps": 3, "reward": 999, "success": true, "seconds": 4.0}'
                          WHERE id = 2""",
    "an unknown state": "UPDATE participant SET state = 'zombie' WHERE number = 2",
    "another known state": "UPDATE participant SET state = 'withdrawn' WHERE number = 1",
    "events dropped": "DROP TABLE event",
    "an event from the middle": "DELETE FROM event WHERE id = 7",
    "the last events": "DELETE FROM event WHERE id > 30",
    "an answer": "UPDATE answer SET value = 1 WHERE id = 3",
    "its response time": "UPDATE answer SET response_time_s = 1.26 WHERE id = 3",
    "a note": "UPDATE note SET text = 'cried'",
    "an added answer": """INSERT INTO answer (id, session, attempt, item, value, response_time_s, answered_at)
                          VALUES (99, 1, 1, 'L1', 7, 1.0, '2026-01-01')""",
    "an age": "UPDATE participant SET age_years = 23 WHERE number = 1",
    "a consent": "UPDATE participant SET consented_at = '2020-01-01' WHERE number = 1",
    "a checksum": "UPDATE attempt SET sha256 = NULL WHERE id = 1",
    "a protocol": "UPDATE study SET created_at = '2020-01-01'",
    "an entry changed": "UPDATE ledger SET digest = 'x' WHERE number = 9",
    "an entry gone": "DELETE FROM ledger WHERE number = 9",
    "the last entries": "DELETE FROM ledger WHERE number > 40",
    "the whole ledger": "DELETE FROM ledger",
    "no ledger": "DROP TABLE ledger",
    "a stored design": """UPDATE design SET design = '{"title": 3}' WHERE id = 1""",
    "no stored design": "DELETE FROM design",
}  # fmt: skip


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("edit", EDITS)
def test_edited_database_is_found(folder: Path, edit: str) -> None:
    assert wrong(folder) == []
    run_sql(folder, EDITS[edit])
    assert wrong(folder) != []


@pytest.mark.parametrize("more_m", [0.0, 0.01], ids=["same", "taller"])
def test_different_torso_height_in_a_recording_is_found(tmp_path: Path, more_m: float) -> None:
    with StudyStore(small_study(tmp_path)) as store:
        session = open_session(store, enrol_with_consent(store))
        trial = store.read_remaining_trials("sub-001")[0]
        attempt = begin_attempt(store, session.id, trial.position, torso_height_m=TORSO_HEIGHT_M + more_m)
        record(store, attempt, trial)
        complete_attempt(store, attempt.id, METRICS)
        close_session(store, session.id)
    words = "was recorded with another torso height than in the database"
    assert [finding.message for finding in wrong(tmp_path)] == [words] * (more_m > 0.0)


def test_truncated_chain_is_found(folder: Path) -> None:
    run_sql(
        folder,
        "DELETE FROM note",
        "DELETE FROM ledger WHERE number = (SELECT max(number) FROM ledger)",
    )
    assert "an older copy replaced it" in str(wrong(folder))


def test_damaged_rows_raise_errors(folder: Path) -> None:
    run_sql(folder, EDITS["an unknown state"])
    with (
        StudyStore(folder) as store,
        pytest.raises(StudyError, match="unknown state 'zombie'; allowed: enrolled"),
    ):
        store.read_participants()


def test_own_changes_are_no_findings(folder: Path) -> None:
    with StudyStore(folder) as store, StudyStore(folder) as beside:
        assert [finding for finding in check_study(store) if finding.is_error] == []
        withdraw_participant(beside, "sub-002", "felt sick")
        enrol_participant(store, "man")
        assert [finding for finding in check_study(beside) if finding.is_error] == []
    assert wrong(folder) == []


def test_deletion_keeps_a_valid_chain(folder: Path) -> None:
    with StudyStore(folder) as store:
        delete_participant(store, "sub-002")
    assert wrong(folder) == []
    with StudyStore(folder) as store, store.database.read_transaction() as connection:
        kept = sa.select(schema.PARTICIPANT_TABLE.c.salt).where(schema.PARTICIPANT_TABLE.c.number == 2)
        assert connection.execute(kept).first() is None
        entries = connection.execute(
            sa.select(schema.LEDGER_TABLE).where(
                schema.LEDGER_TABLE.c.table == "participant", schema.LEDGER_TABLE.c.key == 2
            )
        ).all()
        assert entries[-1].content is None


def test_rejected_action_adds_no_entry(folder: Path) -> None:
    with StudyStore(folder) as store:
        before = store.database.read_chain_head()
        with pytest.raises(StudyError):
            withdraw_participant(store, "sub-009")
        with pytest.raises(StudyError, match="is not a session of sub-002"):
            add_note(store, "sub-002", "x", session=99)
        assert store.database.read_chain_head() == before
    assert wrong(folder) == []


# SQLite's file


@pytest.mark.slow
def test_flipped_bits_are_found(on_sqlite: Path, tmp_path: Path) -> None:
    assert wrong(on_sqlite) == []
    rng = random.Random(19)
    unnoticed = [
        bit
        for bit in (flip_bit(on_sqlite, tmp_path / "copy", rng, "study.db") for _ in range(25))
        if not is_detected(tmp_path / "copy")
    ]
    assert unnoticed == []


def test_earlier_edit_is_found_after_a_session(on_sqlite: Path) -> None:
    path = on_sqlite / "study.db"
    data = bytearray(path.read_bytes())
    data[_unused(data)] ^= 1
    path.write_bytes(data)
    with StudyStore(on_sqlite) as store:
        enrol_participant(store, "man")
    assert [finding.where for finding in wrong(on_sqlite)] == ["study.db"]
    (on_sqlite / integrity_files.CHECKSUM_MISMATCH_FILE).unlink()
    assert wrong(on_sqlite) == []


def _unused(data: bytearray) -> int:
    """The unused bytes of a database page."""
    return next(at for at in range(8192, len(data)) if not any(data[at - 40 : at + 40]))


def test_older_copy_of_the_database_is_found(on_sqlite: Path, tmp_path: Path) -> None:
    for name in ("study.db", "study.db.sha256"):
        shutil.copy(on_sqlite / name, tmp_path)
    with StudyStore(on_sqlite) as store:
        add_note(store, "sub-002", "a later note")
    for name in ("study.db", "study.db.sha256"):
        shutil.copy(tmp_path / name, on_sqlite)
    assert "an older copy replaced it" in str(wrong(on_sqlite))
    with StudyStore(on_sqlite) as store:
        add_note(store, "sub-002", "it goes on")
    assert "an older copy replaced it" in str(wrong(on_sqlite))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["study.head", "study.db.sha256"])
def test_damaged_integrity_files_are_found(on_sqlite: Path, name: str) -> None:
    path = on_sqlite / name
    data = bytearray(path.read_bytes())
    for bit in range(0, 8 * len(data), 7):
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        assert wrong(on_sqlite) != [], f"bit {bit}"
        data[bit // 8] ^= 1 << bit % 8


def test_missing_head_is_reported(on_sqlite: Path) -> None:
    (on_sqlite / "study.head").unlink()
    assert [finding.where for finding in wrong(on_sqlite)] == ["study.head"]


KILLED = """
import os, sys
from pathlib import Path
from avrgym.study.people.participants import add_note
from avrgym.study.storage.store import StudyStore
store = StudyStore(Path(sys.argv[1]))
print("ready", flush=True)
while True:
    add_note(store, "sub-002", "again")
"""


@pytest.mark.slow
def test_kills_between_transaction_and_checksum_cause_no_finding(folder: Path) -> None:
    """A few of the 200 kills of the soak test."""
    for pause in range(3):
        command = [sys.executable, "-c", KILLED, folder]
        with subprocess.Popen(command, stdout=subprocess.PIPE, preexec_fn=kill_with_parent) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            with StudyStore(folder) as store:
                while len(store.read_notes("sub-002")) < 5 * (pause + 1):
                    pass
            process.kill()
        assert wrong(folder) == []


# Earlier versions


@pytest.mark.slow
def test_study_of_an_earlier_version_keeps_its_hash_chain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = Path(shutil.copytree(OLD, tmp_path / "old"))
    with StudyStore(folder) as store:
        findings = check_study(store)
    assert {finding.where for finding in findings if finding.is_error} <= {"private", "private/key.json"}
    run_sql(folder, "UPDATE answer SET value = 8 - value WHERE id = 1")
    assert "answer 1" in {finding.where for finding in wrong(folder)}
