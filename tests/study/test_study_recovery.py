"""Lost databases, read-only media and file permissions."""

import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import asdict
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE
from avrgym.recording.reader import read_recording
from avrgym.recording.schema import Answer
from avrgym.study.checking.database_rebuild import rebuild_study_database
from avrgym.study.checking.study_checks import check_study
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import confirm_participation, enrol_participant
from avrgym.study.storage import database, identity_file, store
from avrgym.study.storage.database_rows import TrialAttempt
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent, run_participant, small_study
from helpers.system.paths import DATA

OLD = DATA / "study-of-0.2.0"


@pytest.fixture(autouse=True)
def on_sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A study of an earlier version with twelve completed trials, and a name without trials."""
    return Path(shutil.copytree(OLD, tmp_path / "old"))


@pytest.fixture
def open_umask() -> Iterator[None]:
    before = os.umask(0)
    yield
    os.umask(before)


def avrgym(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# A lost database


@pytest.mark.parametrize("leave", ["private", "recordings", "study.head"])
@pytest.mark.fast_cases(1)
def test_lost_database_is_not_recreated(tmp_path: Path, leave: str) -> None:
    folder = small_study(tmp_path / "study")
    with StudyStore(folder) as opened:
        run_participant(
            opened, enrol_with_consent(opened, simulated=False, name="Ada"), trials=1, simulated=False
        )
    for name in {"study.db", "study.db.sha256", "private", "recordings", "study.head"} - {leave}:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    before = contents(folder)
    for command in ("status", "check", "enrol --body man", "simulate", "delete-participant sub-001"):
        name, *options = command.split()
        refused = avrgym("study", name, folder, *options)
        assert refused.exit_code == 1, command
        assert f"`avrgym study rebuild {folder}`" in refused.stderr
    assert contents(folder) == before
    (folder / "study.db").write_bytes(b"")
    assert avrgym("study", "status", folder).exit_code == 1


def test_lost_database_is_rebuilt_from_recordings(old: Path, tmp_path: Path) -> None:
    kept = Path(shutil.copytree(old, tmp_path / "kept"))
    for name in ("study.db", "study.db.sha256", "study.head"):
        (old / name).unlink()
    before = contents(old)
    rebuilt = rebuild_study_database(old)
    assert (
        rebuilt.participant_count,
        rebuilt.unknown_participation_count,
        rebuilt.attempt_count,
        rebuilt.answer_count,
    ) == (1, 1, 1, 4)
    assert rebuilt.omission_messages == ("sub-002: no recording contains them",)
    assert {name: data for name, data in contents(old).items() if name in before} == before
    with StudyStore(old) as again, StudyStore(kept) as original:
        for name in ("read_trials", "read_attempts"):
            rows, expected = (getattr(each, name)("sub-001") for each in (again, original))
            assert [_facts(row) for row in rows] == [_facts(row) for row in expected]
        in_trials = [answer for answer in original.read_answers("sub-001") if answer.attempt is not None]
        assert [_facts(row) for row in again.read_answers("sub-001")] == [_facts(row) for row in in_trials]
        for attempt in again.read_attempts("sub-001"):
            assert attempt.torso_height_m == (
                read_recording(old / attempt.recording).configuration.person.torso_height_m
            )
        participant = again.read_participant("sub-001")
        assert (participant.state, participant.sex, participant.cell) == ("unknown", "man", 0)
        assert confirm_participation(again, "sub-001", "consent form in folder 2") == "completed"
        wrong = [finding.message for finding in check_study(again) if finding.is_error]
        assert [what for what in wrong if "other users" not in what] == [
            "contains sub-002, who is not in this study; `avrgym study delete-participant` removes the entry"
        ]
        assert enrol_participant(again, "man") == "sub-003"
        delete_participant(again, "sub-002")
    assert identity_file.read_identities(old) == {}
    assert b"Example Person" not in b"".join(contents(old).values())


def _facts(row: object) -> dict:
    """A row without ids and times, which differ after a rebuild."""
    made_anew = ("id", "started_at", "ended_at", "answered_at")
    values = asdict(row) if isinstance(row, Answer) else vars(row)
    facts = {name: value for name, value in values.items() if name not in made_anew}
    if isinstance(row, TrialAttempt):
        facts["metrics"] = (row.metrics.steps, row.metrics.reward, row.metrics.success)
        facts["input_profile"] = row.input_profile or DEFAULT_INPUT_PROFILE  # 0.2.0 had no input profiles
        del facts["torso_height_m"]  # 0.1.0 left it to the recordings
    return facts


def test_existing_database_is_not_rebuilt(old: Path) -> None:
    with StudyStore(old) as opened:
        before = opened.read_participants()
    with pytest.raises(
        StudyError, match="has a database; `avrgym study rebuild` only rebuilds a lost database"
    ):
        rebuild_study_database(old)
    with StudyStore(old) as opened:
        assert opened.read_participants() == before


# A medium that cannot be written


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.fast_cases(1)
def test_read_only_study_can_be_opened(
    old: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, closed: bool
) -> None:
    """Also with data in the write-ahead log of a killed process, and for an earlier version."""
    folder = old
    if not closed:
        used = small_study(tmp_path / "used")
        with StudyStore(used) as opened:
            run_participant(opened, enrol_with_consent(opened))
            folder = Path(shutil.copytree(used, tmp_path / "copied"))
        assert (folder / "study.db-wal").stat().st_size
    shutil.copytree(folder / "recordings", tmp_path / "recordings")
    before = contents(folder)
    monkeypatch.setattr(store, "_can_write", lambda folder: False)
    status = avrgym("study", "status", folder)
    assert "1 of" in status.stdout
    assert avrgym("study", "export", folder, "--format", "csv", "--out", tmp_path / "csv").exit_code == 0
    checked = avrgym("study", "check", folder).stdout
    assert "hash chain" in checked
    assert not any(line.startswith("error  study.") for line in checked.splitlines())
    refused = avrgym("study", "enrol", folder, "--body", "man")
    assert refused.exit_code == 1
    (line,) = refused.stderr.splitlines()
    assert line.endswith("cannot be written: copy the study to a writable folder")
    assert contents(folder) == before


# Files that others may read


@pytest.mark.usefixtures("open_umask")
def test_all_files_are_private(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    assert avrgym("study", "new", folder).exit_code == 0
    with StudyStore(folder) as opened:
        run_participant(
            opened, enrol_with_consent(opened, simulated=False, name="Ada"), trials=1, simulated=False
        )
        assert _open(folder) == []
    assert avrgym("study", "export", folder, "--format", "bids", "--out", tmp_path / "bids").exit_code == 0
    assert _open(folder) == _open(tmp_path / "bids") == []


def _open(folder: Path) -> list[Path]:
    return [each for each in (folder, *folder.rglob("*")) if stat.S_IMODE(each.stat().st_mode) & 0o077]


def test_permissions_are_restricted_on_request(old: Path) -> None:
    for path in (old, *old.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    noted = avrgym("study", "check", old)
    assert "recordings: 4 files or folders can be read by other users; --fix-permissions" in noted.stdout
    fixed = avrgym("study", "check", old, "--fix-permissions")
    assert "other users" not in fixed.stdout
    assert fixed.exit_code == 0
    assert {path.name for path in _open(old)} <= {"old", "study.toml", "plan.toml", "plan-frozen.json"}


# What a killed write leaves


def test_temporary_files_of_killed_writes_are_removed(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    with StudyStore(folder) as opened:
        enrol_with_consent(opened, simulated=False, name="Ada")
        left = folder / "private" / ".identities.json.4194305.part"
        left.write_text('{"sub-001": {"name": "Ada"')
        analysis = folder / "analysis" / ".analysis-x"
        analysis.mkdir(parents=True)
        (analysis / "page.html").write_text("sub-001")
        wrong = {finding.where for finding in check_study(opened) if finding.is_error}
        assert {"private/.identities.json.4194305.part", "analysis/.analysis-x"} <= wrong
    with StudyStore(folder) as opened:
        assert not left.exists()
        left.write_text('{"sub-001": {"name": "Ada"')
        delete_participant(opened, "sub-001")
    assert not left.exists()
    assert not analysis.exists()
    assert b"Ada" not in b"".join(contents(folder).values())
