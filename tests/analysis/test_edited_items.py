"""Items that were edited during a study: answers are not pooled, none is lost, and methods list the versions."""

import json
import re
import shutil
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from avrgym.analysis.designs import describe_session_designs
from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.cli.main import app
from avrgym.recording.schema import Answer
from avrgym.study.design.design_comparison import format_value
from avrgym.study.people import participants
from avrgym.study.storage import database, sessions
from avrgym.study.storage.answers import record_trial_answer
from avrgym.study.storage.attempts import begin_attempt, complete_attempt
from avrgym.study.storage.database_rows import Participant, Trial
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.session_designs import read_session_designs
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.store import StudyStore
from helpers.browser.html_page import Page
from helpers.studies.known_results import (
    ITEMS,
    enrol_included,
    record_trial,
    run_trials,
    write_without_figures,
)
from helpers.studies.small_studies import make_study

EDITS = {
    "The robot successfully assisted me with the task.": "The robot failed.",
    'in VR.", points = 7': 'in VR.", points = 5',
    'real robot.", points = 7, low = "strongly disagree", high = "strongly agree"': (
        'real robot.", points = 7, low = "strongly agree", high = "strongly disagree"'
    ),
    "force_guard = true": "force_guard = false",
    "seat_height_m = 0.485": "seat_height_m = 0.4",
}
CHANGED = ("L1", "L2", "L3")
FIRST, SECOND = "sub-001, sub-002", "sub-003, sub-004"
Frame = Any  # a pandas data frame, whose types no checker follows


def edit(folder: Path) -> None:
    text = (folder / "study.toml").read_text()
    for before, after in EDITS.items():
        assert text.count(before) == 1
        text = text.replace(before, after)
    (folder / "study.toml").write_text(text)


def rate(participant: Participant, trial: Trial, item: str) -> int:
    """Answers that the item allows: after the edit L2 has 5 points."""
    value = int(np.random.default_rng([participant.number, trial.position, *item.encode()]).integers(1, 8))
    return min(value, 5) if item == "L2" and participant.number > 2 else value


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A study with a frozen plan: two people, an edit, two more people, and the edit is undone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        folder = make_study(
            tmp_path_factory.mktemp("edited") / "study", tasks='["Feeding"]', participants="4"
        )
        for _ in range(2):
            assert CliRunner().invoke(app, ["study", "freeze", str(folder)]).exit_code == 0
        take_two(folder)
        before = (folder / "study.toml").read_text()
        edit(folder)
        take_two(folder)
        (folder / "study.toml").write_text(before)
        yield folder


def take_two(folder: Path) -> None:
    with StudyStore(folder) as store:
        for sex in ("man", "woman"):
            run_trials(store, enrol_included(store, sex, simulated=False), rate=rate)


@pytest.fixture(scope="module")
def analysis(folder: Path) -> StudyAnalysis:
    with StudyStore(folder) as store:
        return analyse_study(store)


@pytest.fixture(scope="module")
def out(folder: Path, analysis: StudyAnalysis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    write_without_figures(analysis, folder, out)
    return out


@pytest.fixture(scope="module")
def tables(out: Path) -> dict[str, Frame]:
    return {path.stem: pd.read_csv(path) for path in (out / "tables").glob("*.csv")}


def test_no_answer_is_lost(tables: dict[str, Frame]) -> None:
    counted = tables["answers"].query("counted")
    assert len(counted) == 4 * 4 * len(ITEMS)
    likert = tables["likert"]
    assert likert["count"].sum() == len(counted)
    assert likert.groupby(["item", "policy"])["share"].sum().unique() == pytest.approx([1.0])
    assert tables["subjective"].query("task == 'all' and robot == 'all'")["n"].sum() == len(counted)


def test_answers_to_different_items_are_apart(tables: dict[str, Frame]) -> None:
    answers = tables["answers"]
    groups = (
        answers.groupby("item")["participant"].unique().map(lambda each: ", ".join(sorted(each))).to_dict()
    )
    expected = {"L4": f"{FIRST}, {SECOND}"}
    expected |= {item: FIRST for item in CHANGED} | {f"{item} (version 2)": SECOND for item in CHANGED}
    assert groups == expected
    assert set(answers.query("item == 'L2 (version 2)'")["points"]) == {5}
    tests = tables["tests"].query("family == 'policies, by participant'").set_index("quantity")
    assert tests["n_a"].to_dict() == {item: 4 if item == "L4" else 2 for item in expected}
    assert set(tables["models"]["quantity"]) >= set(expected)


def test_items_name_who_was_asked_what(tables: dict[str, Frame]) -> None:
    items = tables["items"].set_index("item")
    assert items.loc["L1", "participants"] == FIRST
    assert items.loc["L1 (version 2)", ["text", "participants", "version"]].tolist() == [
        "The robot failed.",
        SECOND,
        2,
    ]
    assert items.loc["L3 (version 2)", ["low", "high"]].tolist() == ["strongly agree", "strongly disagree"]
    assert items["answers"].sum() == len(tables["answers"])


def test_check_report_and_deviations_name_each_edit(folder: Path, analysis: StudyAnalysis, out: Path) -> None:
    checked = CliRunner().invoke(app, ["study", "check", str(folder)])
    page = " ".join(Page(out / "report" / "index.html").text.split())
    results = json.loads((out / "results.json").read_text())
    fields = {
        "questionnaires.likert.items.L1.text": "The robot failed.",
        "questionnaires.likert.items.L2.points": 5,
        "questionnaires.likert.items.L3.low": "strongly agree",
        "questionnaires.likert.items.L3.high": "strongly disagree",
        "force_guard": False,
        "furniture.seat_height_m": 0.4,
    }
    assert checked.exit_code == 1
    assert analysis.plan_with_deviations is not None
    for field, value in fields.items():
        words = f"it was {format_value(value)} for sub-003 (trials 1 to 5), sub-004 (trials 1 to 5)"
        (line,) = [each for each in checked.stdout.splitlines() if f"study.toml: {field} is " in each]
        assert line.startswith("error")
        assert words in line
        assert (
            sum(field in each["message"] and words in each["message"] for each in results["differences"]) == 1
        )
        assert page.index(field) < page.index("The plan was frozen")
        (told,) = [
            each.message
            for each in analysis.plan_with_deviations.deviations
            if each.message.startswith(f"{field} was ")
        ]
        assert f"and {format_value(value)} for sub-003" in told
    assert len(results["differences"]) == len(fields)
    assert page.index("Differences between participants") < page.index("People")


def test_methods_state_what_each_participant_had(out: Path) -> None:
    text = (out / "reporting" / "methods.md").read_text()
    first, _, second = text.partition(
        "For sub-003 (trials 1 to 5), sub-004 (trials 1 to 5): Participants sat on a "
    )
    assert (
        first.count(
            "For sub-001 (trials 1 to 5), sub-002 (trials 1 to 5): Participants sat on a seat 0.485 m"
        )
        == 1
    )
    assert "A force guard limited" in first
    assert second.startswith("seat 0.4 m high")
    assert "No force guard limited" in second
    assert "L1 (version 2): “The robot failed.”" in text
    assert (
        "L2 (version 2) (“I felt comfortable with how the robot assisted me in VR.”, from 1, strongly disagree, to 5"
        in text
    )


def test_practice_has_the_items_of_its_session_where_only_recordings_report_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]')
    with StudyStore(folder) as store:
        pseudonym = enrol_included(store, simulated=False)
        session = open_session(store, pseudonym)
        for trial in store.read_remaining_trials(pseudonym):
            attempt = begin_attempt(store, session.id, trial.position)
            participant = store.read_participant(pseudonym)
            metrics = record_trial(store.resolve_path(attempt.recording), store.design, participant, trial)
            complete_attempt(store, attempt.id, metrics)
        close_session(store, session.id)
    edit(folder)
    monkeypatch.setattr(StudyStore, "read_stored_designs", lambda _: [])
    with StudyStore(folder) as store:
        (use,) = read_session_designs(store)
    assert use.trial_positions == (1, 2, 3, 4, 5)
    assert use.design.items_by_id["L1"].text == "The robot successfully assisted me with the task."


def test_each_group_with_another_design_has_a_sentence_of_its_own(folder: Path) -> None:
    with StudyStore(folder) as store:
        words = describe_session_designs(
            read_session_designs(store),
            store.design,
            lambda design: f"{design.furniture.seat_height_m:g} m high",
        )
    assert re.search(r": 0\.485 m high\. For sub-003 .*: 0\.4 m high\.$", words)


def test_a_file_that_is_edited_later_changes_no_result(
    folder: Path, analysis: StudyAnalysis, tmp_path: Path
) -> None:
    later = Path(shutil.copytree(folder, tmp_path / "study"))
    edit(later)
    with StudyStore(later) as store:
        again = analyse_study(store)
    assert [row for row in again.answer_frequencies if row.count] == [
        row for row in analysis.answer_frequencies if row.count
    ]
    assert again.study_data.answers == analysis.study_data.answers
    assert again.item_versions == analysis.item_versions


def test_exports_have_the_items_that_were_asked(folder: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        app, ["study", "export", str(folder), "--format", "csv", "--out", str(tmp_path / "csv")]
    )
    assert result.exit_code == 0, result.stderr
    answers, items = (pd.read_csv(tmp_path / "csv" / f"{name}.csv") for name in ("answers", "items"))
    assert set(answers["item"]) == set(items["item"])
    assert len(items) == 7
    joined: Frame = answers.merge(items, on="item")
    assert (joined["value"] <= joined["points_y"]).all()


# Studies whose database does not contain designs


@pytest.mark.slow
@pytest.mark.parametrize("edited", [False, True])
def test_recordings_report_what_was_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, edited: bool
) -> None:
    """As in studies of AVR Gym 0.2: only recordings contain the items."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    for module in (sessions, participants):
        monkeypatch.setattr(module, "store_design", lambda *_: None)
    folder = make_study(tmp_path / "study", tasks='["Feeding"]')
    with StudyStore(folder) as store:
        take_part_with_items(store)
    if edited:
        edit(folder)
    with StudyStore(folder) as store:
        take_part_with_items(store)
        analysis = analyse_study(store)
        found = {each.message.partition(" is ")[0] for each in analysis.design_differences if each.is_error}
        names = [version.item.id for version in AnsweredItems(store).item_versions]
    assert found == (
        {
            "force_guard",
            "furniture.seat_height_m",
            "questionnaires.likert.items.L1.text",
            "questionnaires.likert.items.L2.points",
            "questionnaires.likert.items.L3.high",
            "questionnaires.likert.items.L3.low",
        }
        if edited
        else set()
    )
    versions = [f"{item}{version}" for item, version in product(CHANGED, ("", " (version 2)"))]
    assert names == [*(versions if edited else CHANGED), "L4"]
    assert {row.count for row in analysis.answer_frequencies} >= {0}


def take_part_with_items(store: StudyStore) -> None:
    participant = store.read_participant(enrol_included(store, "woman", simulated=False))
    session = open_session(store, participant.pseudonym)
    for trial in store.read_remaining_trials(participant.pseudonym):
        attempt = begin_attempt(store, session.id, trial.position)
        metrics = record_trial(store.resolve_path(attempt.recording), store.design, participant, trial)
        if not trial.practice:
            for item in ITEMS:
                record_trial_answer(
                    store, attempt.id, Answer(item, rate(participant, trial, item) % 5 + 1, 1.0)
                )
        complete_attempt(store, attempt.id, metrics)
    close_session(store, session.id)
