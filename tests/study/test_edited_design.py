"""Edits of a design after the first session: check, deviations and report list each field."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.cli.plan import read_plan_deviations
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.study.checking.design_checks import check_design
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.policy_files import check_used_policies
from avrgym.study.checking.study_checks import check_study
from avrgym.study.design.design import PublicationDetails
from avrgym.study.plan.frozen_plan import read_frozen_plan_evidence
from avrgym.study.plan.plan_deviations import read_frozen_design
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database
from avrgym.study.storage.attempts import begin_attempt, complete_attempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.design_edits import DESIGN, EDITS, edit, make_edited_study, participate
from helpers.studies.known_results import record_trial

POLICY = "mine/FeedingJaco.safetensors"
FIXED = {
    "seed": ("seed = 0", "seed = 1"),
    "tasks": ('tasks = ["Feeding"]', 'tasks = ["Drinking"]'),
    "robots": ('robots = ["PR2", "Jaco"]', 'robots = ["Jaco"]'),
    "policies": ('policies = ["original", "mine"]', 'policies = ["mine"]'),
    "practice_policy": ('practice_policy = "revised"', 'practice_policy = ""'),
    "trial_steps": ("trial_steps = 200", "trial_steps = 100"),
}


@pytest.fixture(autouse=True, scope="module")
def on_sqlite() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with a frozen plan and two participants, one in each language."""
    folder = make_edited_study(tmp_path_factory.mktemp("made") / "study")
    for _ in range(2):
        result = CliRunner().invoke(app, ["study", "freeze", str(folder)])
        assert result.exit_code == 0, result.stderr
    with StudyStore(folder) as store:
        for language in ("en", "de"):
            participate(store, language, simulated=False, trials=2)
    return folder


@pytest.fixture(scope="module")
def undone(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same study after edits of all fields, two more participants, and the reversal of all edits."""
    folder = Path(shutil.copytree(made, tmp_path_factory.mktemp("undone") / "study"))
    edit(folder, *EDITS)
    with StudyStore(folder) as store:
        participate(store, "de", simulated=False, trials=2)
    for name in {each.file for each in EDITS.values()}:
        shutil.copy(made / name, folder / name)
    languages = 'languages = ["en", "de"]', 'languages = ["en"]'
    (folder / DESIGN).write_text((folder / DESIGN).read_text().replace(*languages))
    with StudyStore(folder) as store:
        participate(store, "en", simulated=False, trials=2)
    shutil.copy(made / DESIGN, folder / DESIGN)
    return folder


@pytest.fixture(scope="module")
def found(undone: Path) -> list[Finding]:
    with StudyStore(undone) as store:
        return list(check_design(store))


@pytest.fixture(scope="module")
def deviating(undone: Path) -> list[str]:
    with StudyStore(undone) as store:
        return [f"{each.where}: {each.message}" for each in read_plan_deviations(store)[1]]


def naming(found: list[Finding], name: str) -> list[Finding]:
    """The findings about an edited field."""
    each = EDITS[name]
    return [one for one in found if one.where == each.where and f"{each.field} is " in f"{one.message} "]


def test_unedited_design_has_no_findings(made: Path) -> None:
    with StudyStore(made) as store:
        assert list(check_design(store)) == []
        assert [each.message for each in check_study(store) if each.is_error] == []
        deviations = [each.message for each in read_plan_deviations(store)[1]]
    assert deviations == []


@pytest.mark.fast_cases(8)
@pytest.mark.parametrize("name", EDITS)
def test_edit_after_a_session_is_found(made: Path, tmp_path: Path, name: str) -> None:
    folder = Path(shutil.copytree(made, tmp_path / "study"))
    each = EDITS[name]
    edit(folder, each.by or name)
    with StudyStore(folder) as store:
        (finding,) = naming(list(check_design(store)), name)
    assert f"{each.field} is {each.then}" in finding.message
    assert f"it was {each.was}" in finding.message
    assert "sub-002" in finding.message
    assert finding.is_error is each.is_error


@pytest.mark.parametrize("name", EDITS)
def test_undone_edit_is_found(found: list[Finding], name: str) -> None:
    (finding,) = naming(found, name)
    each = EDITS[name]
    assert f"{each.field} is {each.was}" in finding.message
    assert f"it was {each.then}" in finding.message
    assert "sub-003" in finding.message
    assert not any(other in finding.message for other in ("sub-001", "sub-002", "sub-004"))
    assert finding.is_error is each.is_error


@pytest.mark.parametrize("name", EDITS)
def test_undone_edit_is_a_deviation(deviating: list[str], name: str) -> None:
    each = EDITS[name]
    (told,) = [one for one in deviating if one.startswith(f"{each.where}: {each.field} was ")]
    assert f"was {each.was}" in told
    assert f"in the plan and {each.then}" in told
    assert told.removesuffix(" (trials 1 to 2)").endswith(" for sub-003")


def test_changed_languages_are_found(found: list[Finding], deviating: list[str]) -> None:
    (finding,) = [each for each in found if each.message.startswith("languages is ")]
    assert (finding.is_error, finding.message) == (
        True,
        'languages is ["en", "de"]; it was ["en"] for sub-004 (trials 1 to 2)',
    )
    assert sum("languages was" in each for each in deviating) == 1


@pytest.mark.parametrize("when", ["not at all", "in between", "afterwards"])
def test_changed_policy_is_found(made: Path, tmp_path: Path, when: str) -> None:
    """The file of a policy changes between two sessions, or after both."""
    folder = Path(shutil.copytree(made, tmp_path / "study"))
    before = (folder / POLICY).read_bytes()
    other = find_packaged_policies("avrgym/FeedingJaco-v1")["original"].read_bytes()
    with StudyStore(folder) as store:
        for pseudonym in ("sub-001", "sub-002"):
            StudyVisit(store, pseudonym).close()
            if when == "in between":
                (folder / POLICY).write_bytes(other)
        (folder / POLICY).write_bytes(other if when == "afterwards" else before)
        found = list(check_used_policies(store))
        deviating = [each for each in read_plan_deviations(store)[1] if each.where == "policy mine"]
    assert [(each.where, each.is_error) for each in found] == {
        "not at all": [],
        "in between": [("policy mine", True)],
        "afterwards": [("policy mine", False)],
    }[when]
    assert len(deviating) == (when != "not at all")
    if when == "in between":
        assert "was not the same in all sessions" in found[0].message
        assert deviating[0].message.endswith("for sub-002 (no trial)")


@pytest.mark.parametrize("guard", [True, False])
def test_contradicting_recording_is_found(made: Path, tmp_path: Path, guard: bool) -> None:
    """A different force guard is an error; a different seat is a note."""
    folder = Path(shutil.copytree(made, tmp_path / "study"))
    with StudyStore(folder) as store:
        participant = store.read_participant("sub-001")
        session = open_session(store, participant.pseudonym)
        trial = store.read_remaining_trials(participant.pseudonym)[0]
        attempt = begin_attempt(store, session.id, trial.position)
        seat = RealFurniture(seat_height_m=0.4)
        metrics = record_trial(
            store.resolve_path(attempt.recording),
            store.design,
            participant,
            trial,
            force_guard=guard,
            furniture=seat,
        )
        complete_attempt(store, attempt.id, metrics)
        close_session(store, session.id)
        found = {each.message.partition(" than")[0]: each.is_error for each in check_design(store)}
    expected = {"was recorded with another furniture.seat_height_m": False}
    assert found == (expected if guard else expected | {"was recorded with another force_guard": True})


def test_changed_reporting_is_no_finding(made: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(made, tmp_path / "study"))
    text = (folder / DESIGN).read_text()
    for name in PublicationDetails.__struct_fields__:
        assert f'\n{name} = ""' in text
        text = text.replace(f'\n{name} = ""', f'\n{name} = "known"')
    (folder / DESIGN).write_text(text)
    with StudyStore(folder) as store:
        assert list(check_design(store)) == []
        assert read_plan_deviations(store)[1] == []


def test_plan_record_cannot_write_outside_its_folder(made: Path, tmp_path: Path) -> None:
    with StudyStore(made) as store:
        frozen = read_frozen_plan_evidence(store)
    assert frozen is not None
    assert frozen.frozen_plan is not None
    record = msgspec.structs.replace(frozen.frozen_plan, texts={str(tmp_path / "elsewhere.toml"): "x = 1"})
    assert read_frozen_design(frozen.frozen_plan) is not None
    assert read_frozen_design(record) is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", FIXED)
def test_fields_of_trial_orders_cannot_change(made: Path, tmp_path: Path, name: str) -> None:
    folder = Path(shutil.copytree(made, tmp_path / "study"))
    text = (folder / DESIGN).read_text()
    assert FIXED[name][0] in text
    (folder / DESIGN).write_text(text.replace(*FIXED[name]))
    with pytest.raises(StudyError, match=f"{name} changed after the first participant"):
        StudyStore(folder)
