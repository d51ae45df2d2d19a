"""Recordings in an object store, against a real server with the S3 protocol on this computer."""

import shutil
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import typer

pytest.importorskip("boto3", reason="the object store is an extra")
pytest.importorskip("moto", reason="moto is a package for developers")

from avrgym.analysis.study_analysis import analyse_study
from avrgym.cli.replay import replay
from avrgym.recording.answers_file import append_answer, get_answers_path, read_answers
from avrgym.recording.schema import Answer
from avrgym.study.checking.study_checks import check_object_store, check_orphaned_files, check_participants
from avrgym.study.export import export_study
from avrgym.study.export.participant_archive import write_participant_archive
from avrgym.study.merge.study_merge import merge_studies
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.sessions.session_threads import SessionMonitor
from avrgym.study.sessions.study_visit import EventRecorder, StudyVisit
from avrgym.study.storage.object_store import OBJECT_STORE_VARIABLE, ObjectStore
from avrgym.study.storage.remote_recordings import RecordingUploader, fetch_recordings
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.session.events import Answered, TrialBegun, TrialEnded
from helpers.studies.object_store_server import ADDRESS, object_store_server, set_object_store
from helpers.studies.small_studies import enrol_with_consent, run_participant, small_study
from helpers.system.processes import free_port

pytestmark = pytest.mark.filterwarnings("ignore:datetime.datetime.utcnow:DeprecationWarning")


@pytest.fixture(scope="module")
def port() -> int:
    return free_port()


@pytest.fixture(scope="module")
def server(port: int) -> Iterator[None]:
    with object_store_server(port):
        yield


@pytest.fixture
def uploaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, port: int, server: None
) -> Iterator[tuple[StudyStore, dict[str, bytes]]]:
    """A study with two participants, whose recordings are only in the object store, and the contents of its files."""
    set_object_store(monkeypatch, port)
    monkeypatch.setenv(OBJECT_STORE_VARIABLE, f"{ADDRESS}/{tmp_path.name}")
    with StudyStore(small_study(tmp_path / "study")) as store:
        with RecordingUploader(store):
            for _ in range(2):
                run_participant(store, enrol_with_consent(store), 2)
        files = _files(store)
        shutil.rmtree(store.folder / "recordings")
        yield store, files


def _files(store: StudyStore) -> dict[str, bytes]:
    found = (path for path in (store.folder / "recordings").rglob("*") if path.is_file())
    return {path.relative_to(store.folder).as_posix(): path.read_bytes() for path in found}


def _errors(store: StudyStore) -> list[str]:
    checks = (check_object_store, check_participants, check_orphaned_files)
    return [str(each) for check in checks for each in check(store) if each.is_error]


def test_a_check_finds_every_recording_in_the_object_store(
    uploaded: tuple[StudyStore, dict[str, bytes]],
) -> None:
    store, files = uploaded
    assert len(files) == 4
    assert _errors(store) == []
    assert _files(store) == files
    assert all(path.stat().st_mode & 0o77 == 0 for path in (store.folder / "recordings").rglob("*"))


def test_analysis_archive_and_merge_read_recordings_of_the_object_store(
    uploaded: tuple[StudyStore, dict[str, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, files = uploaded
    assert export_study(store, "csv", tmp_path / "csv") > 0
    assert _files(store) == files
    shutil.rmtree(store.folder / "recordings")
    write_participant_archive(store, "sub-001", tmp_path / "sub-001.zip")
    assert _files(store).keys() == {name for name in files if "sub-001" in name}
    with pytest.raises(StudyError, match=f"{OBJECT_STORE_VARIABLE} is set"):
        merge_studies([store.folder], tmp_path / "merged")
    design = store.folder / "study.toml"
    text, empty = design.read_text(), '[recordings]\nurl = ""'
    url = store.object_store.url if store.object_store else ""
    assert text.count('url = ""') == 2
    head, _, tail = text.rpartition('url = ""')
    design.write_text(f'{head}url = "{url}"{tail}')
    assert empty not in design.read_text()
    monkeypatch.delenv(OBJECT_STORE_VARIABLE)
    shutil.rmtree(store.folder / "recordings")
    merge_studies([store.folder], tmp_path / "merged")
    with StudyStore(tmp_path / "merged") as merged:
        assert merged.object_store is None
        assert len(_files(merged)) == len(files)


@pytest.mark.slow
def test_a_report_and_a_verification_read_recordings_of_the_object_store(
    uploaded: tuple[StudyStore, dict[str, bytes]],
) -> None:
    store, files = uploaded
    analysed = analyse_study(store)
    assert sum(row.recording is not None for row in analysed.study_data.trials) == 4
    shutil.rmtree(store.folder / "recordings")
    name = next(iter(files))
    with pytest.raises(typer.Exit):  # a synthetic recording cannot be recomputed
        replay(store.folder / name, verify=True)
    assert _files(store)[name] == files[name]


def test_answers_that_follow_are_uploaded_and_downloaded(
    uploaded: tuple[StudyStore, dict[str, bytes]],
) -> None:
    store, _ = uploaded
    fetch_recordings(store)
    recording = store.resolve_path(store.read_attempts("sub-001")[0].recording)
    for value in (1, 2):
        append_answer(recording, Answer("L1", value, 1.0))
        with RecordingUploader(store):
            pass
    shutil.rmtree(recording.parent)
    fetch_recordings(store)
    assert [each.value for each in read_answers(recording)] == [1, 2]


def test_other_files_of_the_object_store_are_ignored(
    uploaded: tuple[StudyStore, dict[str, bytes]], tmp_path: Path
) -> None:
    store, files = uploaded
    other = tmp_path / "other"
    other.write_bytes(b"x" * 100_000)
    assert store.object_store is not None
    for name in (
        "recordings/sub-001/ses-01/../../../study.toml",
        "recordings/study.toml",
        "recordings/sub-001/x.mcap",
    ):
        store.object_store.upload_file(name, other)
    fetch_recordings(store)
    assert _files(store) == files
    assert (store.folder / "study.toml").stat().st_size < 100_000


def test_a_deletion_removes_recordings_from_the_object_store(
    uploaded: tuple[StudyStore, dict[str, bytes]],
) -> None:
    store, files = uploaded
    delete_participant(store, "sub-001")
    assert store.object_store is not None
    assert store.object_store.list_file_sizes().keys() == {name for name in files if "sub-002" in name}
    assert _errors(store) == []


def test_an_unreachable_object_store_delays_uploads_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port, told = free_port(), list[str]()
    set_object_store(monkeypatch, port)
    monkeypatch.setattr("avrgym.study.storage.remote_recordings.UPLOAD_INTERVAL_S", 0.05)
    with StudyStore(small_study(tmp_path / "study")) as store:
        with RecordingUploader(store, told.append):
            run_participant(store, enrol_with_consent(store), 1)
        assert len(told) == 1
        assert f"the object store {ADDRESS} cannot be used" in told[0]
        assert any("the object store" in each for each in _errors(store))
        files = _files(store)
        with object_store_server(port):
            with RecordingUploader(store, told.append):
                pass
            assert store.object_store is not None
            assert store.object_store.list_file_sizes() == {
                name: len(content) for name, content in files.items()
            }
            assert _errors(store) == []
        assert _files(store) == files


def test_recordings_of_a_temporary_copy_are_uploaded_before_their_attempts_end(
    uploaded: tuple[StudyStore, dict[str, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder may be lost with its computer as soon as the attempt is stored."""
    with StudyStore(small_study(tmp_path / "copy"), temporary=True) as store:
        pseudonym, states = enrol_with_consent(store), list[str]()
        remote = store.object_store
        assert remote is not None

        def upload(name: str, path: Path) -> int:
            states.append(store.read_attempts(pseudonym)[-1].state)
            return ObjectStore.upload_file(remote, name, path)

        monkeypatch.setattr(remote, "upload_file", upload)
        with (
            StudyVisit(store, pseudonym) as visit,
            closing(SessionMonitor(store, visit.stored_session.id)) as watch,
        ):
            record_event = EventRecorder(store, visit.stored_session, visit.trials, watch)
            number = 1 + next(index for index, trial in enumerate(visit.trials) if not trial.practice)
            recording = store.resolve_path(
                f"{visit.stored_session.recordings_folder}/trial-02_attempt-1.mcap"
            )
            recording.parent.mkdir(parents=True)
            recording.write_bytes(next(iter(uploaded[1].values())))
            record_event(TrialBegun(0.0, number, 1, recording))
            record_event(TrialEnded(4.0, number, 1, recording, "completed", True, 3, -1.5, True))
            answer = Answer("L1", 3, 1.0)
            append_answer(recording, answer)
            record_event(Answered(5.0, number, 1, answer))
        assert states == ["running", "completed", "completed"]
        for path in (recording, get_answers_path(recording)):
            assert remote.list_file_sizes()[path.relative_to(store.folder).as_posix()] == path.stat().st_size


def test_a_missing_extra_names_its_installation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_object_store(monkeypatch, 1)
    monkeypatch.setitem(sys.modules, "boto3", None)
    with (
        StudyStore(small_study(tmp_path / "study")) as store,
        pytest.raises(StudyError, match=r"boto3 is missing; run `pip install 'avrgym\[s3\]'`"),
    ):
        fetch_recordings(store)


@pytest.mark.parametrize("url", ["http://bucket", "s3://", "s3://a/../b", "s3://bucket/a b"])
def test_other_addresses_are_rejected(url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(OBJECT_STORE_VARIABLE, url)
    with pytest.raises(StudyError, match="allowed: s3://bucket/folder"):
        StudyStore(small_study(tmp_path / "study"))
