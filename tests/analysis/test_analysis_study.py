"""The analysis of a study: results follow from its tables; people and simulated participants are separate."""

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from avrgym.analysis.figures import draw_figures
from avrgym.analysis.outcomes.condition_outcomes import list_outcome_tests
from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.plan import list_required_tests
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    Comparison,
    ResearchQuestion,
    make_holm_corrected_family,
)
from avrgym.analysis.statistics.rank_tests import (
    apply_holm_correction,
    compute_clustered_wilson_interval,
    run_signed_rank_test,
)
from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.study.people.participants import withdraw_participant
from avrgym.study.storage.store import StudyStore
from avrgym.vr.latency import LATENCY_STAGES, TOTAL_LATENCY_KEY
from helpers.browser.html_page import Page
from helpers.studies.known_results import ITEMS, enrol_included, interrupt_trial, latency_of, run_trials
from helpers.studies.small_studies import small_study

PEOPLE, SIMULATED = 3, 5
Frame = Any  # a pandas data frame, whose types no checker follows


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudyStore]:
    """People and simulated participants who finished, one who withdrew, and one who broke off an attempt."""
    with StudyStore(small_study(tmp_path_factory.mktemp("analysed"))) as opened:
        for number in range(PEOPLE + SIMULATED):
            simulated = number >= PEOPLE
            run_trials(opened, enrol_included(opened, "man" if number % 2 else "woman", simulated=simulated))
        gone = enrol_included(opened, simulated=False)
        run_trials(opened, gone, 3)
        withdraw_participant(opened, gone)
        pausing = enrol_included(opened)
        run_trials(opened, pausing, 2)
        interrupt_trial(opened, pausing)
        yield opened


@pytest.fixture(scope="module")
def analysis(store: StudyStore) -> StudyAnalysis:
    return analyse_study(store)


@pytest.fixture(scope="module")
def out(store: StudyStore, analysis: StudyAnalysis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    assert write_analysis(analysis, store.folder, folder) == folder / "report" / "index.html"
    return folder


@pytest.fixture(scope="module")
def tables(out: Path) -> dict[str, Frame]:
    return {path.stem: pd.read_csv(path) for path in (out / "tables").glob("*.csv")}


def only(frame: Frame, **values: Any) -> Frame:
    for column, value in values.items():
        frame = frame[frame[column] == value]
    return frame


# What counts


def test_every_trial_attempt_and_state_is_counted_and_shown(tables: dict[str, Frame]) -> None:
    trials, attempts = tables["trials"], tables["attempts"]
    assert len(trials) == 5 * (PEOPLE + SIMULATED + 2)
    assert trials["state"].value_counts().to_dict() == {"completed": 45, "planned": 5}
    assert trials["attempts"].sum() == len(attempts) == 46
    assert attempts["state"].value_counts().to_dict() == {"completed": 45, "stopped": 1}
    assert trials["attempts_not_completed"].sum() == 1
    assert trials["counted"].sum() == 4 * (PEOPLE + SIMULATED) + 1
    gone = only(trials, participant_state="withdrawn")
    assert (len(gone), gone["counted"].any()) == (5, False)
    assert not only(trials, practice=True)["counted"].any()
    missing = tables["participants"].set_index("participant")["trials_missing"]
    assert missing.to_dict() == {"sub-009": 2, "sub-010": 3} | {f"sub-{n:03}": 0 for n in range(1, 9)}


def test_every_table_says_what_was_simulated(tables: dict[str, Frame]) -> None:
    assert all("simulated" in table.columns for table in tables.values())
    assert tables["people"]["simulated"].all()
    people = {f"sub-{number:03}" for number in (1, 2, 3, 9)}
    for name in ("participants", "trials", "attempts", "answers", "reward_terms", "control_steps"):
        assert set(only(tables[name], simulated=False)["participant"]) == people, name


def test_people_and_simulated_participants_are_never_taken_together(tables: dict[str, Frame]) -> None:
    objective = only(tables["objective"], task="Feeding").groupby("simulated")["trials"].max()
    assert objective.to_dict() == {False: PEOPLE, True: SIMULATED + 1}
    tests = only(tables["tests"], family="policies, by participant").groupby("simulated")["n_a"].max()
    assert tests[False] == PEOPLE
    heights = only(tables["biomechanics"], population="participants", quantity="torso_height_m")
    assert heights.set_index("simulated")["n"].to_dict() == {False: PEOPLE, True: SIMULATED + 1}


# Numbers from the tables alone


def test_objective_measures_follow_from_the_trials(tables: dict[str, Frame]) -> None:
    counted = only(tables["trials"], counted=True)
    for row in tables["objective"].itertuples():
        own = only(counted, simulated=row.simulated, robot=row.robot, policy=row.policy)
        successes = int(own["success"].astype(bool).sum())
        assert (row.trials, row.successes) == (len(own), successes)
        clusters = [each["success"].astype(bool).tolist() for _, each in own.groupby("participant")]
        assert (row.success_low, row.success_high) == pytest.approx(
            compute_clustered_wilson_interval(clusters)
        )
        if row.task == "all":
            assert np.isnan(row.reward_mean)
            continue
        interval = stats.ttest_1samp(own["reward"], 0.0).confidence_interval()
        expected = (own["reward"].mean(), *interval)
        assert (row.reward_mean, row.reward_low, row.reward_high) == pytest.approx(expected, abs=1e-12)


def test_the_papers_tables_hold_each_condition_and_mean_success(tables: dict[str, Frame]) -> None:
    """Table I: simulation beside VR for a policy; table II: the policies in VR; the last row is over all tasks."""
    rows = tables["objective"].set_index(["simulated", "task", "robot", "policy"])
    shown = {policy: tables[f"paper_table_1_{policy}"] for policy in ("original", "revised")}
    for policy, table in shown.items():
        for _, row in table.iterrows():
            for robot in ("PR2", "Jaco"):
                own = rows.loc[(row["simulated"], row["task"], robot, policy)]
                both = (
                    tables["paper_table_2"]
                    .set_index(["simulated", "task"])
                    .loc[(row["simulated"], row["task"])]
                )
                assert row[f"VR {robot} success"] == both[f"{policy} {robot} success"] == own["success_rate"]
                assert row[f"simulation {robot} success"] == own["simulation_success_rate"]
                for column in (f"simulation {robot} reward", f"VR {robot} reward"):
                    assert np.isnan(row[column]) == (row["task"] == "all")
    parts = rows.drop("all", level="task")
    for key, whole in rows.xs("all", level="task").iterrows():
        tasks = parts.xs(key, level=("simulated", "robot", "policy"))
        assert whole["simulation_success_rate"] == pytest.approx(tasks["simulation_success_rate"].mean())
        assert whole["simulation_episodes"] == tasks["simulation_episodes"].sum()


def test_recorded_rewards_and_terms_follow_from_the_control_steps(tables: dict[str, Frame]) -> None:
    keys = ["participant", "position"]
    steps = tables["control_steps"].groupby(keys)
    completed = only(tables["trials"], state="completed").set_index(keys)
    assert np.allclose(
        steps["reward"].sum(), completed["reward_recorded"].loc[steps.size().index], atol=1e-12
    )
    assert np.allclose(completed["reward_recorded"], completed["reward"], rtol=1e-12, atol=0)
    assert np.allclose(steps["force_on_person_n"].max(), completed["force_peak_n"], rtol=1e-12, atol=0)
    distances = only(tables["reward_terms"], term="distance_m").set_index(keys)["sum"]
    assert np.allclose(steps["term_distance_m"].sum(), distances, atol=1e-12)


def test_answers_in_numbers_follow_from_the_answers(tables: dict[str, Frame]) -> None:
    counted = only(tables["answers"], counted=True)
    for row in tables["subjective"].itertuples():
        own = only(counted, simulated=row.simulated, item=row.item, policy=row.policy)
        own = own if row.robot == "all" else only(own, robot=row.robot)
        assert (row.n, row.median) == (len(own), own["value"].median())
        assert (row.lower_quartile, row.upper_quartile) == tuple(own["value"].quantile([0.25, 0.75]))
        assert row.mean == pytest.approx(own["value"].mean(), abs=1e-12)
    likert = tables["likert"].groupby(["simulated", "item", "policy"])
    assert np.allclose(likert["share"].sum(), 1.0)


@pytest.mark.parametrize(("simulated", "item"), list(product([False, True], ITEMS)))
def test_policies_are_compared_as_scipy_compares_the_exported_answers(
    tables: dict[str, Frame], simulated: bool, item: str
) -> None:
    own = only(tables["answers"], counted=True, simulated=simulated, item=item)
    pairs = own.pivot(index=["participant", "task", "robot"], columns="policy", values="value").dropna()
    differences = (pairs["revised"] - pairs["original"]).to_numpy()
    used = differences[differences != 0]
    (row,) = only(
        tables["tests"], simulated=simulated, family="policies, by trial", quantity=item
    ).itertuples()
    assert (row.n_a, row.n, row.zeros) == (len(pairs), len(used), len(differences) - len(used))
    assert row.median_a == pairs["revised"].median()
    if simulated:
        assert row.p == pytest.approx(exact_p(used), abs=1e-12)
    else:
        assert np.isnan(row.p)
        assert row.note == "fewer than 4 participants"
    ranks = stats.rankdata(np.abs(used))
    expected = (ranks[used > 0].sum() - ranks[used < 0].sum()) / ranks.sum()
    assert row.effect == pytest.approx(expected, abs=1e-12)


def test_only_primary_results_have_stars(tables: dict[str, Frame]) -> None:
    tests = tables["tests"]
    assert (tests["stars"].notna() == (tests["p_primary"] < 0.05)).all()
    assert (only(tests, unit="trial")["role"] == "supplement").all()
    assert tests[tests["p_primary"].notna()]["role"].unique().tolist() == ["primary"]
    assert tables["models"]["stars"].isna().all()


def test_nothing_is_inferred_from_fewer_than_four_people(
    store: StudyStore, out: Path, tables: dict[str, Frame]
) -> None:
    for name in ("tests", "models"):
        own = only(tables[name], simulated=False)
        assert len(own)
        assert own[["p", "p_holm", "p_primary", "stars"]].isna().all(axis=None), name
        assert own["note"].str.contains("fewer than 4 participants|all differences").all()
    page = (out / "report" / "index.html").read_text()
    people = page[page.index("<article") : page.index("</article>")]
    assert 'id="people"' in people
    assert "p = " not in people
    assert "With fewer than 4 participants, results are described and not tested." in people
    for path in (out / "reporting").glob("*-people.tex"):
        rows = path.read_text().split(r"\midrule")[-1]
        assert "*" not in rows, path
        if path.name.startswith(("primary", "tests", "models")):
            results = [line for line in rows.splitlines() if "&" in line]
            assert results
            assert all("no test" in line for line in results), path


@pytest.mark.slow
def test_figures_show_tests_by_participant_alone(store: StudyStore) -> None:
    """Fewer than four people took part: their figure shows no test."""
    analysis = analyse_study(store)
    people, simulated = (
        next(each.to_inline_svg() for each in draw_figures(analysis) if each.name == name)
        for name in ("likert-people", "likert-simulated")
    )
    family = "policies, by participant"
    rows = [
        row for row in analysis.tests if row.simulated and row.family == family and row.p_primary is not None
    ]
    assert "p = " not in people
    assert simulated.count("p = ") == len(rows)
    assert all(f"p = {row.p_primary:.3f}" in simulated for row in rows)


def exact_p(used: np.ndarray) -> float:
    """Of all choices of signs, the share with a sum of signed ranks at least as far from zero."""
    ranks = stats.rankdata(np.abs(used))
    signs = np.array(list(product([-1.0, 1.0], repeat=len(used))))
    return float(np.mean(np.abs(signs @ ranks) >= abs(np.sign(used) @ ranks) - 1e-9))


def test_success_is_compared_with_the_middle_by_participant(tables: dict[str, Frame]) -> None:
    own = only(tables["answers"], counted=True, simulated=True, item="L1", policy="revised")
    means = own.groupby("participant")["value"].mean() - 4
    rows = only(
        tables["tests"], simulated=True, family="L1 against the middle, by participant", group_a="revised"
    )
    assert rows["p"].item() == pytest.approx(exact_p(means[means != 0].to_numpy()), abs=1e-12)


def test_families_are_corrected_by_holm(tables: dict[str, Frame]) -> None:
    for _, family in tables["tests"].groupby(["simulated", "family"]):
        given = [None if np.isnan(p) else p for p in family["p"]]
        expected = [np.nan if p is None else p for p in apply_holm_correction(given)]
        assert np.allclose(family["p_holm"], expected, equal_nan=True, atol=1e-15)


def test_a_plan_may_name_the_tests_that_the_analysis_does_and_no_others(
    store: StudyStore, tables: dict[str, Frame]
) -> None:
    done = tables["tests"].groupby("family", sort=False)["quantity"].unique()
    offered = list_required_tests(store.design) | list_outcome_tests(store.design)
    assert {test: set(measures) for test, measures in done.items()} == {
        test: set(measures) for test, measures in offered.items()
    }


def test_without_a_frozen_plan_nothing_is_called_planned(out: Path, tables: dict[str, Frame]) -> None:
    assert tables["tests"]["plan_status"].isna().all()
    assert "plan" not in json.loads((out / "results.json").read_text())
    page = (out / "report" / "index.html").read_text()
    assert page.count("nothing was preregistered") == 1
    assert "Confirmatory" not in page


@pytest.mark.slow
def test_a_family_that_is_added_appears_in_the_report(
    store: StudyStore, analysis: StudyAnalysis, tmp_path: Path
) -> None:
    found = run_signed_rank_test([2.0, 3.0])
    hum = Comparison("hum_db", ("PR2", [3.0, 4.0]), ("Jaco", [1.0, 1.0]), found, 2)
    added = make_holm_corrected_family(
        True, ResearchQuestion("noise", table_caption="How loud robots are"), PARTICIPANT_UNIT, [hum]
    )
    report = write_analysis(
        replace(analysis, test_families=[*analysis.test_families, added]), store.folder, tmp_path
    )
    shown = report.read_text()
    assert "How loud robots are (simulated participants)" in shown
    assert "hum_db" in shown


def test_biomechanics_follow_from_trials_and_people(tables: dict[str, Frame]) -> None:
    trials = only(tables["trials"], counted=True, simulated=True, recorded="whole")
    people = only(tables["people"], population="revised")
    heights = trials.groupby("participant")["torso_height_m"].median()
    row = row_of(tables, "torso heights, by participant", "torso_height_m", "revised")
    expected: Any = stats.mannwhitneyu(heights, people["torso_height_m"], method="exact")
    assert (row.p, row.statistic) == pytest.approx((expected.pvalue, expected.statistic), abs=1e-12)
    row = row_of(tables, "head positions, by trial", "head_z_m, seated", "revised")
    partners = people["head_z_m"].to_numpy()[: len(trials)]
    expected = stats.wilcoxon(trials["head_z_m"].to_numpy() - partners, method="exact")
    assert (row.n, row.p) == (len(trials), pytest.approx(expected.pvalue, abs=1e-12))
    row = row_of(tables, "whole head positions, by participant", "head_m, seated", "original")
    axes = ["head_x_m", "head_y_m", "head_z_m"]
    own = trials.groupby("participant")[axes].mean().to_numpy()
    others = only(tables["people"], population="original")[axes].to_numpy()
    expected = 2 * apart(own, others) - apart(own, own) - apart(others, others)
    assert row.statistic == pytest.approx(expected, abs=1e-12)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a[:, None] - b[None], axis=-1).mean())


def row_of(tables: dict[str, Frame], family: str, quantity: str, people: str) -> Any:
    rows = only(tables["tests"], simulated=True, family=family, quantity=quantity, group_b=people)
    (row,) = rows.itertuples()
    return row


def test_ranges_say_what_would_have_covered_the_participants(tables: dict[str, Frame]) -> None:
    ranges = only(tables["ranges"], simulated=True).set_index("quantity")
    heights = only(tables["participants"], simulated=True).groupby("sex")["torso_height_m"]
    for sex in ("man", "woman"):
        row = ranges.loc[f"torso_height_{sex}_m"]
        assert (row["minimum"], row["maximum"]) == pytest.approx((heights.min()[sex], heights.max()[sex]))
    assert ranges.loc["torso_height_man_m", ["original_share", "revised_share"]].tolist() == [0.0, 1.0]
    trials = only(tables["trials"], counted=True, simulated=True)
    within = trials["waist_x_min_deg"].ge(-10) & trials["waist_x_max_deg"].le(10)
    assert ranges.loc["waist_x_deg, all of a trial", "revised_share"] == pytest.approx(within.mean())


def test_latency_follows_from_what_clients_told_in_counted_trials(
    store: StudyStore, out: Path, tables: dict[str, Frame]
) -> None:
    """Simulated participants have no latency; withdrawn participants are not counted."""
    rows, trials = tables["latency"], tables["trials"]
    counted = trials[trials.counted & ~trials.simulated]
    assert not rows.simulated.any()
    assert set(rows.participant.dropna()) == set(counted.participant)
    total = rows[rows.participant.isna() & (rows.stage == TOTAL_LATENCY_KEY)].iloc[0]
    others = len(LATENCY_STAGES) - 1
    waits = [
        others + wait
        for participant in counted.participant
        for wait in latency_of(store.read_participant(participant)).draw_ms
    ]
    assert total.pictures == len(waits) == 3 * len(counted)
    assert (total.p50_ms, total.p95_ms) == pytest.approx(tuple(np.percentile(waits, [50, 95])))
    page = (out / "report/index.html").read_text("utf-8")
    assert "Latency from pose to frame" in page
    assert page.count("<h3>Latency</h3>") == 1


def test_the_results_file_holds_the_tables(out: Path, tables: dict[str, Frame]) -> None:
    results = json.loads((out / "results.json").read_text())
    for name, table in tables.items():
        if name not in ("people", "control_steps"):
            assert len(results[name]) == len(table), name
    p = np.array([row["p"] for row in results["tests"]], float)
    assert np.allclose(p, tables["tests"]["p"], rtol=1e-12, atol=0, equal_nan=True)
    pack = len(list((out / "reporting").iterdir())) + 1
    assert len(results["files"]) == len(tables) + 24 + 1 + pack


# The page and the files


def test_the_page_is_one_file_with_unique_ids_and_working_references(store: StudyStore, out: Path) -> None:
    page = Page(out / "report" / "index.html")
    ids = page.attributes("id")
    assert len(set(ids)) == len(ids)
    references = page.attributes("href") + page.attributes("src") + page.attributes("xlink:href")
    inner = [reference for reference in references if reference[0] == "#"]
    assert {reference[1:] for reference in inner} <= set(ids)
    files = [(out / "report" / name).resolve() for name in references if name[0] != "#"]
    assert len(files) == 45
    assert all(path.is_file() and path.is_relative_to(store.folder) for path in files)
    assert not {"script", "link", "iframe"} & {tag for tag, _ in page.tags}


def test_the_page_says_what_was_found_and_what_was_simulated(out: Path, tables: dict[str, Frame]) -> None:
    words = " ".join(Page(out / "report" / "index.html").text.split())
    expected = {
        "6 of the 10 participants are simulated",
        "avrgym replay recordings/sub-001/ses-01/trial-02_attempt-1.mcap",
        "None: every recording is present, complete and consistent.",
        "sub-010, 1: Feeding",
        "SIMULATED PARTICIPANTS",
        *(f"{item} The robot" for item in ("L1", "L4")),
    }
    assert {text for text in expected if text not in words} == set()
    row = tables["objective"].iloc[0]
    assert f"{row.reward_mean:.0f} ({100 * row.success_rate:.0f} %)".replace("-", "−") in words


@pytest.mark.parametrize("group", ["people", "simulated"])
def test_figures_of_simulated_participants_say_so(out: Path, group: str) -> None:
    figures = sorted((out / "figures").glob(f"*-{group}.svg"))
    assert len(figures) == 6
    for figure in figures:
        assert ("SIMULATED PARTICIPANTS" in figure.read_text()) == (group == "simulated"), figure.name


@pytest.mark.slow
def test_the_same_study_gives_the_same_bytes(store: StudyStore, out: Path, tmp_path: Path) -> None:
    folder = out.parent / tmp_path.name
    write_analysis(analyse_study(store), store.folder, folder)
    files = [path.relative_to(out) for path in out.rglob("*") if path.is_file()]
    assert [name for name in files if (out / name).read_bytes() != (folder / name).read_bytes()] == []
