"""Plans of a study: errors of invalid plans, freezing, and deviations."""

import json
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner, Result

from avrgym.analysis.plan import list_required_tests, suggest_hypotheses
from avrgym.cli.main import app
from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text
from avrgym.study.design.design_comparison import find_value_differences
from avrgym.study.people.participants import (
    enrol_participant,
    record_consent,
    record_inclusion_answers,
    withdraw_participant,
)
from avrgym.study.plan.analysis_plan import CONFIRMATORY_STATUS, EXPLORATORY_STATUS, parse_analysis_plan
from avrgym.study.plan.frozen_plan import FROZEN_PLAN_FILE, FrozenPlanEvidence, read_frozen_plan_evidence
from avrgym.study.plan.plan_deviations import describe_change, find_deviations
from avrgym.study.plan.plan_template import format_plan_template
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import (
    eligible_answers,
    enrol_with_consent,
    make_study,
    run_participant,
    small_study,
)

DESIGN = parse_design(read_default_design_text())
OFFERED = list_required_tests(DESIGN)
TEXT = format_plan_template(DESIGN, OFFERED, suggest_hypotheses(DESIGN))
SESSION_ITEMS = """
[[questionnaires]]
name = "csq"
when = ["before_session", "after_session"]
items = [{ id = "C1", text = "I feel \\"sick\\".", points = 7, low = "no", high = "yes" }]
"""
DESIGNS = {
    "the paper's": read_default_design_text(),
    "one policy": read_default_design_text().replace('["original", "revised"]', '["revised"]'),
    "items about sessions": read_default_design_text().replace("[goals]", f"{SESSION_ITEMS}\n[goals]"),
    "a title that TOML escapes": read_default_design_text().replace(
        'title = "', 'title = "\\"A\\"\\u0007\\n'
    ),
    "no items": read_default_design_text()[: read_default_design_text().index("\n[[questionnaires]]\n")]
    + read_default_design_text()[read_default_design_text().index("\n[goals]") :],
}


@pytest.fixture(autouse=True)
def on_sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


def study(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["study", *(str(argument) for argument in arguments)])


# Plans


@pytest.mark.parametrize("text", DESIGNS.values(), ids=list(DESIGNS))
def test_template_of_each_design_is_a_complete_plan(text: str) -> None:
    design = parse_design(text)
    offered = list_required_tests(design)
    plan = parse_analysis_plan(
        format_plan_template(design, offered, suggest_hypotheses(design)), "plan.toml", design, offered
    )
    labels = {
        plan.find_test_status(test, measure) for test, measures in offered.items() for measure in measures
    }
    assert labels == {CONFIRMATORY_STATUS, EXPLORATORY_STATUS}
    assert plan.participants == design.participants


ITEMS = 'measures = ["L1", "L2", "L3", "L4"]'
BAD = {
    "a test": ('tests = ["policies, by participant"]', 'tests = ["ANOVA"]', "unknown test 'ANOVA'; allowed: \"L1 aga"),
    "an exploratory test": ('    "policies, by trial",', '    "policies",', "unknown test 'policies'; allowed: "),
    "a measure": (ITEMS, 'measures = ["L1", "L5"]', "unknown measure 'L5'; allowed: \"L1\", \"L2\""),
    "a measure of another test": (ITEMS, 'measures = ["torso_height_m"]', "the measure 'torso_height_m'; allowed"),
    "a test of another measure": (
        'tests = ["L1 against the middle, by participant"]',
        'tests = ["L1 against the middle, by participant", "torso heights, by trial"]',
        "'torso heights, by trial' has no measure of H1; allowed measures: \"torso_height_m\"",
    ),
    "a number": ("participants = 8", "participants = 12", "participants is 12; allowed: 8, as in study.toml"),
    "an exclusion rule": ("max_held_share = 0.05", "max_held_share = 0.2", "is 0.2; allowed: 0.05, as in study.toml"),
    "an unknown rule": ("further = []", "outliers = []", "unknown name 'outliers'; allowed: max_held_share, further"),
    "an unknown field": ('measures = ["L1"]', 'measure = ["L1"]', "unknown name 'measure'; allowed: id, text, "),
    "two of a name": ('id = "H2"', 'id = "H1"', "'H1' is used twice; allowed: once"),
    "no TOML": ("participants = 8", "participants = ", "invalid TOML"),
}  # fmt: skip


@pytest.mark.parametrize(("before", "after", "words"), BAD.values(), ids=list(BAD))
def test_error_of_an_invalid_plan_has_line_and_allowed_values(before: str, after: str, words: str) -> None:
    assert TEXT.count(before) == 1
    text = TEXT.replace(before, after)
    with pytest.raises(DesignError) as refused:
        parse_analysis_plan(text, "plan.toml", DESIGN, OFFERED)
    message = str(refused.value)
    assert words in message
    line = int(message.split(":")[1])
    assert text.splitlines()[line - 1].strip() in after or after.split("=")[0] in text.splitlines()[line - 1]


def test_invalid_plan_is_not_frozen(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study")
    (folder / "plan.toml").write_text(TEXT.replace("participants = 8", "participants = 9"))
    shown = study("freeze", folder)
    assert (shown.exit_code, shown.stderr.count("\n")) == (1, 1)
    assert not (folder / FROZEN_PLAN_FILE).exists()


def test_differences_are_listed_by_value() -> None:
    before = {"a": 1, "b": {"c": [1, 2]}, "items": [{"id": "x"}, {"id": "y"}], "gone": "?" * 200}
    after = {"a": 2, "b": {"c": [1, 3]}, "items": [{"id": "x"}, {"id": "z"}, {"id": "w"}], "new": True}
    assert list(find_value_differences(before, before)) == []
    assert [describe_change(*each) for each in find_value_differences(before, after)] == [
        "a was 1, is 2",
        "b.c was [1, 2], is [1, 3]",
        'items 2.id was "y", is "z"',
        'items 3 was added: {"id": "w"}',
        f'gone was removed; it was "{"?" * 78}…',
        "new was added: true",
    ]


# Freezing


def test_plan_is_frozen_once(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    assert "contains no plan.toml" in study("freeze", folder, "--export", "osf").stderr
    assert study("freeze", folder).exit_code == 0
    written = (folder / "plan.toml").read_bytes()
    assert not (folder / FROZEN_PLAN_FILE).exists()
    again = study("freeze", folder, "--template")
    assert (again.exit_code, "exists already and was not changed" in again.stderr) == (1, True)

    assert study("freeze", folder).exit_code == 0
    record = (folder / FROZEN_PLAN_FILE).read_bytes()
    assert (folder / "plan.toml").read_bytes() == written
    again = study("freeze", folder)
    assert (again.exit_code, "is frozen already" in again.stderr) == (1, True)
    assert (folder / FROZEN_PLAN_FILE).read_bytes() == record
    status = study("status", folder, "--json", tmp_path / "status.json")
    assert "deviations: 0" in status.stdout
    assert json.loads((tmp_path / "status.json").read_text())["deviations"] == []
    assert study("check", folder).stdout.count("deviates") == 0


def test_plan_cannot_be_frozen_after_the_first_participant(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    assert study("freeze", folder).exit_code == 0
    with StudyStore(folder) as store:
        someone = enrol_with_consent(store, simulated=False)
    with StudyStore(folder) as store:
        run_participant(store, someone, trials=1, simulated=False)
    for arguments in ([], ["--template"], ["--export", "osf"]):
        refused = study("freeze", folder, *arguments)
        assert refused.exit_code == 1
        assert "sub-001 has already taken part" in refused.stderr
    assert not (folder / FROZEN_PLAN_FILE).exists()
    assert "frozen" not in study("status", folder).stdout


def test_plan_cannot_be_frozen_without_its_policies(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', policies='["original", "mine"]')
    study("freeze", folder)
    refused = study("freeze", folder)
    assert (refused.exit_code, "policy mine: no policy 'mine'" in refused.stderr) == (1, True)
    assert not (folder / FROZEN_PLAN_FILE).exists()


def test_database_contains_the_checksum_of_the_record(tmp_path: Path) -> None:
    folder = _frozen(small_study(tmp_path / "study"))
    record = (folder / FROZEN_PLAN_FILE).read_bytes()
    (folder / FROZEN_PLAN_FILE).write_bytes(record.replace(b"higher", b"lower"))
    shown = study("check", folder)
    assert (
        shown.exit_code,
        f"error  {FROZEN_PLAN_FILE}: deviates from the plan: was modified" in shown.stdout,
    ) == (
        1,
        True,
    )
    (folder / FROZEN_PLAN_FILE).unlink()
    assert f"{FROZEN_PLAN_FILE}: is missing" in study("status", folder).stdout
    (folder / FROZEN_PLAN_FILE).write_bytes(record)
    assert study("check", folder).exit_code == 0


@pytest.mark.slow
def test_record_remains_after_loss_of_the_database(tmp_path: Path) -> None:
    """A new database lacks the plan, which is an error; deviations are still listed."""
    folder = _frozen(small_study(tmp_path / "study"))
    for lost in ("study.db", "study.db.sha256", "study.head"):
        (folder / lost).unlink()
    with open(folder / "study.toml", "a") as file:
        file.write("# later\n")
    shown = study("check", folder)
    assert (shown.exit_code, f"error  {FROZEN_PLAN_FILE}: deviates" in shown.stdout) == (1, True)
    assert "study.toml: was changed" in study("status", folder).stdout
    assert "adopted" in study("freeze", folder).stdout
    assert "is frozen already" in study("freeze", folder).stderr
    assert study("check", folder).exit_code == 0


@pytest.mark.parametrize("form", ["osf", "aspredicted"])
def test_preregistration_contains_facts_of_the_study(tmp_path: Path, form: str) -> None:
    folder = _frozen(make_study(tmp_path / "study"))
    for _ in range(2):
        assert study("freeze", folder, "--export", form).exit_code == 0
    text = (folder / f"preregistration-{form}.md").read_text()
    for fact in (
        "The robot successfully assisted me with the task. From 1 (strongly disagree) to 7 (strongly agree)",
        "4 × 2 × 2 conditions",
        "4 orders",
        "8 participants",
        "for more than 5 % of the time",
        "H2: policies, by participant (L1; L2; L3; L4)",
        "Frozen with AVR Gym",
    ):
        assert fact in text, fact
    (folder / f"preregistration-{form}.md").write_text("mine")
    assert "exists already with another text" in study("freeze", folder, "--export", form).stderr
    assert "allowed: osf, aspredicted" in study("freeze", folder, "--export", "word").stderr


def _frozen(folder: Path) -> Path:
    assert [study("freeze", folder).exit_code for _ in range(2)] == [0, 0]
    return folder


# Deviations


def test_all_deviations_are_listed(tmp_path: Path) -> None:
    folder = make_study(
        tmp_path / "study",
        tasks='["Feeding"]',
        policies='["original", "mine"]',
        practice_policy='""',
        participants="2",
    )
    (folder / "mine").mkdir()
    for robot in ("Jaco", "PR2"):
        packaged = find_packaged_policies(f"avrgym/Feeding{robot}-v1")
        (folder / "mine" / f"Feeding{robot}.safetensors").write_bytes(packaged["revised"].read_bytes())
    study("freeze", folder)
    plan = folder / "plan.toml"
    plan.write_text(plan.read_text().replace('    "torso heights, by trial",\n', ""))
    study("freeze", folder)
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store, simulated=False), simulated=False)
        withdraw_participant(store, enrol_with_consent(store, simulated=False))
        out = enrol_participant(store, "man")
        record_consent(store, out)
        record_inclusion_answers(store, out, {name: not yes for name, yes in eligible_answers(store).items()})
    person = find_packaged_policies("avrgym/FeedingJaco-v1")["original"].read_bytes()
    (folder / "mine" / "FeedingJaco.safetensors").write_bytes(person)
    design = folder / "study.toml"
    design.write_text(design.read_text().replace("free_movement_s = 5.0", "free_movement_s = 4.0"))
    plan.write_text(plan.read_text().replace("higher with mine", "lower with mine"))
    record = (folder / FROZEN_PLAN_FILE).read_text()

    shown = study("status", folder).stdout
    expected = {
        "study.toml: free_movement_s was 5.0, is 4.0",
        'plan.toml: hypotheses 2.text was "Participants rate L1, L2, L3, L4 higher with mine than with',
        "policy mine: of avrgym/FeedingJaco-v1 was changed: the checksum of mine/FeedingJaco.safetensors",
        "sub-002: withdrew and is excluded from all tests",
        "sub-003: was excluded by the inclusion questions",
        "participants: 1 has completed the study, 2 were planned",
        "the report: contains a test that is not in the plan: torso heights, by trial (torso_height_m)",
    }
    listed = [line for line in shown.splitlines() if line.startswith("deviation")]
    assert {words for words in expected if words not in shown} == set()
    assert f"deviations: {len(listed)}" in shown
    assert len(listed) == len(expected)
    checked = study("check", folder)
    assert checked.stdout.count("deviates from the plan") == len(expected)
    assert "error  study.toml: free_movement_s is 4.0; it was 5.0 for all participants" in checked.stdout
    assert (checked.exit_code, (folder / FROZEN_PLAN_FILE).read_text()) == (1, record)


def test_changed_software_is_a_deviation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = _frozen(small_study(tmp_path / "study"))
    with StudyStore(folder) as store:
        frozen = read_frozen_plan_evidence(store)
    assert frozen is not None
    assert frozen.frozen_plan is not None
    before = frozen.frozen_plan.versions["scipy"]
    monkeypatch.setattr("avrgym.study.plan.frozen_plan.version", lambda name: f"{name} 0")
    assert f"software: scipy was {before}, is scipy 0" in study("status", folder).stdout


def test_changed_comment_is_reported(tmp_path: Path) -> None:
    folder = _frozen(small_study(tmp_path / "study"))
    with open(folder / "study.toml", "a") as file:
        file.write("# later\n")
    assert "study.toml: was changed only in comments or layout" in study("status", folder).stdout


def test_changed_texts_for_participants_are_a_deviation(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', languages='["en", "de"]')
    german, english = folder / "texts" / "de.toml", folder / "texts" / "en.toml"
    german.parent.mkdir()
    german.write_text('[sentences]\n"strongly agree" = "voll und ganz"\n')
    _frozen(folder)
    assert "deviations: 0" in study("status", folder).stdout

    german.write_text('[sentences]\n"strongly agree" = "ja"\n')
    shown = study("status", folder).stdout
    assert 'texts/de.toml: sentences.strongly agree was "voll und ganz", is "ja"' in shown
    german.unlink()
    english.write_text('name = "Plain English"\n')
    shown = study("status", folder).stdout
    assert "deviation  texts/de.toml: is missing" in shown
    assert "deviation  texts/en.toml: was added" in shown
    assert "deviations: 2" in shown
    with StudyStore(folder) as store:
        record = read_frozen_plan_evidence(store)
        assert record is not None
        assert record.frozen_plan is not None
        earlier = FrozenPlanEvidence(msgspec.structs.replace(record.frozen_plan, texts=None))
        assert find_deviations(store, earlier, list_required_tests(store.design)) == []
