"""Validated questionnaires in a design, and their scores in tables and report."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from avrgym.analysis.study_analysis import analyse_study
from avrgym.questionnaires.nasa_tlx import FACTOR_PAIRS, WORKLOAD_FACTORS
from avrgym.questionnaires.registry import INSTRUMENTS
from avrgym.recording.schema import Answer
from avrgym.study.checking.study_summary import summarise_results
from avrgym.study.dashboard.displayed_data import make_displayed_participant
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text, read_design
from avrgym.study.export import export_study
from avrgym.study.storage import database
from avrgym.study.storage.answers import record_session_answer, record_trial_answer
from avrgym.study.storage.attempts import begin_attempt, complete_attempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.store import StudyStore
from helpers.studies.known_results import enrol_included, record_trial, write_without_figures
from helpers.studies.small_studies import make_study

USED = """
[[questionnaires]]
use = "nasa-tlx"
when = "after_trial"

[[questionnaires]]
use = "nasa-tlx-weights"
name = "sources"
when = "after_session"

[[questionnaires]]
use = "ssq"
when = ["before_session", "after_session"]
order = "random"
"""
LAST_LINE = read_default_design_text().count("\n")
WEIGHTS = "mental = 3, physical = 0, temporal = 5, performance = 1, effort = 3, frustration = 3"
PEOPLE = 3


def using(table: str) -> str:
    return f"{read_default_design_text()}\n[[questionnaires]]\n{table}\n"


# The design


@pytest.mark.parametrize("name", [name for name, each in INSTRUMENTS.items() if not each.texts_source])
def test_use_adds_items_of_an_instrument(name: str) -> None:
    questionnaire = parse_design(using(f'use = "{name}"\nwhen = "after_session"')).questionnaires[-1]
    instrument = INSTRUMENTS[name]
    assert (questionnaire.name, questionnaire.instrument) == (name, instrument)
    asked = [(item.id, item.text, item.points) for item in questionnaire.items]
    assert asked == [
        (item.id, item.text, instrument.response_scale.option_count) for item in instrument.items
    ]


@pytest.mark.parametrize(
    ("table", "line", "words"),
    [
        (
            'use = "nasa"\nwhen = "after_trial"',
            1,
            "unknown name 'nasa'; allowed: nasa-tlx, nasa-tlx-weights, ssq",
        ),
        (
            'use = "ssq"\nitems = []\nwhen = "after_trial"',
            2,
            "unknown name 'items'; allowed: use, name, when",
        ),
        ('use = "ssq"\nwhen = "later"', 2, "unknown value 'later'; allowed: before_session"),
        (
            'use = "ssq"\nwhen = "after_trial"\nweights = { }',
            3,
            "allowed: questionnaires with use = nasa-tlx",
        ),
        (
            f'use = "nasa-tlx"\nwhen = "after_trial"\nweights = {{ {WEIGHTS} }}'.replace("5", "4"),
            3,
            "sum of the weights is 14",
        ),
        (
            'use = "nasa-tlx"\nwhen = "after_trial"\nweights = { mental = 15 }',
            3,
            "allowed: one weight for each of mental, physical",
        ),
        ('use = "ssq"\nname = "likert"\nwhen = "after_trial"', 2, "'likert' is used twice"),
        (
            'use = "ipq"\nwhen = "after_session"',
            1,
            "instruments/ipq.toml is missing in the study's folder; allowed:",
        ),
    ],
)
def test_error_of_an_invalid_use_has_its_line(table: str, line: int, words: str) -> None:
    with pytest.raises(DesignError, match=rf"study\.toml:{LAST_LINE + 2 + line}: .*{re.escape(words)}"):
        parse_design(using(table))


def test_instrument_is_used_once() -> None:
    twice = (
        using('use = "ssq"\nwhen = "before_session"')
        + '\n[[questionnaires]]\nuse = "ssq"\nname = "again"\nwhen = "after_session"\n'
    )
    with pytest.raises(DesignError, match="'ssq_general_discomfort' is used twice"):
        parse_design(twice)


def test_custom_items_have_a_label_for_each_point() -> None:
    text = read_default_design_text().replace(
        'high = "strongly agree" }', 'high = "strongly agree", labels = ["no", "yes"] }', 1
    )
    with pytest.raises(DesignError, match=r"2 labels for 7 points; allowed: one label for each point"):
        parse_design(text)


def test_licensed_texts_are_read_from_the_folder_of_the_study(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(using('use = "ipq"\nwhen = "after_session"'))
    (tmp_path / "instruments").mkdir()
    own = tmp_path / "instruments" / "ipq.toml"
    lines = [
        f'{item.id} = {{ text = "{item.id}?", low = "no", high = "yes" }}'
        for item in INSTRUMENTS["ipq"].items
    ]
    for words, error in (
        (lines[1:], "instruments/ipq.toml lacks ipq_g1; allowed: each item as ID = { text ="),
        (['ipq_g1 = "Words without ends"', *lines[1:]], "instruments/ipq.toml lacks ipq_g1;"),
        ([*lines, 'ipq_g2 = "?"'], "unknown item 'ipq_g2'; allowed: ipq_g1, ipq_sp1"),
        (["ipq_g1 = 3", *lines[1:]], "instruments/ipq.toml cannot be read"),
    ):
        own.write_text("\n".join(words))
        with pytest.raises(DesignError, match=rf"study\.toml:{LAST_LINE + 3}: .*{re.escape(error)}"):
            read_design(tmp_path / "study.toml")
    own.write_text("\n".join(lines))
    asked = read_design(tmp_path / "study.toml").questionnaires[-1].items
    assert next((item.text, item.low, item.high) for item in asked) == ("ipq_g1?", "no", "yes")


# Scores


def read(path: Path) -> Any:
    return pd.read_csv(path)


def rating(number: int, revised: bool, place: int) -> int:
    return 1 + (3 * number + 2 * place + 4 * revised) % 21


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudyStore]:
    """People with workload ratings after each trial and symptoms before and after; the last lacks one answer."""
    folder = tmp_path_factory.mktemp("study")
    make_study(folder, tasks='["Feeding"]', robots='["Jaco"]', practice_policy='""', trial_steps="5")
    with open(folder / "study.toml", "a") as file:
        file.write(USED)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        with StudyStore(folder) as store:
            for number in range(1, PEOPLE + 1):
                take_part_whole(store, number)
            yield store


def take_part_whole(store: StudyStore, number: int) -> None:
    pseudonym = enrol_included(store, simulated=False)
    session = open_session(store, pseudonym).id
    answer(store, session, "before_session", {item.id: 1 for item in INSTRUMENTS["ssq"].items})
    for trial in store.read_remaining_trials(pseudonym):
        attempt = begin_attempt(store, session, trial.position)
        metrics = record_trial(
            store.resolve_path(attempt.recording), store.design, store.read_participant(pseudonym), trial
        )
        for place, item in enumerate(store.design.list_items_at_moment("after_trial")):
            value = 4 if place < 4 else rating(number, trial.policy == "revised", place)
            record_trial_answer(store, attempt.id, Answer(item.id, value, 1.0))
        complete_attempt(store, attempt.id, metrics)
    symptoms = {item.id: 1 for item in INSTRUMENTS["ssq"].items} | {"ssq_nausea": 3}
    if number == PEOPLE:
        del symptoms["ssq_vertigo"]
    answer(store, session, "after_session", symptoms)
    answer(store, session, "after_session", {f"tlx_{a}_or_{b}": 1 for a, b in FACTOR_PAIRS})
    close_session(store, session)


def answer(store: StudyStore, session: int, when: str, values: dict[str, int]) -> None:
    for item, value in values.items():
        record_session_answer(store, session, Answer(item, value, 1.0), when)


@pytest.fixture(scope="module")
def out(study: StudyStore, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    write_without_figures(analyse_study(study), study.folder, folder / "analysis")
    export_study(study, "csv", folder / "export")
    return folder


@pytest.mark.slow
def test_workload_is_scored_with_weights(out: Path) -> None:
    """With the first choice of each pair, the factors have the weights 5, 4, 3, 2, 1 and 0."""
    scores = read(out / "analysis" / "tables" / "scores.csv").query("questionnaire == 'nasa-tlx'")
    assert scores["counted"].all()
    assert len(scores) == PEOPLE * 2 * 8
    for number in range(1, PEOPLE + 1):
        for policy in ("original", "revised"):
            ratings = [5 * (rating(number, policy == "revised", 4 + place) - 1) for place in range(6)]
            own = scores.query(f"participant == 'sub-{number:03}' and policy == '{policy}'").set_index(
                "scale"
            )
            assert own.loc["raw", "score"] == pytest.approx(sum(ratings) / 6)
            weighted = (
                sum(weight * value for weight, value in zip((5, 4, 3, 2, 1, 0), ratings, strict=True)) / 15
            )
            assert own.loc["weighted", "score"] == pytest.approx(weighted)
            assert list(own.loc[list(WORKLOAD_FACTORS), "score"]) == ratings


@pytest.mark.slow
def test_missing_answer_leaves_no_symptom_score(out: Path) -> None:
    tables = out / "analysis" / "tables"
    scores = read(tables / "scores.csv").query("questionnaire == 'ssq' and moment == 'after_session'")
    total = scores.query("scale == 'total'").set_index("participant")
    assert list(total["score"])[:-1] == [14.96] * (PEOPLE - 1)
    assert pd.isna(total.loc[f"sub-{PEOPLE:03}", "score"])
    assert (total.loc[f"sub-{PEOPLE:03}", ["answered", "items"]] == [15, 16]).all()
    oculomotor = scores.query("scale == 'oculomotor'")
    assert list(oculomotor["score"]) == [0.0] * PEOPLE
    summaries = read(tables / "score_summaries.csv").set_index(["questionnaire", "scale", "moment"])
    change = summaries.loc[("ssq", "nausea", "change")]
    assert (change["n"], change["median"]) == (PEOPLE, 19.08)
    tests = read(tables / "tests.csv")
    families = set(tests["family"])
    assert {
        "before and after sessions, scores of ssq, by participant",
        "policies, scores of nasa-tlx, by trial",
    } <= families


@pytest.mark.slow
def test_report_shows_scores_and_sources(out: Path) -> None:
    page = (out / "analysis" / "report" / "index.html").read_text()
    words = " ".join(re.sub(r"<[^>]*>", " ", page).split())
    for said in (
        "ssq: Simulator Sickness Questionnaire",
        "doi:10.1207/s15327108ijap0303_3",
        "nasa-tlx: tests of scores",
    ):
        assert said in words


@pytest.mark.slow
def test_export_contains_scores_scales_and_codebook(out: Path) -> None:
    export = out / "export"
    exported = read(export / "scores.csv")
    analysed = read(out / "analysis" / "tables" / "scores.csv")
    shared = [
        "participant",
        "questionnaire",
        "scale",
        "moment",
        "score",
        "minimum",
        "maximum",
        "answered",
        "items",
    ]
    pd.testing.assert_frame_equal(exported[shared], analysed[shared])
    scales = read(export / "scales.csv").set_index(["questionnaire", "scale"])
    assert scales.loc[("ssq", "total"), ["function", "factor", "maximum"]].tolist() == ["sum", 3.74, 235.62]
    assert scales.loc[("nasa-tlx", "weighted"), "function"] == "weighted mean"
    codebook = read(export / "codebook.csv")
    for table in ("scores", "scales"):
        columns = list(read(export / f"{table}.csv").columns)
        assert list(codebook[codebook["table"] == table]["column"]) == columns


def test_studies_without_instruments_have_no_score_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    with StudyStore(make_study(tmp_path / "study")) as store:
        export_study(store, "csv", tmp_path / "export")
        names = [table.name for table in analyse_study(store).make_tables()]
    assert not {"scores.csv", "scales.csv"} & {path.name for path in (tmp_path / "export").iterdir()}
    assert not {"scores", "score_summaries"} & set(names)
    assert "scales" not in (tmp_path / "export" / "codebook.csv").read_text()


# The scale of each item


def scale_of(item: str) -> tuple[int, int, int]:
    """Lowest and highest value of an item and their number, as published."""
    if item.startswith("ssq_"):
        return 0, 3, 4
    if "_or_" in item:
        return 0, 1, 2
    return (0, 100, 21) if item.startswith("tlx_") else (1, 7, 7)


def test_answers_use_the_scales_of_their_instruments(out: Path) -> None:
    for table in (out / "analysis" / "tables" / "answers.csv", out / "export" / "answers.csv"):
        for row in read(table).itertuples():
            assert (row.minimum, row.maximum, row.points) == scale_of(row.item)
            assert row.minimum <= row.value <= row.maximum
    for table in (out / "analysis" / "tables" / "items.csv", out / "export" / "items.csv"):
        for row in read(table).itertuples():
            assert (row.minimum, row.maximum, row.points) == scale_of(row.item)
    for row in read(out / "analysis" / "tables" / "subjective.csv").itertuples():
        least, most, _ = scale_of(row.item)
        assert least <= row.minimum <= row.median <= row.maximum <= most
    likert = read(out / "analysis" / "tables" / "likert.csv")
    for (item, _, _), rows in likert.groupby(["item", "moment", "policy"], dropna=False):
        least, most, points = scale_of(str(item))
        assert list(rows["value"]) == [least + k * (most - least) // (points - 1) for k in range(points)]
        assert rows["share"].sum() == pytest.approx(1.0)


def test_scores_agree_with_items(out: Path) -> None:
    tables = out / "analysis" / "tables"
    items = read(tables / "subjective.csv").query("task == 'all' and robot == 'all'")
    load = items[items["item"].str.startswith("tlx_")]
    scores = read(tables / "score_summaries.csv").query("scale == 'raw'").set_index("policy")["mean"]
    for policy, rows in load.groupby("policy"):
        assert rows["mean"].mean() == pytest.approx(scores[policy])
    effects = read(tables / "models.csv").query("effect == 'policies'").set_index("quantity")["estimate"]
    assert effects.get("tlx_mental") == pytest.approx(effects.get("mental"), nan_ok=True)


def test_report_and_methods_contain_published_scale_names(out: Path) -> None:
    page = (out / "analysis" / "report" / "index.html").read_text()
    methods = (out / "analysis" / "reporting" / "methods.md").read_text()
    assert "from 0 (very low) to 100 (very high) in steps of 5" in page
    assert "0 (none), 1 (slight), 2 (moderate), 3 (severe)" in page
    assert "to 21" not in page
    assert "6 items from 0 to 100 in steps of 5" in methods
    assert "16 items from 0 to 3" in methods


@pytest.mark.slow
def test_bids_export_describes_its_values(study: StudyStore, tmp_path: Path) -> None:
    export_study(study, "bids", tmp_path / "bids")
    for name in ("nasa-tlx", "ssq", "likert"):
        rows = pd.read_csv(tmp_path / "bids" / "phenotype" / f"{name}.tsv", sep="\t")
        described = json.loads((tmp_path / "bids" / "phenotype" / f"{name}.json").read_text())
        for column in rows.columns[2:]:
            levels = described[column]["Levels"]
            assert set(rows[column].dropna().astype(int).astype(str)) <= set(levels)
            item = next(each for each in study.design.items_by_id if column.endswith(each))
            least, most, points = scale_of(item)
            assert (next(iter(levels)), list(levels)[-1], len(levels)) == (str(least), str(most), points)


def test_dashboard_shows_each_score_with_its_range(study: StudyStore, out: Path) -> None:
    scores = read(out / "analysis" / "tables" / "scores.csv").query("participant == 'sub-001'")
    shown = {
        (each.moment, each.position, each.scale): each
        for each in make_displayed_participant(study, "sub-001").scores
    }
    assert len(shown) == len(scores)
    for row in scores.itertuples():
        position = None if pd.isna(row.position) else int(row.position)
        seen = shown[row.moment, position, row.scale]
        assert (seen.minimum, seen.maximum) == (row.minimum, row.maximum)
        assert seen.score == pytest.approx(row.score, nan_ok=True)


def test_dashboard_shows_means_on_the_scales_of_instruments(study: StudyStore, out: Path) -> None:
    shown = {row.policy: row.answer_means for row in summarise_results(study)}
    items = read(out / "analysis" / "tables" / "subjective.csv").query("task == 'all' and robot == 'all'")
    for row in items.itertuples():
        assert shown[row.policy][row.item] == pytest.approx(row.mean)
