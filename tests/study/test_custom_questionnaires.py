"""Custom questionnaires: texts, families, figures, answers before and after sessions, and changes."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import sqlalchemy as sa

from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.statistics.rank_tests import apply_holm_correction
from avrgym.analysis.study_analysis import analyse_study
from avrgym.recording.schema import Answer
from avrgym.study.checking.study_checks import check_study
from avrgym.study.design.design import DesignError, parse_design
from avrgym.study.export import export_study
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database, schema
from avrgym.study.storage.answers import record_session_answer, record_trial_answer
from avrgym.study.storage.attempts import begin_attempt, complete_attempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.known_results import enrol_included, record_trial, write_without_figures
from helpers.studies.small_studies import make_study

LOAD = """
[[questionnaires]]
name = "load"
when = "after_trial"
items = [
    { id = "T1", text = "How mentally demanding was the task?", points = 21, low = "very low", high = "very high" },
    { id = "T2", text = "How successful were you in accomplishing what you were asked to do, which may be a long question that no line holds?", points = 21, low = "perfect", high = "failure" },
]
"""  # noqa: E501
SICKNESS = """
[[questionnaires]]
name = "sickness"
when = ["before_session", "after_session"]
items = [
    { id = "S_1", text = "Nausea", points = 4, low = "none", high = "severe" },
    { id = "S_2", text = "Eye <strain> & $such$", points = 4, low = "none", high = "severe" },
]
"""
PEOPLE = 6


def with_questionnaires(folder: Path) -> Path:
    make_study(folder, tasks='["Feeding"]', robots='["Jaco"]', practice_policy='""', trial_steps="5")
    with open(folder / "study.toml", "a") as file:
        file.write(LOAD + SICKNESS)
    return folder


def before(number: int) -> dict[str, int]:
    return {"S_1": 1, "S_2": 1 + number % 3}


def after(number: int) -> dict[str, int]:
    return {"S_1": 2 + number % 2, "S_2": 1 + number % 3}


def answer_trials(store: StudyStore, session: int, pseudonym: str) -> None:
    participant = store.read_participant(pseudonym)
    for trial in store.read_remaining_trials(pseudonym):
        attempt = begin_attempt(store, session, trial.position)
        metrics = record_trial(store.resolve_path(attempt.recording), store.design, participant, trial)
        for place, item in enumerate(store.design.list_items_at_moment("after_trial")):
            revised = trial.policy == "revised"
            value = 1 + (participant.number + place + 2 * revised) % item.points
            record_trial_answer(store, attempt.id, Answer(item.id, value, 1.0))
        complete_attempt(store, attempt.id, metrics)


def ask(store: StudyStore, session: int, when: str, values: dict[str, int]) -> None:
    for item, value in values.items():
        record_session_answer(store, session, Answer(item, value, 1.0), when)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudyStore]:
    """A study with answers to three questionnaires."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        with StudyStore(with_questionnaires(tmp_path_factory.mktemp("study"))) as store:
            for _ in range(PEOPLE):
                pseudonym = enrol_included(store, simulated=False)
                number = store.read_participant(pseudonym).number
                session = open_session(store, pseudonym)
                ask(store, session.id, "before_session", before(number))
                answer_trials(store, session.id, pseudonym)
                ask(store, session.id, "after_session", after(number))
                close_session(store, session.id)
            yield store


@pytest.fixture(scope="module")
def out(study: StudyStore, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    write_analysis(analyse_study(study), study.folder, folder)
    return folder


def table(out: Path, name: str) -> Any:
    return pd.read_csv(out / "tables" / f"{name}.csv")


def words(path: Path) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", path.read_text()).split())


# The design


def test_questionnaire_has_one_or_several_moments(tmp_path: Path) -> None:
    design = parse_design((with_questionnaires(tmp_path) / "study.toml").read_text())
    assert [item.id for item in design.list_items_at_moment("before_session")] == ["S_1", "S_2"]
    assert design.list_items_at_moment("before_session") == design.list_items_at_moment("after_session")
    assert [item.id for item in design.list_items_at_moment("after_trial")] == [
        "L1",
        "L2",
        "L3",
        "L4",
        "T1",
        "T2",
    ]


@pytest.mark.parametrize(
    ("when", "words"),
    [
        ("[]", "length >= 1"),
        ('["before_session", "never"]', "unknown value 'never'; allowed: before_session, after_trial"),
        ('["after_session", "after_session"]', "'after_session' is listed twice"),
        ("3", "when"),
    ],
)
def test_unknown_moments_are_rejected(tmp_path: Path, when: str, words: str) -> None:
    text = (with_questionnaires(tmp_path) / "study.toml").read_text()
    with pytest.raises(DesignError, match=re.escape(words)):
        parse_design(text.replace('["before_session", "after_session"]', when))


# Answers


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudyStore]:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    with StudyStore(with_questionnaires(tmp_path / "study")) as opened:
        yield opened


def crash(store: StudyStore) -> None:
    """Simulate the death of the process of the open session."""
    with store.database.write_transaction() as connection:
        connection.execute(sa.update(schema.SESSION_TABLE).values(process_id=2**22 + 1))


def remaining(store: StudyStore, pseudonym: str, when: str) -> list[str]:
    with StudyVisit(store, pseudonym) as visit:
        return [item.id for item in visit.find_unanswered_items(when)]


def test_item_is_answered_once_before_and_once_after(store: StudyStore) -> None:
    session = open_session(store, enrol_included(store)).id
    ask(store, session, "before_session", {"S_1": 1})
    with pytest.raises(StudyError, match="is answered already"):
        ask(store, session, "before_session", {"S_1": 2})
    ask(store, session, "after_session", {"S_1": 3})
    with pytest.raises(StudyError, match="is answered already"):
        ask(store, session, "after_session", {"S_1": 3})


def test_answers_before_a_crash_are_not_requested_again(store: StudyStore) -> None:
    pseudonym = enrol_included(store)
    for item, rest in (("S_1", ["S_2"]), ("S_2", [])):
        visit = StudyVisit(store, pseudonym)
        visit.record_answer(Answer(item, 2, 1.0), "before_session")
        assert [each.id for each in visit.find_unanswered_items("before_session")] == rest
        crash(store)
    assert remaining(store, pseudonym, "before_session") == []
    assert [finding.message for finding in check_study(store) if finding.where.startswith("ses-")] == [
        "has unanswered items: S_1, S_2"  # after the session
    ]
    assert remaining(store, pseudonym, "before_session") == ["S_1", "S_2"]  # another visit


def test_last_questions_continue_after_a_crash(store: StudyStore) -> None:
    pseudonym = enrol_included(store)
    visit = StudyVisit(store, pseudonym)
    answer_trials(store, visit.stored_session.id, pseudonym)
    visit.record_answer(Answer("S_1", 2, 1.0), "after_session")
    crash(store)
    assert remaining(store, pseudonym, "after_session") == ["S_2"]


@pytest.mark.slow
def test_later_of_two_answers_counts(store: StudyStore, tmp_path: Path) -> None:
    pseudonym = enrol_included(store)
    for value in (1, 3):
        session = open_session(store, pseudonym)
        ask(store, session.id, "before_session", {"S_1": value})
        close_session(store, session.id)
    session = open_session(store, pseudonym)
    answer_trials(store, session.id, pseudonym)
    ask(store, session.id, "after_session", {"S_1": 4})
    close_session(store, session.id)
    analysis = analyse_study(store)
    counted = [
        (row.moment, row.value) for row in analysis.study_data.answers if row.item == "S_1" and row.counted
    ]
    assert counted == [("before_session", 3), ("after_session", 4)]
    page = write_without_figures(analysis, store.folder, tmp_path / "out")
    assert "sub-001 answered S_1 before session more than once, in sessions 1 and 2" in words(page)


# Results


@pytest.mark.slow
def test_each_questionnaire_is_a_family_of_tests(out: Path) -> None:
    tests = table(out, "tests")
    families = {
        "policies, likert, by trial": ["L1", "L2", "L3", "L4"],
        "policies, load, by trial": ["T1", "T2"],
        "before and after sessions, sickness, by participant": ["S_1", "S_2"],
    }
    for family, items in families.items():
        own = tests[tests["family"] == family]
        assert list(own["quantity"]) == items
        given = [None if pd.isna(p) else p for p in own["p"]]
        expected = [None if p is None else pytest.approx(p, abs=1e-15) for p in apply_holm_correction(given)]
        assert [None if pd.isna(p) else p for p in own["p_holm"]] == expected


@pytest.mark.slow
def test_answers_before_and_after_and_their_change(out: Path) -> None:
    rows = table(out, "session_answers").set_index(["item", "moment"])
    numbers = range(1, PEOPLE + 1)
    for item in ("S_1", "S_2"):
        first = pd.Series([before(number)[item] for number in numbers])
        last = pd.Series([after(number)[item] for number in numbers])
        for moment, values in (
            ("before_session", first),
            ("after_session", last),
            ("change", last - first),
        ):
            row = rows.loc[item, moment]
            assert (row["n"], row["median"], row["mean"]) == (PEOPLE, values.median(), values.mean())
    answers = table(out, "answers")
    assert answers[answers["questionnaire"] == "sickness"]["counted"].all()
    (test,) = table(out, "tests").query("quantity == 'S_1'").itertuples()
    assert (test.group_a, test.group_b, test.n) == ("after", "before", PEOPLE)
    assert test.p == pytest.approx(2 / 2**PEOPLE)


@pytest.mark.slow
def test_each_questionnaire_has_a_figure_with_its_labels(out: Path) -> None:
    figures = {path.stem: words(path) for path in (out / "figures").glob("*.svg")}
    scales = {
        "likert-likert-people": "from 1 (strongly disagree) to 7 (strongly agree)",
        "likert-load-people": "from 1 (very low) to 21 (very high)",
        "sessions-sickness-people": "from 1 (none) to 4 (severe)",
    }
    for name, scale in scales.items():
        assert scale in figures[name]
        assert not any(other in figures[name] for other in set(scales.values()) - {scale})
    assert "from 1 (perfect) to 21 (failure)" in figures["likert-load-people"]


@pytest.mark.slow
def test_report_shows_texts_of_each_questionnaire(out: Path) -> None:
    page = words(out / "report" / "index.html")
    for said in (
        "likert, asked after each trial",
        "load, asked after each trial",
        "T1: How mentally demanding was the task? (from 1 (very low) to 21 (very high))",
        "load: answers on each item",
        "sickness, asked before and after sessions",
        "sickness: answers from 1 (none) to 4 (severe)",
    ):
        assert said in page
    design = json.loads((out / "results.json").read_text())["questionnaires"]
    assert [each["name"] for each in design] == ["likert", "load", "sickness"]


@pytest.mark.parametrize("data_format", ["csv", "bids"])
def test_exports_separate_answers_before_and_after(
    study: StudyStore, tmp_path: Path, data_format: str
) -> None:
    export_study(study, data_format, tmp_path / "out")
    if data_format == "csv":
        rows = pd.read_csv(tmp_path / "out" / "answers.csv")
        own = rows[rows["questionnaire"] == "sickness"]
        assert dict(own.groupby("moment").size()) == {
            "after_session": 2 * PEOPLE,
            "before_session": 2 * PEOPLE,
        }
    else:
        rows = pd.read_csv(tmp_path / "out" / "phenotype" / "sickness.tsv", sep="\t")
        assert list(rows["ses-01_before_session_S_1"]) == [before(n)["S_1"] for n in range(1, PEOPLE + 1)]
        assert list(rows["ses-01_after_session_S_1"]) == [after(n)["S_1"] for n in range(1, PEOPLE + 1)]
        described = json.loads((tmp_path / "out" / "phenotype" / "sickness.json").read_text())
        assert described["ses-01_after_session_S_2"]["Levels"]["4"] == "severe"
