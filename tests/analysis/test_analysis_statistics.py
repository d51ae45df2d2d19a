"""Tests and intervals of the analysis: published examples, SciPy's results, and error rates."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

from avrgym.analysis.answers.session_answers import (
    AFTER_SESSION,
    BEFORE_SESSION,
    CHANGE_LABEL,
    compare_before_after,
    find_values_at_moment,
)
from avrgym.analysis.statistics.comparisons import MEAN_DECIMALS
from avrgym.analysis.statistics.rank_tests import (
    MAX_EXACT_SIGNED_RANK_N,
    apply_holm_correction,
    compute_clustered_wilson_interval,
    compute_t_interval,
    format_significance_stars,
    run_energy_test,
    run_rank_sum_test,
    run_signed_rank_test,
)
from avrgym.learning.evaluation import compute_wilson_interval

scipy_stats: Any = stats  # whose types no checker follows
EVERY = scipy_stats.PermutationMethod(n_resamples=np.inf)
"""Has SciPy go through all permutations, which is exact with ties too."""


# Published examples


def test_signed_rank_of_darwins_maize() -> None:
    """Darwin's 15 pairs of crossed and self-fertilised maize, in eighths of an inch (Fisher 1935, The Design of
    Experiments, section 17): the negative differences have ranks 14 and 10; SciPy documents p = 0.041259765625.
    """
    found = run_signed_rank_test([49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48])
    assert (found.sample_size, found.statistic, found.method) == (15, 24.0, "exact")
    assert found.p == 0.041259765625
    assert found.effect_size == pytest.approx((96 - 24) / 120)


def test_signed_rank_of_the_depression_scale() -> None:
    """Hamilton's depression scale of nine patients before and after tranquilliser therapy (Hollander and Wolfe 1973,
    Nonparametric Statistical Methods, pages 29 to 33): T+ = 40, one-sided p = 0.0195 (10 of 512 choices of signs).
    """
    before = [1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30]
    after = [0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29]
    found = run_signed_rank_test(np.subtract(before, after))
    assert found.statistic == 45 - 40
    assert found.p == 2 * 10 / 512


def test_rank_sum_of_the_chorioamnion() -> None:
    """Permeability of the human chorioamnion at term and at 12 to 26 weeks (Hollander and Wolfe 1973, page 69): in R's
    documentation W = 35 and one-sided p = 0.1272.
    """
    term = [0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46]
    earlier = [1.15, 0.88, 0.90, 0.74, 1.21]
    found = run_rank_sum_test(term, earlier)
    assert (found.sample_size, found.statistic, found.method) == (15, 35.0, "exact")
    assert found.p == pytest.approx(2 * 0.1272, abs=1e-4)
    assert found.effect_size == pytest.approx(2 * 35 / 50 - 1)


def test_holm_of_fifteen_endpoints() -> None:
    """Fifteen comparisons of two treatments after infarction (Benjamini and Hochberg 1995, J. R. Statist. Soc. B 57,
    section 3): both Bonferroni's procedure and Hochberg's, between which Holm's lies, reject the first three at 0.05.
    """
    published = [
        0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590,
        1.0000,
    ]  # fmt: skip
    adjusted = apply_holm_correction(published)
    assert [p < 0.05 for p in adjusted if p is not None] == [True] * 3 + [False] * 12
    assert adjusted[:4] == pytest.approx([15 * 0.0001, 14 * 0.0004, 13 * 0.0019, 12 * 0.0095])


def test_wilson_of_published_shares() -> None:
    """Newcombe 1998 (Statistics in Medicine 17, table I, method 3)."""
    assert compute_wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert compute_wilson_interval(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert compute_wilson_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("spread_logit", [0.0, 1.0, 2.0])
def test_clustered_interval_covers_the_success_rate_of_people_who_differ(
    spread_logit: float, rng: np.random.Generator
) -> None:
    """Studies of eight participants with four trials each, half of which succeed on average."""
    people = rng.normal(0.0, spread_logit, (STUDIES, 8, 1))
    success = rng.random((STUDIES, 8, 4)) < 1.0 / (1.0 + np.exp(-people))
    intervals = np.array([compute_clustered_wilson_interval(study) for study in success.tolist()])
    covered = (intervals[:, 0] <= 0.5) & (intervals[:, 1] >= 0.5)
    assert 0.94 <= covered.mean() <= 0.975
    pooled = np.array([compute_wilson_interval(each, 32) for each in success.sum(axis=(1, 2)).tolist()])
    ignored = float(((pooled[:, 0] <= 0.5) & (pooled[:, 1] >= 0.5)).mean())
    assert (ignored < 0.9) == (spread_logit > 0.0)


STUDIES = 4000


def test_clustered_interval_of_single_trials_is_wilsons() -> None:
    assert compute_clustered_wilson_interval([[True], [False], [True]]) == compute_wilson_interval(2, 3)
    assert compute_clustered_wilson_interval([[True]]) == compute_wilson_interval(1, 1)


def test_one_participant_of_several_trials_has_no_interval() -> None:
    assert compute_clustered_wilson_interval([[True, False, True]]) == (None, None)


def test_clustered_interval_is_within_0_and_1_and_contains_the_proportion(rng: np.random.Generator) -> None:
    for _ in range(300):
        sizes = rng.integers(1, 5, rng.integers(2, 9))
        clusters = [(rng.random(size) < rng.choice([0.0, 0.1, 0.5, 1.0])).tolist() for size in sizes]
        low, high = compute_clustered_wilson_interval(clusters)
        assert low is not None
        assert high is not None
        assert 0.0 <= low <= np.mean(np.concatenate(clusters)) <= high <= 1.0


# SciPy's figures


@pytest.mark.parametrize("n", [5, 7, 9])
def test_exact_signed_ranks_with_ties_and_zeros_equal_scipy(n: int, rng: np.random.Generator) -> None:
    for _ in range(3):
        differences = rng.integers(-3, 4, n)
        found, used = run_signed_rank_test(differences), differences[differences != 0]
        assert (found.sample_size, found.zero_differences) == (len(used), n - len(used))
        assert found.p == pytest.approx(scipy_stats.wilcoxon(used, method=EVERY).pvalue, abs=1e-12)


def test_signed_ranks_equal_scipy_without_ties_and_in_large_samples(rng: np.random.Generator) -> None:
    for n in (8, 30, MAX_EXACT_SIGNED_RANK_N):
        values = rng.normal(0.2, 1.0, n)
        found, expected = run_signed_rank_test(values), scipy_stats.wilcoxon(values, method="exact")
        assert (found.statistic, found.p) == pytest.approx((expected.statistic, expected.pvalue), abs=1e-12)
    answers = rng.integers(1, 8, 200) - 4
    found, expected = run_signed_rank_test(answers), scipy_stats.wilcoxon(answers, method="asymptotic")
    assert found.method == "normal approximation"
    assert (found.statistic, found.p) == pytest.approx((expected.statistic, expected.pvalue), abs=1e-12)


@pytest.mark.parametrize(("n", "m"), [(3, 7), (5, 4), (9, 3)])
def test_exact_rank_sums_with_ties_equal_scipy(n: int, m: int, rng: np.random.Generator) -> None:
    for _ in range(3):
        a, b = rng.integers(0, 5, n), rng.integers(1, 6, m)
        assert run_rank_sum_test(a, b).p == pytest.approx(
            scipy_stats.mannwhitneyu(a, b, method=EVERY).pvalue, abs=1e-12
        )


def test_large_rank_sums_equal_scipy(rng: np.random.Generator) -> None:
    a, b = rng.integers(0, 5, 40), rng.integers(1, 6, 60)
    assert run_rank_sum_test(a, b).p == pytest.approx(
        scipy_stats.mannwhitneyu(a, b, method="asymptotic").pvalue, abs=1e-12
    )


def test_energy_distances_on_a_line_equal_scipy(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=20), rng.normal(0.5, 1.0, 30)
    found = run_energy_test(a[:, None], b[:, None], 0, permutations=9)
    assert found.statistic == pytest.approx(stats.energy_distance(a, b) ** 2, abs=1e-12)


def test_t_intervals_equal_scipy(rng: np.random.Generator) -> None:
    values = rng.normal(size=8)
    expected = stats.ttest_1samp(values, 0.0).confidence_interval()
    assert compute_t_interval(values.mean(), values.std(ddof=1), 8) == pytest.approx(
        tuple(expected), abs=1e-12
    )


# Laws


def test_turning_the_samples_round_turns_only_the_effect(rng: np.random.Generator) -> None:
    a, b = rng.integers(1, 8, 7), rng.integers(1, 8, 40)
    assert run_signed_rank_test(a - 4).p == run_signed_rank_test(4 - a).p
    assert run_signed_rank_test(a - 4).effect_size == -(run_signed_rank_test(4 - a).effect_size or 0.0)
    assert run_rank_sum_test(a, b).p == pytest.approx(run_rank_sum_test(b, a).p, abs=1e-12)
    assert run_rank_sum_test(a, b).effect_size == pytest.approx(-(run_rank_sum_test(b, a).effect_size or 0.0))


def test_the_energy_test_finds_another_place_and_another_spread(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(15, 3)), rng.normal(size=(60, 3))
    assert (run_energy_test(a, b, 1, 999).p or 0.0) > 0.05
    assert (run_energy_test(a + np.array([0.0, 1.5, 0.0]), b, 1, 999).p or 1.0) < 0.01
    assert (run_energy_test(0.2 * a, b, 1, 999).p or 1.0) < 0.05
    assert run_energy_test(a, b, 1, 999) == run_energy_test(a, b, 1, 999)


def test_changes_of_equal_size_have_equal_ranks_whatever_a_scale_counts_in(rng: np.random.Generator) -> None:
    steps = {moment: rng.integers(0, 12, 20).tolist() for moment in (BEFORE_SESSION, AFTER_SESSION)}

    def change(factor: float) -> tuple[float | None, int, list[float]]:
        given = {
            (moment, "total"): {
                f"sub-{number:03}": round(factor * step, MEAN_DECIMALS) for number, step in enumerate(each)
            }
            for moment, each in steps.items()
        }
        found = compare_before_after("total", given).result
        return found.p, found.zero_differences, find_values_at_moment(CHANGE_LABEL, "total", given)

    p, zeros, values = change(1.0)
    assert change(3.74) == (p, zeros, pytest.approx([3.74 * value for value in values], abs=1e-12))
    assert len(set(change(3.74)[2])) == len(set(values))


def test_holm_keeps_the_order_and_leaves_out_what_was_not_tested() -> None:
    assert apply_holm_correction([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert apply_holm_correction([0.04, None, 0.9]) == [0.08, None, 0.9]
    assert apply_holm_correction([]) == []
    assert [format_significance_stars(p) for p in (0.0005, 0.005, 0.03, 0.05, None)] == [
        "***",
        "**",
        "*",
        "",
        "",
    ]


@pytest.mark.parametrize(
    ("found", "why"),
    [
        (run_signed_rank_test([0, 0, 0]), "all differences are zero"),
        (run_signed_rank_test([]), "there are no values to compare"),
        (run_rank_sum_test([1, 1], [1, 1, 1]), "all values are equal"),
        (run_rank_sum_test([], [1]), "there are no values to compare"),
        (run_energy_test([[1, 2]], [[1, 2]], 0), "all values are equal"),
        (run_energy_test(np.zeros((0, 2)), [[1, 2]], 0), "there are no values to compare"),
    ],
)
def test_what_cannot_be_tested_says_why(found, why: str) -> None:
    assert (found.p, found.effect_size, found.note) == (None, None, why)


def test_one_value_has_no_interval() -> None:
    assert compute_t_interval(3.0, 0.0, 1) == (None, None)


# How often they err


@pytest.mark.slow
def test_without_an_effect_about_one_in_twenty_is_significant(rng: np.random.Generator) -> None:
    """1,000 studies of 8 participants with 4 tasks and 2 robots: answers from 1 to 7, by chance."""
    original, revised = rng.integers(1, 8, (2, 1000, 64))
    against_middle = np.array([run_signed_rank_test(study - 4).p for study in original])
    between = np.array([run_signed_rank_test(study).p for study in revised - original])
    assert 0.035 < np.mean(against_middle < 0.05) < 0.065
    assert 0.035 < np.mean(between < 0.05) < 0.065


def test_people_who_differ_in_general_do_not_make_policies_differ(rng: np.random.Generator) -> None:
    """The same, where participants share their trials' mood: pairs within a participant cancel it."""
    mood = np.repeat(rng.normal(0.0, 1.5, (500, 8, 1)), 8, axis=2).reshape(500, 64)
    original, revised = (np.clip(np.round(4 + mood + rng.normal(0, 1, mood.shape)), 1, 7) for _ in range(2))
    between = np.array([run_signed_rank_test(study).p for study in revised - original])
    assert np.mean(between < 0.05) < 0.075


def test_a_large_effect_is_found_in_most_studies(rng: np.random.Generator) -> None:
    """Answers one and a half points higher, in 200 studies."""
    original = np.clip(np.round(rng.normal(3.0, 1.5, (200, 64))), 1, 7)
    revised = np.clip(np.round(rng.normal(4.5, 1.5, (200, 64))), 1, 7)
    assert np.mean([(run_signed_rank_test(study).p or 1.0) < 0.05 for study in revised - original]) > 0.95
