"""Simulated power: agreement with calculus, the tests of the analysis, and the same results for the same seed."""

import json
import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

from avrgym.analysis.answers.trial_answers import compute_answer_test_families
from avrgym.analysis.models.effects import TrialValue
from avrgym.analysis.power.power_simulation import (
    PowerRow,
    choose_default_sample_sizes,
    compute_primary_p_values,
    count_significant_studies,
    find_required_participants,
    make_power_rows,
    order_trial_values,
)
from avrgym.analysis.power.simulated_studies import PowerAssumptions, SimulatedStudies
from avrgym.analysis.power.summary import compute_min_p_value, describe_power
from avrgym.analysis.primary_results import assign_result_roles
from avrgym.analysis.reading.table_rows import AnswerRow
from avrgym.analysis.statistics.comparisons import PARTICIPANT_UNIT
from avrgym.cli.main import app
from avrgym.study.design.design import Design, parse_design, read_default_design_text

DESIGN = parse_design(read_default_design_text())
NOISE_ONLY = PowerAssumptions(participant_sd=0, policy_sd=0, task_sd=0, noise_sd=1, drift=0, dropout=0)
BETWEEN = f"policies, by {PARTICIPANT_UNIT}"
SIMULATIONS = 1500


def one_pair(points: int) -> Design:
    """Each participant answers one item once with each of two policies."""
    text = re.sub(r"(?m)^    \{ id = \"L[234]\".*\n", "", read_default_design_text())
    text = text.replace("points = 7", f"points = {points}")
    text = re.sub(r"(?m)^tasks = .*$", 'tasks = ["Feeding"]', text)
    return parse_design(re.sub(r"(?m)^robots = .*$", 'robots = ["Jaco"]', text))


def simulated(design: Design, effect: float, participants: int, test: str) -> float:
    """The share of studies in which a test finds the effect, before correction."""
    studies = SimulatedStudies(design, NOISE_ONLY, 5)
    none = np.zeros((participants, len(design.policies), 0))
    found = [
        compute_primary_p_values(
            design, studies.questionnaire, studies.simulate_answers(effect, participants, number), none
        )
        for number in range(SIMULATIONS)
    ]
    return sum((each[test, "L1"][0] or 1.0) < 0.05 for each in found) / SIMULATIONS


# Calculus


@pytest.mark.slow
def test_on_two_points_power_is_that_of_the_sign_test() -> None:
    """Differences are −1, 0 or 1, so that the signed-rank test counts signs; zeros are left out."""
    participants, effect = 24, 1.0
    above = stats.norm.cdf(effect)
    up, down = above * 0.5, (1 - above) * 0.5
    expected = 0.0
    for differ in range(participants + 1):
        for more in range(differ + 1):
            if differ and stats.binomtest(more, differ).pvalue < 0.05:
                ways = stats.binom.pmf(differ, participants, up + down)
                expected += ways * stats.binom.pmf(more, differ, up / (up + down))
    assert simulated(one_pair(2), effect, participants, BETWEEN) == pytest.approx(expected, abs=0.02)


@pytest.mark.slow
def test_of_normal_answers_power_is_that_of_student_with_few_more() -> None:
    """Of normal differences the signed-rank test has the power of Student's t with 3/π of the values (Hodges and
    Lehmann, Ann. Math. Stat. 27, 1956, asymptotically)."""
    participants, effect = 24, 0.9
    used = participants * 3 / np.pi
    noncentral = effect / np.sqrt(2) * np.sqrt(used)
    limit = stats.t.ppf(0.975, used - 1)
    expected = stats.nct.sf(limit, used - 1, noncentral) + stats.nct.cdf(-limit, used - 1, noncentral)
    assert simulated(one_pair(101), effect, participants, BETWEEN) == pytest.approx(expected, abs=0.02)


# The analysis


def test_imagined_answers_are_tested_as_the_analysis_tests_answers() -> None:
    studies = SimulatedStudies(DESIGN, PowerAssumptions(), 3)
    answers = studies.simulate_answers(0.7, 7, 0)
    rows = [
        _row(f"sub-{number:03}", task, robot, policy, item.id, int(answers[number, t, r, p, i]))
        for number in range(len(answers))
        for (t, task), (r, robot), (p, policy), (i, item) in product(
            enumerate(DESIGN.tasks),
            enumerate(DESIGN.robots),
            enumerate(DESIGN.policies),
            enumerate(studies.questionnaire.items),
        )
    ]
    found = {
        (row.family, row.quantity): (row.p, row.p_primary)
        for family in assign_result_roles(compute_answer_test_families(DESIGN, rows), [], None).families
        for row in family.rows
        if row.unit == PARTICIPANT_UNIT and row.group_a == "revised"
    }
    assert len(found) == 5
    none = np.zeros((7, 2, 0))
    assert compute_primary_p_values(DESIGN, studies.questionnaire, answers, none) == found
    values = {(each.task, each.robot, each.policy): each.value for each in _observed(studies, 0.7, 3)}
    assert values == {
        (task, robot, policy): answers[3, t, r, p, 0]
        for (t, task), (r, robot), (p, policy) in product(
            enumerate(DESIGN.tasks), enumerate(DESIGN.robots), enumerate(DESIGN.policies)
        )
    }


def _observed(studies: SimulatedStudies, effect: float, who: int) -> list[TrialValue]:
    """The trials of a participant of the first study of seven, as its model takes them."""
    answers = studies.simulate_answers(effect, 7, 0)[..., 0].astype(float)
    trials = order_trial_values(studies.design, answers, studies.simulate_trial_orders(7, 0))
    return [each for each in trials if each.participant == f"sub-{who + 1:03}"]


def test_power_is_that_of_primary_tests_and_the_model_and_of_no_test_by_trial() -> None:
    counts = count_significant_studies(DESIGN, PowerAssumptions(), 3.0, 8, 0, range(3))
    assert list(counts) == [
        ("L1 against the middle, by participant", "L1"),
        *((BETWEEN, f"L{item}") for item in (1, 2, 3, 4)),
        ("policies, models of answers", "L1"),
    ]
    assert counts["policies, models of answers", "L1"] == (3, 3)
    few = count_significant_studies(DESIGN, PowerAssumptions(), 3.0, 3, 0, range(3))
    assert set(few.values()) == {(0, 0)}


def _row(participant: str, task: str, robot: str, policy: str, item: str, value: int) -> AnswerRow:
    return AnswerRow(
        participant=participant, simulated=True, counted=True, session=1, moment="after_trial", questionnaire="likert",
        position=1, task=task, robot=robot, policy=policy, attempt=1, item=item, value=value, minimum=1, maximum=7,
        points=7, response_time_s=1.0, respondent="participant",
    )  # fmt: skip


# Studies


def test_who_comes_first_does_not_depend_on_who_follows() -> None:
    studies = SimulatedStudies(DESIGN, PowerAssumptions(dropout=0.3), 1)
    few, many = studies.simulate_answers(1.0, 4, 9), studies.simulate_answers(1.0, 12, 9)
    assert few.shape == (4, 4, 2, 2, 4)
    assert np.array_equal(few, many[:4])
    assert not np.array_equal(few, studies.simulate_answers(1.0, 4, 10))
    assert (studies.simulate_answers(2.0, 12, 9) >= many).all()
    assert set(np.unique(many)) <= set(range(1, 8))


def test_drift_goes_with_the_place_in_the_session() -> None:
    """Without noise, later conditions get higher ratings; this cancels out over all orders."""
    assumed = replace(NOISE_ONLY, noise_sd=0, drift=6.0)
    answers = SimulatedStudies(DESIGN, assumed, 0).simulate_answers(0.0, 4, 0)
    assert answers.min() == 1
    assert answers.max() == 7
    assert np.ptp(answers[..., 0].mean(axis=(0, 1, 2))) < 0.3
    assert np.ptp(answers[..., 0].mean(axis=(0, 2, 3))) < 0.3


def test_the_least_number_is_the_one_from_which_on_power_suffices() -> None:
    rows: list[PowerRow] = []
    for participants, hits in {4: 10, 8: 85, 12: 70, 16: 85, 20: 95}.items():
        rows += make_power_rows([{("test", "L1"): (99, hits)}], 1.0, participants, 100)
    assert [
        find_required_participants(rows, 1.0, "test", "L1", target_power)
        for target_power in (0.6, 0.8, 0.9, 0.99)
    ] == [
        8,
        16,
        20,
        None,
    ]
    assert choose_default_sample_sizes(DESIGN) == (4, 8, 12, 16, 20, 24, 32, 40, 48, 64)


@pytest.mark.parametrize(
    ("participants", "words"),
    [
        (5, "at least 0.0625: no such test can be significant"),
        (3, "No test is computed for fewer than 4 participants."),
        (8, "at least 0.00781."),
    ],
)
def test_words_say_what_so_few_can_show(participants: int, words: str) -> None:
    rows = [
        *make_power_rows([{(BETWEEN, "L1"): (70, 20)}], 1.0, participants, 100),
        *make_power_rows([{(BETWEEN, "L1"): (5, 1)}], 0.0, participants, 100),
    ]
    told = " ".join(describe_power(PowerAssumptions(), rows, participants))
    assert words in told
    assert "after correction in 20 % (13 to 29): power is below 50 %" in told
    assert "Without an effect, 'policies, by participant' is significant in 5 %" in told
    assert compute_min_p_value(8) == 2 / 2**8


@pytest.mark.slow
def test_a_studys_power_on_the_command_line(tmp_path: Path) -> None:
    """Two processes give what one gives."""
    design = tmp_path / "study.toml"
    design.write_text(read_default_design_text())
    arguments = ["--effect", "2", "--participants", "4", "--simulations", "101", "--seed", "7", "--jobs", "2"]
    command = ["study", "power", str(tmp_path), *arguments, "--json", str(tmp_path / "power.json")]
    shown = CliRunner().invoke(app, command)
    assert shown.exit_code == 0, shown.output
    assert "8 participants who complete the study (about 9 enrolled if 10 % withdraw):" in shown.stdout
    found = json.loads((tmp_path / "power.json").read_text())
    assert found["assumptions"]["noise_sd"] == 1.0
    assert {(row["effect"], row["participants"]) for row in found["power"]} == {(0.0, 8), (2.0, 4), (2.0, 8)}
    expected = count_significant_studies(DESIGN, PowerAssumptions(), 2.0, 8, 7, range(101))
    for row in found["power"]:
        if (row["effect"], row["participants"]) == (2.0, 8):
            times = tuple(round(101 * row[name]) for name in ("power", "corrected_power"))
            assert times == expected[row["test"], row["measure"]]
    assert {path.name for path in tmp_path.iterdir()} == {"study.toml", "power.json"}


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    text = read_default_design_text()
    nothing = text[: text.index("\n[[questionnaires]]\n")] + text[text.index("\n[goals]\n") :]
    with pytest.raises(ValueError, match="no questionnaire after trials"):
        SimulatedStudies(parse_design(nothing), PowerAssumptions(), 0)
    with pytest.raises(ValueError, match="noise_sd is -1; allowed: 0 or more"):
        PowerAssumptions(noise_sd=-1)
    (tmp_path / "study.toml").write_text(text)
    for effect in ("0", "nan"):
        refused = CliRunner().invoke(app, ["study", "power", str(tmp_path), "--effect", effect])
        assert (
            refused.stderr == f"avrgym: effect size is {effect} points; allowed: more than 0, less than 7\n"
        )
    refused = CliRunner().invoke(app, ["study", "power", str(tmp_path), "--dropout", "1"])
    assert (refused.exit_code, refused.stderr) == (1, "avrgym: dropout is 1; allowed: 0 or more, below 1\n")
