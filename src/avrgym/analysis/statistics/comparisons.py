"""Comparisons of two groups, and families of tests that are corrected together for multiple testing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import Annotated

import numpy as np

from avrgym.analysis import column_types
from avrgym.analysis.column_types import (
    AT_LEAST_0_TEXT,
    NOT_TESTED_TEXT,
    EffectSize,
    EffectSizeHigh,
    EffectSizeLow,
    GroupAName,
    GroupBName,
    HolmCorrectedPValue,
    IsSimulated,
    MedianA,
    MedianB,
    Note,
    PlanStatus,
    PrimaryCorrectedPValue,
    PValue,
    QuantityName,
    ResultRole,
    SignificanceStars,
    ZeroDifferenceCount,
)
from avrgym.analysis.statistics.rank_tests import (
    StatisticalTestResult,
    apply_holm_correction,
    run_signed_rank_test,
)
from avrgym.system.columns import Column


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """A test of ``group_a`` against ``group_b``.

    With fewer than ``MIN_PARTICIPANTS`` participants, the row contains medians, but no p value.
    """

    simulated: IsSimulated
    family: column_types.FamilyName
    quantity: QuantityName
    unit: Annotated[str, Column("Unit of analysis: each value is of a trial, or of a participant.")]
    group_a: GroupAName
    group_b: GroupBName
    test: Annotated[str, Column("Name of the test.")]
    n_a: Annotated[int, Column("Number of values of the first group.", allowed=AT_LEAST_0_TEXT)]
    n_b: Annotated[int, Column("Number of values of the second group.", allowed=AT_LEAST_0_TEXT)]
    n: Annotated[int, Column("Number of values or differences in the test.", allowed=AT_LEAST_0_TEXT)]
    zeros: ZeroDifferenceCount
    median_a: MedianA
    median_b: MedianB
    statistic: Annotated[float | None, Column("Test statistic.", empty=NOT_TESTED_TEXT)]
    method: Annotated[str, Column("How p was computed.", empty=NOT_TESTED_TEXT)]
    p: PValue
    p_holm: HolmCorrectedPValue
    p_primary: PrimaryCorrectedPValue = None
    stars: SignificanceStars = ""
    effect: EffectSize
    effect_low: EffectSizeLow
    effect_high: EffectSizeHigh
    note: Note
    role: ResultRole = ""
    plan_status: PlanStatus = ""


TRIAL_UNIT, PARTICIPANT_UNIT = "trial", "participant"
"""Units of analysis. Trials of one participant are not independent. Tests by trial therefore have no significance
stars. They serve only as a comparison with the paper."""
PRIMARY_ROLE, SENSITIVITY_ANALYSIS_ROLE, SECONDARY_ROLE, SUPPLEMENT_ROLE = (
    "primary",
    "sensitivity analysis",
    "secondary",
    "supplement",
)
"""Roles of results in the analysis."""
MIN_PARTICIPANTS = 4
"""Minimum number of participants for a test or a model."""
TOO_FEW_PARTICIPANTS_TEXT = f"fewer than {MIN_PARTICIPANTS} participants"
GroupValues = tuple[str, Sequence[float]]
"""A group of a comparison: (name of the group, its values)."""


@dataclass(frozen=True)
class ResearchQuestion:
    """A research question with a family of tests.

    ``table_caption``: caption of the table of tests in the report. ``is_primary``: whether the tests by participant of
    this question are primary results without a plan.
    """

    name: str
    table_caption: str
    is_primary: bool = False

    def make_family_name(self, unit: str) -> str:
        """Returns the name of the family of tests with this unit of analysis (trial or participant)."""
        return f"{self.name}, by {unit}"


@dataclass(frozen=True)
class Comparison:
    """Comparison of a quantity between groups ``group_a`` and ``group_b``.

    ``result``: the test result. ``participant_count``: number of participants. ``participant_differences``: for a
    paired test by participant, the difference of each participant; otherwise empty.
    """

    quantity: str
    group_a: GroupValues
    group_b: GroupValues
    result: StatisticalTestResult
    participant_count: int
    participant_differences: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True)
class ComparisonFamily:
    """Tests that are corrected together for multiple testing.

    ``participant_differences``: for each test, the differences by participant.
    """

    is_simulated: bool
    question: ResearchQuestion
    rows: tuple[ComparisonRow, ...]
    participant_differences: tuple[Mapping[str, float], ...]


def make_holm_corrected_family(
    simulated: bool, question: ResearchQuestion, unit: str, tests: Sequence[Comparison]
) -> ComparisonFamily:
    """Returns the family of tests of one question and unit of analysis, with Holm's correction."""
    allowed = [_without_small_test(test) for test in tests]
    adjusted = apply_holm_correction([test.result.p for test in allowed])
    name = question.make_family_name(unit)
    rows = [_row(simulated, name, unit, test, p) for test, p in zip(allowed, adjusted, strict=True)]
    return ComparisonFamily(
        simulated, question, tuple(rows), tuple(test.participant_differences for test in allowed)
    )


def _without_small_test(test: Comparison) -> Comparison:
    """Returns the comparison.

    With fewer than ``MIN_PARTICIPANTS`` participants, statistic, p value and confidence interval are removed.
    """
    if test.participant_count >= MIN_PARTICIPANTS:
        return test
    result = test.result
    note = TOO_FEW_PARTICIPANTS_TEXT if result.p is not None else result.note
    described = StatisticalTestResult(
        result.test_name,
        result.sample_size,
        result.zero_differences,
        effect_size=result.effect_size,
        note=note,
    )
    return replace(test, result=described)


def _row(simulated: bool, family: str, unit: str, test: Comparison, p_holm: float | None) -> ComparisonRow:
    result = test.result
    return ComparisonRow(
        simulated=simulated,
        family=family,
        quantity=test.quantity,
        unit=unit,
        group_a=test.group_a[0],
        group_b=test.group_b[0],
        test=result.test_name,
        n_a=len(test.group_a[1]),
        n_b=len(test.group_b[1]),
        n=result.sample_size,
        zeros=result.zero_differences,
        median_a=_median(test.group_a[1]),
        median_b=_median(test.group_b[1]),
        statistic=result.statistic,
        method=result.method,
        p=result.p,
        p_holm=p_holm,
        effect=result.effect_size,
        effect_low=result.effect_size_low if unit == PARTICIPANT_UNIT else None,
        effect_high=result.effect_size_high if unit == PARTICIPANT_UNIT else None,
        note=result.note,
    )


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) and np.ndim(values) == 1 else None


MEAN_DECIMALS = 9
"""Number of decimals of means over trials. Rounding removes differences due to floating-point errors."""
AnalysisUnitKey = tuple[str, ...]
"""Key of a value: (participant, task, robot) for trials, (participant,) for means of participants."""


def compare_policies(
    name: str,
    policies: tuple[str, str],
    values: tuple[Mapping[AnalysisUnitKey, float], Mapping[AnalysisUnitKey, float]],
    unit: str,
) -> Comparison:
    """Returns a signed-rank test of the second policy against the first policy.

    ``values``: values with the first policy, and values with the second policy, by ``AnalysisUnitKey``.
    """
    first, second = policies
    a, b = values
    pairs = [key for key in a if key in b]
    before = average_by_analysis_unit(unit, {key: a[key] for key in pairs})
    after = average_by_analysis_unit(unit, {key: b[key] for key in pairs})
    x, y = list(after.values()), list(before.values())
    apart = np.round(np.subtract(x, y), MEAN_DECIMALS)
    differences = dict(zip(after, apart.tolist(), strict=True))
    return Comparison(
        name,
        (second, x),
        (first, y),
        run_signed_rank_test(apart),
        *summarise_participant_differences(unit, differences),
    )


def average_by_analysis_unit(
    unit: str, values: Mapping[AnalysisUnitKey, float]
) -> dict[AnalysisUnitKey, float]:
    """Returns the values of trials if ``unit`` is ``TRIAL_UNIT``; otherwise the mean over the trials of each
    participant.
    """
    if unit == TRIAL_UNIT:
        return {key: float(value) for key, value in values.items()}
    own: dict[AnalysisUnitKey, list[float]] = {}
    for key, value in values.items():
        own.setdefault(key[:1], []).append(value)
    return {key: round(fmean(values), MEAN_DECIMALS) for key, values in own.items()}


def summarise_participant_differences(
    unit: str, differences: Mapping[AnalysisUnitKey, float]
) -> tuple[int, dict[str, float]]:
    """Returns the number of participants, and the difference of each participant (empty for a test by trial)."""
    participants = len({key[0] for key in differences})
    if unit == TRIAL_UNIT:
        return participants, {}
    return participants, {key[0]: value for key, value in differences.items()}
