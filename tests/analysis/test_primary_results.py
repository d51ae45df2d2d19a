"""Primary results: one for each question, correct stars, and no interval without information."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from avrgym.analysis.models.effects import TrialValue, list_effects_of_interest
from avrgym.analysis.models.estimate import EffectEstimate
from avrgym.analysis.models.fitting import MIXED_MODEL, UNRELIABLE_P_NOTE, estimate_effects
from avrgym.analysis.outcomes.condition_outcomes import OBJECTIVE_QUESTION, compute_mean_with_interval
from avrgym.analysis.page.html_elements import format_p_value
from avrgym.analysis.page.hypothesis_test_tables import render_hypothesis_test_table
from avrgym.analysis.power.simulated_studies import PowerAssumptions, SimulatedStudies
from avrgym.analysis.primary_results import assign_result_roles
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    TRIAL_UNIT,
    Comparison,
    ComparisonRow,
    ResearchQuestion,
    make_holm_corrected_family,
)
from avrgym.analysis.statistics.rank_tests import (
    apply_holm_correction,
    compute_t_interval,
    run_rank_sum_test,
    run_signed_rank_test,
)
from avrgym.analysis.statistics.sign_flips import compute_sign_flip_p_values
from avrgym.study.design.design import parse_design, read_default_design_text
from avrgym.study.plan.analysis_plan import AnalysisPlan, ExclusionRules, Hypothesis
from inference import any_star, imagined

DESIGN = parse_design(read_default_design_text())
STUDIES = SimulatedStudies(DESIGN, PowerAssumptions(), 3)


def rows(effect: float = 0.7, people: int = 8, number: int = 0) -> list[ComparisonRow]:
    return imagined(DESIGN, STUDIES, effect, people, number)


def planned(*tests: str) -> AnalysisPlan:
    hypothesis = Hypothesis("H1", "Better.", ("L1",), tests)
    return AnalysisPlan(participants=8, exclusion=ExclusionRules(0.5), hypotheses=(hypothesis,))


# Roles


def test_each_question_has_one_primary_result() -> None:
    tests = rows()
    asked = {(each.family.rpartition(", by ")[0], each.quantity, each.group_a) for each in tests}
    primary = [each for each in tests if each.role == "primary"]
    assert len(primary) == len(asked) == 9
    assert {each.unit for each in primary} == {PARTICIPANT_UNIT}
    assert {each.role for each in tests if each.unit == TRIAL_UNIT} == {"supplement"}
    assert all(each.p_primary is not None for each in primary if each.p is not None)
    assert not any(each.stars for each in tests if each.role != "primary")


def test_tables_show_the_correction_over_primary_results_next_to_holms() -> None:
    own = [each for each in rows() if each.family == OBJECTIVE_QUESTION.make_family_name(PARTICIPANT_UNIT)]
    shown = render_hypothesis_test_table("Tests", own, simulated=False)
    heads = re.findall("<th[^>]*>([^<]*)</th>", shown)
    cells = re.findall("<td[^>]*>([^<]*)</td>", shown)
    table = [
        dict(zip(heads, cells[at : at + len(heads)], strict=True)) for at in range(0, len(cells), len(heads))
    ]
    assert [(row["p, Holm"], row["p, corrected"]) for row in table] == [
        (format_p_value(each.p_holm), format_p_value(each.p_primary)) for each in own
    ]
    others = [replace(each, role="secondary", p_primary=None) for each in own]
    assert "p, corrected" not in render_hypothesis_test_table("Tests", others, simulated=False)


@pytest.mark.parametrize("unit", [TRIAL_UNIT, PARTICIPANT_UNIT])
def test_with_a_plan_its_hypotheses_are_primary_each_participant_one_value(unit: str) -> None:
    found = {"L1": [1.0, 2.0, 3.0, 4.0], "L2": [1.0, -2.0, 3.0, 4.0]}
    question = ResearchQuestion("policies", "tests", is_primary=True)
    families = [
        make_holm_corrected_family(
            False, question, each, [_paired(name, values) for name, values in found.items()]
        )
        for each in (TRIAL_UNIT, PARTICIPANT_UNIT)
    ]
    tests = assign_result_roles(families, [], planned(f"policies, by {unit}")).families
    roles = {(row.unit, row.quantity): row.role for family in tests for row in family.rows}
    assert roles == {
        (TRIAL_UNIT, "L1"): "supplement",
        (TRIAL_UNIT, "L2"): "supplement",
        (PARTICIPANT_UNIT, "L1"): "primary",
        (PARTICIPANT_UNIT, "L2"): "secondary",
    }


def _paired(quantity: str, values: list[float]) -> Comparison:
    differences = {f"sub-{place:03}": value for place, value in enumerate(values)}
    return Comparison(
        quantity,
        ("b", values),
        ("a", [0.0] * len(values)),
        run_signed_rank_test(values),
        len(values),
        differences,
    )


def test_unpaired_tests_of_a_plan_are_corrected_by_holm_beside_the_paired_ones() -> None:
    paired, unpaired = (
        ResearchQuestion("policies", "t", is_primary=True),
        ResearchQuestion("heights", "t", is_primary=True),
    )
    values, taller = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], ([7.0, 8.0, 9.0, 9.5], [1.0, 2.0, 3.0, 4.0, 5.0])
    height = Comparison(
        "h", ("participants", taller[0]), ("others", taller[1]), run_rank_sum_test(*taller), 4
    )
    families = [
        make_holm_corrected_family(False, paired, PARTICIPANT_UNIT, [_paired("L1", values)]),
        make_holm_corrected_family(False, unpaired, PARTICIPANT_UNIT, [height]),
    ]
    first, second = (family.rows[0] for family in assign_result_roles(families, [], None).families)
    assert (first.p, second.p) == (2 / 2**6, pytest.approx(2 / 126))
    assert (first.p_primary, second.p_primary) == (pytest.approx(4 / 2**6), pytest.approx(4 / 126))
    assert (first.stars, second.stars) == ("", "*")


def test_objective_measures_are_primary_where_policies_are_compared() -> None:
    own = [each for each in rows() if each.family == OBJECTIVE_QUESTION.make_family_name(PARTICIPANT_UNIT)]
    assert [each.quantity for each in own] == ["success", "reward", "force_mean_n"]
    assert {each.role for each in own} == {"primary"}


# Correction


@pytest.mark.parametrize("people", [4, 7])
def test_the_joint_correction_is_that_of_all_choices_of_signs(people: int, rng: np.random.Generator) -> None:
    """Recomputed choice by choice, test by test, and no worse than Holm's."""
    given = rng.integers(-3, 4, (5, people)).astype(float)
    given[2] = given[1]
    own = [{str(person): value for person, value in enumerate(test)} for test in given.tolist()]
    plain = [run_signed_rank_test(test).p for test in given]
    found = compute_sign_flip_p_values(own)
    for p, least, most in zip(found, plain, apply_holm_correction(plain), strict=True):
        assert (p is None) == (least is None)
        if p is not None and least is not None and most is not None:
            assert least - 1e-12 <= p <= most + 1e-12
    (alone,) = compute_sign_flip_p_values(own[:1])
    assert alone == pytest.approx(plain[0])
    strongest = min(range(5), key=lambda place: found[place] or 2.0)
    flips = np.array(list(product([-1.0, 1.0], repeat=people)))
    largest = np.max([_standardised(test, flips) for test in given], axis=0)
    observed = _standardised(given[strongest], np.ones((1, people)))[0]
    assert found[strongest] == pytest.approx(np.mean(largest >= observed - 1e-9))


def _standardised(test: np.ndarray, flips: np.ndarray) -> np.ndarray:
    sizes = np.abs(test)
    used = sizes > 0
    ranks = np.zeros(len(test))
    ranks[used] = [np.sum(sizes[used] < each) + (np.sum(sizes[used] == each) + 1) / 2 for each in sizes[used]]
    return np.abs(flips @ (ranks * np.sign(test))) / np.sqrt(np.sum(ranks**2))


def test_a_test_that_some_participants_lack_is_corrected_with_the_others() -> None:
    whole = {str(person): float(person + 1) for person in range(8)}
    part = {person: value for person, value in whole.items() if person not in "07"}
    assert compute_sign_flip_p_values([whole, part, {}]) == [
        pytest.approx(2 / 2**8),
        pytest.approx(2 / 2**6),
        None,
    ]


def test_many_participants_are_corrected_by_drawn_signs_always_alike() -> None:
    own = [{str(person): float(np.sin(test + person)) + 0.3 for person in range(30)} for test in range(3)]
    first, second = compute_sign_flip_p_values(own), compute_sign_flip_p_values(own)
    assert first == second
    for p, test in zip(first, own, strict=True):
        assert p is not None
        assert p >= 0.5 * (run_signed_rank_test(list(test.values())).p or 0.0)


@pytest.mark.parametrize(
    ("studies", "least", "most"), [(60, 0.0, 0.15), pytest.param(400, 0.025, 0.075, marks=pytest.mark.slow)]
)
def test_studies_without_an_effect_seldom_have_any_star(studies: int, least: float, most: float) -> None:
    found = [any_star(rows(effect=0.0, number=number)) for number in range(studies)]
    assert least <= np.mean(found) <= most


def test_a_large_effect_is_starred() -> None:
    first = [each for each in rows(effect=3.0) if each.quantity == "L1" and each.role == "primary"]
    assert any(each.stars for each in first)


# Few participants


@pytest.mark.parametrize("people", [1, 2, 3])
def test_fewer_than_four_participants_are_described_and_not_tested(people: int) -> None:
    tests = rows(effect=3.0, people=people)
    assert all((each.p, each.p_holm, each.p_primary, each.statistic) == (None,) * 4 for each in tests)
    assert not any(each.stars or each.method or each.effect_low is not None for each in tests)
    assert {each.note for each in tests} <= {"fewer than 4 participants", "all differences are zero"}
    assert any(each.effect is not None for each in tests)
    page = render_hypothesis_test_table("Tests", tests, simulated=True)
    assert "0.0" not in "".join(part.partition("</td>")[0] for part in page.split("<td>")[4:8])


# The paper's analysis

BY_TRIAL = [
    ("L1", "original", 44, 20, 124.0, 1.2878582538178307e-06, 1.2878582538178307e-06, 0.7494949494949495),
    ("L1", "revised", 58, 6, 80.5, 1.0558431430767377e-09, 2.1116862861534753e-09, 0.9059029807130333),
    ("L1", "revised", 50, 14, 239.0, 3.91532389141247e-05, 0.0001566129556564988, 0.6250980392156863),
    ("L2", "revised", 52, 12, 343.5, 0.0012403708580504813, 0.0024807417161009627, 0.5014513788098693),
    ("L3", "revised", 54, 10, 511.0, 0.03986150020394941, 0.03986150020394941, 0.3117845117845118),
    ("L4", "revised", 50, 14, 278.0, 0.0002867966763240304, 0.0008603900289720912, 0.563921568627451),
]
"""The paper's tests of an imagined study: quantity, group, n, zeros, W, p, p by Holm, effect."""


def test_the_papers_tests_by_trial_have_the_same_numbers() -> None:
    found = [each for each in rows() if each.unit == TRIAL_UNIT]
    assert [(each.quantity, each.group_a, each.n, each.zeros) for each in found] == [
        each[:4] for each in BY_TRIAL
    ]
    numbers = [(each.statistic, each.p, each.p_holm, each.effect) for each in found]
    assert np.allclose(np.array(numbers, float), [each[4:] for each in BY_TRIAL], rtol=1e-12, atol=0)


# Intervals


def test_equal_values_have_no_interval() -> None:
    assert compute_t_interval(5.0, 0.0, 8) == (None, None)
    for value in (5.0, 0.1, -1e9, 1 / 3):
        assert compute_mean_with_interval([value] * 8) == (pytest.approx(value), None, None)
    _, low, high = compute_mean_with_interval([5.0, 5.1])
    assert low is not None
    assert high is not None
    assert low < high


@pytest.mark.parametrize("people", [4, 8, 20])
def test_effect_sizes_have_an_interval_of_some_width_everywhere(
    people: int, rng: np.random.Generator
) -> None:
    """With every difference above zero, too: Fisher's z would be from 1 to 1."""
    for differences in (np.arange(1.0, people + 1), np.ones(people), rng.normal(0.3, 1.0, people)):
        found = run_signed_rank_test(differences)
        assert found.effect_size is not None
        assert found.effect_size_low is not None
        assert found.effect_size_high is not None
        assert -1.0 <= found.effect_size_low <= found.effect_size <= found.effect_size_high <= 1.0
        assert found.effect_size_high - found.effect_size_low > 0.1
    apart = run_rank_sum_test(np.arange(people), np.arange(100) + 200.0)
    assert apart.effect_size == -1.0
    assert apart.effect_size_high is not None
    assert -1.0 < apart.effect_size_high < 0.9


@pytest.mark.parametrize("shift", [0.0, 0.8, 1.5])
def test_the_interval_of_an_effect_covers_it(shift: float, rng: np.random.Generator) -> None:
    truth = run_signed_rank_test(rng.normal(shift, 1.0, 20_000)).effect_size
    found = [run_signed_rank_test(rng.normal(shift, 1.0, 8)) for _ in range(600)]
    covered = [
        (each.effect_size_low or -1.0) <= (truth or 0.0) <= (each.effect_size_high or 1.0) for each in found
    ]
    assert 0.91 <= np.mean(covered) <= 0.99


def test_effects_by_trial_have_no_interval() -> None:
    assert all(each.effect_low is None for each in rows() if each.unit == TRIAL_UNIT)
    assert all(each.effect_low is not None for each in rows() if each.unit != TRIAL_UNIT and each.effect)


# Singular models


def test_an_effect_without_a_variance_of_its_own_is_said_to_be_unreliable() -> None:
    """Policies differ far more between trials of a participant than between participants."""
    rng = np.random.default_rng(0)
    seen: list[TrialValue] = []
    for person, task, robot in product(range(8), DESIGN.tasks, DESIGN.robots):
        sign = 1.0 if (DESIGN.tasks.index(task) + DESIGN.robots.index(robot)) % 2 else -1.0
        for policy, side in zip(DESIGN.policies, (sign, -sign), strict=True):
            value = side + 0.3 * rng.normal()
            seen.append(TrialValue(f"sub-{person:03}", task, robot, policy, 0.5, 0.5, None, value))
    found = estimate_effects(DESIGN, MIXED_MODEL, seen, list_effects_of_interest(DESIGN))
    notes = {effect.kind: each.note for effect, each in found.items() if isinstance(each, EffectEstimate)}
    assert notes["policies"].startswith("singular: random effect at zero: ")
    assert "participant by policy" in notes["policies"]
    assert notes["policies"].endswith(UNRELIABLE_P_NOTE)
    differing = [
        replace(
            each,
            value=each.value + 3.0 * float(np.sin(int(each.participant[-3:]))) * (each.policy == "revised"),
        )
        for each in seen
    ]
    found = estimate_effects(DESIGN, MIXED_MODEL, differing, list_effects_of_interest(DESIGN))
    (policies,) = (each for effect, each in found.items() if effect.kind == "policies")
    assert isinstance(policies, EffectEstimate)
    assert UNRELIABLE_P_NOTE not in policies.note
