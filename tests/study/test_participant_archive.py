"""The archive of one participant: all their data in open formats, and no data of others."""

import csv
import io
import stat
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipFile

import msgspec
import pytest
from test_adverse_events import DIZZY
from typer.testing import CliRunner

from avrgym.cli import app
from avrgym.recording.schema import Answer
from avrgym.study.export.event_tables import DEFAULT_EXPORT_OPTIONS, make_event_rows
from avrgym.study.export.participant_archive import FILE_DESCRIPTIONS, write_participant_archive
from avrgym.study.merge.study_merge import merge_studies
from avrgym.study.people.adverse_events import record_adverse_event
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import add_note, set_identity
from avrgym.study.storage import identity_file
from avrgym.study.storage.answers import change_trial_answer, record_trial_answer
from avrgym.study.storage.attempts import begin_attempt, end_incomplete_attempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent, record, run_participant, small_study

OTHERS = ("Zora", "zora-note", "zora-event", "sub-002")


def change_an_answer(store: StudyStore, pseudonym: str) -> None:
    """Change an answer; its event has a session and no participant."""
    session = open_session(store, pseudonym)
    trial = store.read_remaining_trials(pseudonym)[0]
    attempt = begin_attempt(store, session.id, trial.position)
    record(store, attempt, trial, simulated=False)
    for value in (3, 4):
        (record_trial_answer if value == 3 else change_trial_answer)(
            store, attempt.id, Answer("L1", value, 1.0)
        )
    end_incomplete_attempt(store, attempt.id, "stopped")
    close_session(store, session.id)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    """Two participants with different data of all kinds."""
    with StudyStore(small_study(tmp_path / "study")) as opened:
        for name in ("Ada", "Zora"):
            pseudonym = enrol_with_consent(opened, simulated=False, name=name, contact=f"{name}@example.org")
            run_participant(opened, pseudonym, trials=2, simulated=False)
            change_an_answer(opened, pseudonym)
            add_note(opened, pseudonym, f"{name.lower()}-note")
            report = msgspec.structs.replace(DIZZY, description=f"{name.lower()}-event")
            record_adverse_event(opened, pseudonym, report, recorded_by="kim")
        set_identity(opened, "sub-001", "Zora", "zora@example.org", confirm_duplicate=True)
        set_identity(opened, "sub-001", "Ada", "ada@example.org")
        yield opened


@pytest.fixture
def archive(store: StudyStore, tmp_path: Path) -> Iterator[ZipFile]:
    write_participant_archive(store, "sub-001", tmp_path / "ada.zip")
    with ZipFile(tmp_path / "ada.zip") as opened:
        yield opened


def rows(archive: ZipFile, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(archive.read(name).decode("utf-8-sig"))))


def test_archive_contains_all_data_of_a_participant(archive: ZipFile, store: StudyStore) -> None:
    assert b'"Ada"' in archive.read("identity.json")
    assert archive.read("inclusion.json")
    counts = {name: len(rows(archive, f"{name}.csv")) for name in ("participants", "trials", "notes")}
    assert counts == {"participants": 1, "trials": 5, "notes": 1}
    assert len(rows(archive, "attempts.csv")) == len(store.read_attempts("sub-001"))
    assert len(rows(archive, "answers.csv")) == len(store.read_answers("sub-001"))
    (event,) = rows(archive, "adverse_events.csv")
    assert (event["description"], event["recorded_by"]) == ("ada-event", "")
    names = [row["name"] for row in rows(archive, "events.csv")]
    assert "answer changed" in names
    assert rows(archive, "consents.csv")[0]["text"] in archive.namelist()
    own = [path for path in (store.folder / "recordings" / "sub-001").rglob("*") if path.is_file()]
    packed = [name for name in archive.namelist() if name.startswith("recordings/")]
    assert len(packed) == len(own) > 0
    assert {archive.read(name) for name in packed} == {path.read_bytes() for path in own}


def test_archive_contains_no_data_of_others(archive: ZipFile) -> None:
    everything = {name: archive.read(name) for name in archive.namelist() if name != "codebook.csv"}
    for other in OTHERS:
        assert [name for name, data in everything.items() if other.encode() in data] == []
    assert len([name for name, data in everything.items() if b"ada-note" in data]) == 1


def test_index_and_codebook_are_complete(archive: ZipFile) -> None:
    index = archive.read("README.md").decode()
    for name in archive.namelist():
        shown = f"{name.split('/')[0]}/" if "/" in name else name
        assert shown in (*FILE_DESCRIPTIONS, "README.md")
        assert name == "README.md" or f"| `{shown}` |" in index
    codebook = rows(archive, "codebook.csv")
    for name in archive.namelist():
        if name.endswith(".csv") and name != "codebook.csv":
            heads = archive.read(name).decode("utf-8-sig").splitlines()[0].split(",")
            assert heads == [row["column"] for row in codebook if f"{row['table']}.csv" == name]


def test_archive_is_private_and_not_overwritten(store: StudyStore, tmp_path: Path) -> None:
    path = tmp_path / "out.zip"
    result = CliRunner().invoke(
        app, ["study", "participant-data", str(store.folder), "sub-001", "--out", str(path)]
    )
    assert result.exit_code == 0, result.output
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    before = path.read_bytes()
    with pytest.raises(StudyError, match="exists already; choose another file"):
        write_participant_archive(store, "sub-001", path)
    assert path.read_bytes() == before
    with pytest.raises(StudyError, match="there is no sub-009"):
        write_participant_archive(store, "sub-009", tmp_path / "nobody.zip")
    assert not (tmp_path / "nobody.zip").exists()


def test_command_reports_whether_the_name_is_included(store: StudyStore, tmp_path: Path) -> None:
    merge_studies([store.folder], tmp_path / "merged")
    identity_file.remove_identity(store.folder, "sub-002")
    for folder, pseudonym, words in (
        (store.folder, "sub-001", "with name, contact and free text"),
        (store.folder, "sub-002", "without name and contact: the identity file has none"),
        (tmp_path / "merged", "sub-1001", "without name and contact: names are in the studies of the sites"),
    ):
        out = tmp_path / f"{pseudonym}.zip"
        said = CliRunner().invoke(
            app, ["study", "participant-data", str(folder), pseudonym, "--out", str(out)]
        )
        assert words in said.stdout.replace("\n", " "), said.output
        assert ("identity.json" in ZipFile(out).namelist()) is ("without" not in words)


def test_deletion_after_a_changed_answer(store: StudyStore) -> None:
    changed = [
        row
        for row in make_event_rows(store, store.read_participants(), DEFAULT_EXPORT_OPTIONS)
        if row.name == "answer changed"
    ]
    assert [row.participant for row in changed] == ["sub-001", "sub-002"]
    delete_participant(store, "sub-001")
    assert [each.pseudonym for each in store.read_participants()] == ["sub-002"]
    names = [
        (row.participant, row.name)
        for row in make_event_rows(store, store.read_participants(), DEFAULT_EXPORT_OPTIONS)
    ]
    assert [pseudonym for pseudonym, name in names if name == "answer changed"] == ["sub-002"]
