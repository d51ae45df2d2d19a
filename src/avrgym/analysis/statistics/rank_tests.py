"""Rank tests, corrections for multiple testing, and confidence intervals. All tests are two-sided.

SciPy computes exact p values without ties, and normal approximations. This module implements exact p values with ties,
rank-biserial effect sizes, Holm's correction and the multivariate energy test.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import fmean
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats
from scipy.spatial.distance import cdist

from avrgym.array_types import FloatArray, IntArray
from avrgym.learning.evaluation import compute_wilson_interval
from avrgym.system import random_streams

MAX_EXACT_SIGNED_RANK_N = 50
"""Maximum number of differences for an exact signed-rank test. Counts up to 2**50 are exact as floats."""
MAX_EXACT_RANK_SUM_N = 8
"""Maximum size of the smaller sample for an exact rank-sum test."""
PERMUTATION_COUNT = 9_999
MANN_WHITNEY_TEST_NAME = "Mann-Whitney"
_DISTANCES_IN_MEMORY = 1_000_000
STAR_THRESHOLDS = ((0.001, "***"), (0.01, "**"), (0.05, "*"))


def compute_summary_statistics(values: Sequence[float]) -> dict[str, Any]:
    """Returns count, mean, minimum, maximum and quartiles of values, by column name.

    Quartiles are interpolated linearly.
    """
    lower, median, upper = np.percentile(values, [25, 50, 75])
    return {
        "n": len(values),
        "mean": fmean(values),
        "minimum": min(values),
        "lower_quartile": float(lower),
        "median": float(median),
        "upper_quartile": float(upper),
        "maximum": max(values),
    }


@dataclass(frozen=True)
class StatisticalTestResult:
    """Result of a statistical test.

    ``test_name``: name of the test. ``sample_size``: number of values or differences. ``zero_differences``: number of
    omitted zero differences. ``method``: method of the p value. ``p``: p value; ``None`` if no test was possible;
    ``note`` then contains the reason. ``effect_size``: rank-biserial correlation in [−1, 1], with 95 % confidence
    interval. For the energy test, ``effect_size`` is the energy distance divided by twice the mean distance between
    samples (0 to 1), without interval.
    """

    test_name: str
    sample_size: int
    zero_differences: int = 0
    statistic: float | None = None
    method: str = ""
    p: float | None = None
    effect_size: float | None = None
    effect_size_low: float | None = None
    effect_size_high: float | None = None
    note: str = ""


def run_signed_rank_test(differences: ArrayLike) -> StatisticalTestResult:
    """Returns Wilcoxon's signed-rank test (Biometrics Bulletin 1, 1945).

    Null hypothesis: the differences are symmetric around zero.

    Zero differences are omitted, as in Wilcoxon's paper. Ties have their mean rank. For at most
    ``MAX_EXACT_SIGNED_RANK_N`` differences, the p value is exact: all combinations of signs are equally probable. For
    more differences, the p value is SciPy's normal approximation with tie correction, without continuity correction.
    The statistic is the smaller rank sum; the effect size is (W₊ − W₋) / (W₊ + W₋).
    """
    given = np.asarray(differences, float)
    used = given[given != 0.0]
    zeros = len(given) - len(used)
    test = "Wilcoxon signed-rank"
    if not len(used):
        note = "all differences are zero" if zeros else "there are no values to compare"
        return StatisticalTestResult(test, 0, zeros, note=note)
    ranks = stats.rankdata(np.abs(used))
    positive, negative = float(ranks[used > 0].sum()), float(ranks[used < 0].sum())
    if len(used) <= MAX_EXACT_SIGNED_RANK_N:
        method, p = "exact", _exact_signed_rank(ranks, min(positive, negative))
    else:
        found: Any = stats.wilcoxon(used, method="asymptotic")
        method, p = "normal approximation", float(found.pvalue)
    effect = (positive - negative) / (positive + negative)
    interval = compute_rank_biserial_interval(effect, float(ranks.sum() ** 2 / (ranks @ ranks)))
    return StatisticalTestResult(
        test, len(used), zeros, min(positive, negative), method, p, effect, *interval
    )


def _exact_signed_rank(ranks: FloatArray, smaller: float) -> float:
    """Returns the exact p value: twice the share of sign combinations with a positive rank sum of at most ``smaller``.

    ``ways[s]``: number of sign combinations of the previous ranks with doubled sum s. Doubled mean ranks are integers.
    """
    doubled = np.rint(2.0 * ranks).astype(int)
    ways = np.zeros(doubled.sum() + 1)
    ways[0] = 1.0
    for rank in doubled:
        ways[rank:] += ways[:-rank].copy()
    share = ways[: round(2.0 * smaller) + 1].sum() / 2.0 ** len(ranks)
    return min(1.0, 2.0 * float(share))


def run_rank_sum_test(a: ArrayLike, b: ArrayLike) -> StatisticalTestResult:
    """Returns the Mann-Whitney U test (Ann. Math. Stat. 18, 1947). Null hypothesis: both samples have the same
    distribution.

    The p value is exact if the smaller sample has at most ``MAX_EXACT_RANK_SUM_N`` values. All divisions of the ranks
    into two samples are then equally probable, and ties have their mean rank. Without ties, SciPy computes the exact p
    value. Otherwise the p value is SciPy's normal approximation with tie and continuity correction. The statistic is U
    of ``a``. The effect size 2 U / (n m) − 1 is positive if the values of ``a`` are larger.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    test, n = MANN_WHITNEY_TEST_NAME, len(a) + len(b)
    if not len(a) or not len(b):
        return StatisticalTestResult(test, n, note="there are no values to compare")
    pooled = np.concatenate([a, b])
    if np.ptp(pooled) == 0.0:
        return StatisticalTestResult(test, n, note="all values are equal")
    exact, ties = min(len(a), len(b)) <= MAX_EXACT_RANK_SUM_N, len(np.unique(pooled)) < n
    found = stats.mannwhitneyu(a, b, method="exact" if exact and not ties else "asymptotic")
    p = _exact_rank_sum(a, b) if exact and ties else float(found.pvalue)
    effect = 2.0 * float(found.statistic) / (len(a) * len(b)) - 1.0
    method = "exact" if exact else "normal approximation"
    interval = compute_rank_biserial_interval(effect, _size_of_rank_sum(len(a), len(b), pooled))
    return StatisticalTestResult(test, n, 0, float(found.statistic), method, p, effect, *interval)


def _size_of_rank_sum(n: int, m: int, pooled: FloatArray) -> float:
    """Returns the effective sample size of U (see ``compute_rank_biserial_interval``). ``n``, ``m``: sizes of the
    samples.
    """
    _, times = np.unique(pooled, return_counts=True)
    tied = 1.0 - float((times**3 - times).sum()) / (len(pooled) ** 3 - len(pooled))
    return 3.0 * n * m / ((n + m + 1) * tied)


def compute_rank_biserial_interval(effect: float, size: float) -> tuple[float, float]:
    """Returns the 95 % confidence interval of a rank-biserial correlation r: Wilson's interval of (1 + r) / 2.

    ``size``: effective sample size. Under the null hypothesis, the share of this number of independent binary values
    has the variance of (1 + r) / 2. For signed ranks, ``size`` is (sum of ranks)² / (sum of squared ranks). Unlike an
    interval by Fisher's z, this interval is defined at r = ±1.
    """
    low, high = compute_wilson_interval(size * (1.0 + effect) / 2.0, size)
    return 2.0 * low - 1.0, 2.0 * high - 1.0


def _exact_rank_sum(a: FloatArray, b: FloatArray) -> float:
    """Returns the exact p value: twice the share of rank subsets with the observed or a more extreme rank sum.

    Subsets have the size of the smaller sample. ``ways[k, s]``: number of subsets of k ranks with doubled sum s.
    """
    smaller, larger = sorted((a, b), key=len)
    doubled = np.rint(2.0 * stats.rankdata(np.concatenate([smaller, larger]))).astype(int)
    count = len(smaller)
    ways = np.zeros((count + 1, np.sort(doubled)[-count:].sum() + 1))
    ways[0, 0] = 1.0
    for rank in doubled:
        ways[1:, rank:] += ways[:-1, :-rank].copy()
    observed, total = doubled[:count].sum(), ways[count].sum()
    tails = ways[count, : observed + 1].sum(), ways[count, observed:].sum()
    return min(1.0, 2.0 * float(min(tails) / total))


def run_energy_test(
    a: ArrayLike, b: ArrayLike, seed: int, permutations: int = PERMUTATION_COUNT
) -> StatisticalTestResult:
    """Returns the energy test. Null hypothesis: points (n, d) and points (m, d) have the same distribution.

    Source: Székely and Rizzo, InterStat 5, 2004. The statistic is the energy distance, in the unit of the points: 2 E|A
    − B| − E|A − A′| − E|B − B′|, with means over all pairs. All points are divided at random into n and m points,
    ``permutations`` times. The p value is the share of divisions with at least the observed energy distance. The
    observed division is included.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    count, total = len(a), len(a) + len(b)
    test = "energy distance"
    if not len(a) or not len(b):
        return StatisticalTestResult(test, total, note="there are no values to compare")
    points = np.concatenate([a, b])
    apart = cdist(points, points)
    if not apart.any():
        return StatisticalTestResult(test, total, note="all values are equal")
    given, between = _energy(apart, np.arange(count)[None])
    drawn = _random_divisions(seed, permutations, total, count)
    larger = int((_energy(apart, drawn)[0] >= given[0] - 1e-12).sum())
    p = (1 + larger) / (1 + permutations)
    effect = float(given[0] / (2.0 * between[0])) if between[0] else 0.0
    return StatisticalTestResult(test, total, 0, float(given[0]), f"{permutations} permutations", p, effect)


@lru_cache(maxsize=4)
def _random_divisions(seed: int, divisions: int, total: int, count: int) -> IntArray:
    """Returns random indices (``divisions``, ``count``): for each division, ``count`` of ``total`` points."""
    rng = random_streams.make_permutation_rng(seed)
    return np.stack([rng.permutation(total)[:count] for _ in range(divisions)])


def _energy(apart: FloatArray, chosen: IntArray) -> tuple[FloatArray, FloatArray]:
    """Returns energy distances (k,) and mean distances (k,) between two samples, for k divisions of all points.

    ``apart``: distances between all points. ``chosen`` (k, n): indices of the first sample. All other points are the
    second sample.
    """
    inner = _inner_sums(apart, chosen)
    between = apart.sum(axis=1)[chosen].sum(axis=1) - inner
    outer = apart.sum() - inner - 2.0 * between
    n, m = chosen.shape[1], len(apart) - chosen.shape[1]
    mean = between / (n * m)
    return 2.0 * mean - inner / n**2 - outer / m**2, mean


def _inner_sums(apart: FloatArray, chosen: IntArray) -> FloatArray:
    """Returns the sums (k,) of all distances within k samples. Samples are processed in parts to limit memory."""
    squared = chosen.shape[1] ** 2
    parts = np.array_split(chosen, 1 + len(chosen) * squared // _DISTANCES_IN_MEMORY)
    pairs = ((len(apart) * part[:, :, None] + part[:, None, :]).reshape(len(part), squared) for part in parts)
    return np.concatenate([apart.take(each).sum(axis=1) for each in pairs])


def apply_holm_correction(probabilities: Sequence[float | None]) -> list[float | None]:
    """Returns p values with Holm's correction (Scand. J. Statist. 6, 1979). ``None`` (no test) remains ``None``."""
    present = [i for i, p in enumerate(probabilities) if p is not None]
    ordered = sorted(present, key=lambda i: probabilities[i] or 0.0)
    adjusted: list[float | None] = [None] * len(probabilities)
    largest = 0.0
    for rank, index in enumerate(ordered):
        largest = max(largest, (len(ordered) - rank) * (probabilities[index] or 0.0))
        adjusted[index] = min(1.0, largest)
    return adjusted


def format_significance_stars(p: float | None) -> str:
    """Returns the significance stars of a p value: * below 0.05, ** below 0.01, *** below 0.001."""
    return next((stars for limit, stars in STAR_THRESHOLDS if p is not None and p < limit), "")


def compute_clustered_wilson_interval(
    clusters: Sequence[Sequence[bool]],
) -> tuple[float | None, float | None]:
    """Returns the 95 % confidence interval of the share of successful trials. A cluster: all trials of one participant.

    The result is Wilson's interval with the effective sample size, and Student's quantile for (clusters − 1) degrees of
    freedom (Korn and Graubard, Survey Methodology 24, 1998, p. 193; Kott, Survey Methodology 43, 2017, p. 245). The
    effective sample size is the number of trials divided by the design effect. The design effect is the variance of the
    share, estimated between clusters, divided by its variance for independent trials. With one trial in each cluster,
    the result is Wilson's usual interval. For one cluster with several trials, both bounds are ``None``.
    """
    sizes = np.array([len(each) for each in clusters])
    successes = np.array([sum(each) for each in clusters])
    count, share = int(sizes.sum()), float(successes.sum() / sizes.sum())
    if sizes.max() == 1:
        return compute_wilson_interval(float(successes.sum()), count)
    if len(clusters) < 2:
        return None, None
    quantile = float(stats.t.ppf(0.975, len(clusters) - 1))
    size = count / _design_effect(successes - sizes * share, count, share)
    return compute_wilson_interval(share * size, size, quantile)


MIN_DESIGN_EFFECT = 0.25
"""Lower bound of the design effect. Without this bound, equal shares in few clusters would result in a design effect of
0."""


def _design_effect(residuals: FloatArray, count: int, share: float) -> float:
    """Returns the design effect. ``residuals`` (K,): observed minus expected successes of each cluster.

    The design effect is 1 if all trials have the same result.
    """
    if share in (0.0, 1.0):
        return 1.0
    clusters = len(residuals)
    between = clusters / (clusters - 1) * float(residuals @ residuals) / count**2
    return max(between / (share * (1.0 - share) / count), MIN_DESIGN_EFFECT)


EQUAL_VALUES_TOLERANCE = 1e-12
"""Values are considered equal if their standard deviation is at most this share of their mean."""


def compute_t_interval(mean: float, deviation: float, count: int) -> tuple[float | None, float | None]:
    """Returns the 95 % confidence interval of a mean by Student's t (Biometrika 6, 1908).

    ``deviation``: standard deviation with ``count − 1`` degrees of freedom. With fewer than two values, or with equal
    values, both bounds are ``None``: the values contain no information about the error of the mean.
    """
    if count < 2 or deviation <= EQUAL_VALUES_TOLERANCE * abs(mean):
        return None, None
    half = float(stats.t.ppf(0.975, count - 1)) * deviation / count**0.5
    return mean - half, mean + half
