"""The commands of ``avrgym study`` and the findings of its check."""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.recording.configuration import BodyModel
from avrgym.recording.schema import Answer
from avrgym.recording.writer import RecordingWriter
from avrgym.study.checking.study_checks import check_study
from avrgym.study.storage import database, identity_file, schema
from avrgym.study.storage.answers import record_trial_answer
from avrgym.study.storage.attempts import begin_attempt
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.store import StudyStore
from helpers.studies.configurations import trial_configuration
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant, small_study
from helpers.system.paths import ROOT

FIRST = "recordings/sub-001/ses-01/trial-01_attempt-1.mcap"
SECOND = "recordings/sub-001/ses-01/trial-02_attempt-1.mcap"


def study(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["study", *(str(argument) for argument in arguments)])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study with a finished participant and one who has begun."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = small_study(tmp_path / "study")
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store))
        run_participant(
            store, enrol_with_consent(store, simulated=False, name="Ada"), trials=2, simulated=False
        )
    return folder


@pytest.fixture
def store(folder: Path) -> Iterator[StudyStore]:
    with StudyStore(folder) as opened:
        yield opened


def test_complete_study_on_the_command_line(folder: Path, tmp_path: Path) -> None:
    shown = study("status", folder, "--json", tmp_path / "status.json")
    assert shown.exit_code == 0
    assert "1 of 8 participants completed, 0 withdrew, 0 excluded, 0 deleted" in shown.stdout
    status = json.loads((tmp_path / "status.json").read_text())
    assert (status["simulated"], status["filled"], status["completed_cells"]) == (
        1,
        [2, 0, 0, 0],
        [1, 0, 0, 0],
    )
    assert [row["trials_completed"] for row in status["participants"]] == [5, 2]
    assert [row["simulated"] for row in status["participants"]] == [True, False]

    checked = study("check", folder, "--json", tmp_path / "check.json")
    assert checked.exit_code == 0
    assert not any(finding["is_error"] for finding in json.loads((tmp_path / "check.json").read_text()))
    assert "no errors" in checked.stdout

    exported = study("export", folder, "--format", "csv", "--out", tmp_path / "tables")
    assert exported.exit_code == 0
    assert "pseudonymised, not anonymous" in exported.stdout
    assert (tmp_path / "tables" / "trials.csv").is_file()

    deleted = study("delete-participant", folder, "sub-002")
    assert deleted.exit_code == 0
    assert "1 deleted" in study("status", folder).stdout
    assert study("check", folder).exit_code == 0


@pytest.mark.slow
def test_new_study_is_not_overwritten(tmp_path: Path) -> None:
    assert study("new", tmp_path / "study").exit_code == 0
    again = study("new", tmp_path / "study")
    assert again.exit_code == 1
    assert "contains study.toml already" in again.stderr
    status = study("status", tmp_path / "study")
    assert status.exit_code == 0
    assert "0 of 8 participants completed" in status.stdout


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["status", "nowhere"], "nowhere contains no study.toml; `avrgym study new nowhere` creates it"),
        (["check", "nowhere"], "contains no study.toml"),
        (["export", "STUDY", "--format", "xlsx", "--out", "new"], "unknown format 'xlsx'; allowed: csv, bids"),
        (["export", "STUDY", "--format", "csv", "--out", "STUDY"], "is not empty"),
        (["delete-participant", "STUDY", "sub-009"], "there is no sub-009"),
        (["delete-participant", "STUDY", "../x"], "'../x' is not a pseudonym; allowed: sub-001"),
        (["status", "STUDY", "--json", "no/such/file.json"], "the folder no/such does not exist"),
    ],
)  # fmt: skip
def test_errors_have_one_line(folder: Path, arguments: list[str], message: str) -> None:
    result = study(*(str(folder) if argument == "STUDY" else argument for argument in arguments))
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith("avrgym: ")
    assert message in line


def test_documented_python_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "how_to" / "study_in_python.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(code, {})
    assert len(capsys.readouterr().out.splitlines()) == 20
    with StudyStore(tmp_path / "my-study") as store:
        assert [session.state for session in store.read_sessions("sub-001")] == ["closed"]


# What the check finds


def _flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def _forget_an_answer(store: StudyStore) -> None:
    with store.database.write_transaction() as connection:
        connection.execute(sa.delete(schema.ANSWER_TABLE).where(schema.ANSWER_TABLE.c.id == 2))


def _change(table: sa.Table, **values: int | str) -> Callable[[StudyStore], None]:
    def change(store: StudyStore) -> None:
        with store.database.write_transaction() as connection:
            connection.execute(sa.update(table).where(table.c.id == 2).values(**values))

    return change


def _mark(store: StudyStore, simulated: bool) -> None:
    with store.database.write_transaction() as connection:
        connection.execute(sa.update(schema.PARTICIPANT_TABLE).values(simulated=simulated))


DAMAGES: dict[str, tuple[Callable[[StudyStore], object], str, str]] = {
    "missing": (lambda s: s.resolve_path(FIRST).unlink(), FIRST, "is missing"),
    "changed": (lambda s: _flip(s.resolve_path(FIRST)), FIRST, "its checksum differs"),
    "empty": (lambda s: s.resolve_path(FIRST).write_bytes(b""), FIRST, "cannot be read"),
    "stray": (lambda s: s.resolve_path("recordings/x.mcap").write_bytes(b""), "recordings/x.mcap", "belongs to "
    "no attempt"),
    "link": (lambda s: s.resolve_path("recordings/x").symlink_to("/"), "recordings/x", "belongs to no attempt"),
    "answer gone": (_forget_an_answer, SECOND, "completed without answers to L2"),
    "answer changed": (_change(schema.ANSWER_TABLE, value=7), SECOND, "with another answer"),
    "seed changed": (_change(schema.TRIAL_TABLE, seed=1), SECOND, "with another seed"),
    "person marked": (lambda s: _mark(s, simulated=False), FIRST, "with another simulated"),
    "trial undone": (_change(schema.TRIAL_TABLE, state="planned"), "trial 2 of sub-001", "is planned with 1 completed"),
    "escape": (_change(schema.ATTEMPT_TABLE, recording="../../x.mcap"), "../../x.mcap", "is outside the study's "
    "folder"),
    "open names": (
        lambda s: s.resolve_path("private/identities.json").chmod(0o644), "private/identities.json", "other users",
    ),
    "stranger": (
        lambda s: identity_file.store_identity(s.folder, "sub-009", identity_file.Identity("Ada", "")),
        "private/identities.json", "contains sub-009, who is not in this study",
    ),
}  # fmt: skip


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("damage", DAMAGES)
def test_check_reports_each_damage(folder: Path, store: StudyStore, damage: str) -> None:
    act, where, what = DAMAGES[damage]
    act(store)
    findings = check_study(store)
    assert any(
        finding.is_error and finding.where == where and what in finding.message for finding in findings
    )
    checked = study("check", folder)
    assert checked.exit_code == 1
    assert re.search(rf"error  {re.escape(where)}: .*{re.escape(what)}", checked.stdout)


def test_missing_policy_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = make_study(tmp_path, tasks='["Feeding"]', policies='["mine", "revised"]', robots='["Jaco"]')
    with StudyStore(folder) as store:
        (finding,) = check_study(store)
        assert (finding.where, finding.is_error) == ("policy mine", True)
        assert (
            "no policy 'mine' for avrgym/FeedingJaco-v1; allowed: adaptive, original, revised"
            in finding.message
        )
        own = folder / "mine" / "FeedingJaco.safetensors"
        own.parent.mkdir()
        shutil.copy(find_packaged_policies("avrgym/FeedingJaco-v1")["original"], own)
        assert check_study(store) == []
        assert store.find_policy_source("avrgym/FeedingJaco-v1", "mine") == str(own)
        assert store.find_policy_source("avrgym/FeedingJaco-v1", "revised") == "revised"


def test_running_attempt_is_no_fault(store: StudyStore) -> None:
    session = open_session(store, "sub-002")
    begin_attempt(store, session.id, store.read_remaining_trials("sub-002")[0].position)
    assert not any(finding.is_error for finding in check_study(store))


def test_truncated_recording_may_lack_answers(store: StudyStore) -> None:
    session = open_session(store, "sub-002")
    trial = store.read_remaining_trials("sub-002")[0]
    attempt = begin_attempt(store, session.id, trial.position)
    person = BodyModel("woman", 0.55, "fair")
    configuration = trial_configuration(store.design, trial, simulated=False, person=person)
    RecordingWriter(store.resolve_path(attempt.recording), configuration).close()
    record_trial_answer(store, attempt.id, Answer("L1", 6, 1.25))
    assert not any(finding.is_error for finding in check_study(store))


def test_recordings_of_other_stations_are_notes(folder: Path, store: StudyStore) -> None:
    store.station_name = "elsewhere"
    store.resolve_path(FIRST).unlink()
    (finding,) = (finding for finding in check_study(store) if finding.where == FIRST)
    assert not finding.is_error
    assert "is at another station; it was recorded at" in finding.message
