"""The report of a study with a frozen plan: planned tests are marked, and every deviation is listed."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.cli.main import app
from avrgym.study.people.participants import withdraw_participant
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from helpers.browser.html_page import Page
from helpers.studies.known_results import (
    STEPS,
    enrol_included,
    read_table,
    run_trials,
    write_without_figures,
)
from helpers.studies.small_studies import make_study

PLANNED = ["L1 against the middle, by participant", "policies, by participant"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study of two participants, whose plan is frozen and who have all finished."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', participants="2")
    for _ in range(2):
        assert CliRunner().invoke(app, ["study", "freeze", str(folder)]).exit_code == 0
    with StudyStore(folder) as store:
        for sex in ("man", "woman"):
            run_trials(store, enrol_included(store, sex, simulated=False))
    return folder


def analysed(folder: Path, out: Path) -> tuple[StudyAnalysis, str]:
    """The analysis, and the words of its page."""
    with StudyStore(folder) as store:
        analysis = analyse_study(store)
        return analysis, " ".join(Page(write_without_figures(analysis, folder, out)).text.split())


def test_what_was_planned_is_confirmatory_and_nothing_deviates(folder: Path, tmp_path: Path) -> None:
    analysis, page = analysed(folder, tmp_path / "out")
    assert analysis.plan_with_deviations is not None
    assert analysis.plan_with_deviations.deviations == []
    assert "Deviations None." in page
    assert page.count("Confirmatory results") == 1
    assert "H2: Participants rate L1, L2, L3, L4 higher with revised than with original." in page
    assert "preregistered" not in page
    tests = read_table(tmp_path / "out", "tests")
    for row in tests:
        assert row["plan_status"] == ("confirmatory" if row["family"] in PLANNED else "exploratory"), row[
            "family"
        ]
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["plan"]["deviations"] == []
    assert results["plan"]["plan"]["participants"] == 2
    assert "deviates" not in CliRunner().invoke(app, ["study", "check", str(folder)]).stdout


def test_a_model_is_confirmatory_where_the_plan_names_it_and_no_deviation_where_it_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in plans that were frozen before there were models."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', participants="2")
    assert CliRunner().invoke(app, ["study", "freeze", str(folder)]).exit_code == 0
    plan = folder / "plan.toml"
    kept = [line for line in plan.read_text().splitlines() if not re.match(r'    ".*, models of .*",$', line)]
    family = "policies, models of answers"
    kept += ["[[hypotheses]]", 'id = "H3"', 'text = "Odds."', 'measures = ["L1"]', f'tests = ["{family}"]']
    plan.write_text("\n".join(kept) + "\n")
    assert CliRunner().invoke(app, ["study", "freeze", str(folder)]).exit_code == 0
    with StudyStore(folder) as store:
        for sex in ("man", "woman"):
            run_trials(store, enrol_included(store, sex, simulated=False))
    analysis, page = analysed(folder, tmp_path / "out")
    assert analysis.plan_with_deviations is not None
    assert analysis.plan_with_deviations.deviations == []
    labels = {(row.family, row.quantity): row.plan_status for row in analysis.model_effects}
    assert {each for each, label in labels.items() if label == "confirmatory"} == {(family, "L1")}
    assert set(labels.values()) == {"confirmatory", "exploratory"}
    assert f"H3: {family}" in page
    assert {row.note for row in analysis.model_effects if row.quantity == "L1"} == {
        "fewer than 4 participants"
    }


@pytest.mark.slow
def test_the_report_lists_the_deviations_that_the_check_lists(folder: Path, tmp_path: Path) -> None:
    design = folder / "study.toml"
    design.write_text(design.read_text().replace("blind_experimenter = false", "blind_experimenter = true"))
    with StudyStore(folder) as store:
        run_trials(store, enrol_included(store, simulated=False), held={2: STEPS})
        withdraw_participant(store, enrol_included(store, simulated=False))
    analysis, page = analysed(folder, tmp_path / "out")
    assert analysis.plan_with_deviations is not None
    listed = [f"{each.where}: {each.message}" for each in analysis.plan_with_deviations.deviations]
    assert len(listed) == 4
    for words, line in zip(
        (
            "study.toml: blind_experimenter was false, is true",
            "sub-004: withdrew and is excluded from all tests",
            "participants: 3 have completed the study, 2 were planned",
            "sub-003, trial 2: is left out of the analysis: tracking was lost for",
        ),
        listed,
        strict=True,
    ):
        assert words in line
        assert line in page
    checked = CliRunner().invoke(app, ["study", "check", str(folder)]).stdout
    told = [line for line in checked.splitlines() if "deviates from the plan" in line]
    assert [line.removeprefix("note   ").replace("deviates from the plan: ", "") for line in told] == listed


@pytest.mark.slow
def test_a_record_that_was_changed_tells_nothing(folder: Path, tmp_path: Path) -> None:
    record = folder / "plan-frozen.json"
    record.write_bytes(record.read_bytes().replace(b"higher", b"lower"))
    analysis, page = analysed(folder, tmp_path / "out")
    assert {row.plan_status for row in analysis.tests} == {""}
    assert "plan-frozen.json: was modified after freezing" in page
    assert "Confirmatory" not in page
