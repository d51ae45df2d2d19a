"""Comparison of participants with training populations: torso heights, head positions and waist angles.

The paper used this comparison to define the Revised population from the Original population.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from statistics import fmean, median
from typing import Annotated

import numpy as np

from avrgym.analysis.biomechanics.training_populations import (
    AXIS_NAMES,
    HEIGHT_POPULATION_NAMES,
    TRAINING_POPULATIONS,
    PostureName,
    SampledPersonRow,
    collect_training_head_positions,
    find_task_posture,
    read_head_position,
)
from avrgym.analysis.column_types import (
    FRACTION_RANGE_TEXT,
    IsSimulated,
    LowerQuartile,
    Maximum,
    Mean,
    Median,
    Minimum,
    QuantityName,
    UpperQuartile,
    ValueCount,
)
from avrgym.analysis.reading.table_rows import TrialRow
from avrgym.array_types import FloatArray
from avrgym.models.human import SEXES
from avrgym.system.columns import Column


@dataclass(frozen=True, kw_only=True)
class BodyMeasureRow:
    """Distribution of a measure among participants (one value each) or in a training population."""

    simulated: IsSimulated
    quantity: QuantityName
    posture: PostureName
    population: Annotated[str, Column("Participants, or the training population.")]
    n: ValueCount
    mean: Mean
    deviation: Annotated[float | None, Column("Standard deviation.", empty="fewer than two values")]
    minimum: Minimum
    lower_quartile: LowerQuartile
    median: Median
    upper_quartile: UpperQuartile
    maximum: Maximum


@dataclass(frozen=True, kw_only=True)
class BodyMeasureRangeRow:
    """Range of a measure among participants, and the ranges of the same measure in the two training populations."""

    simulated: IsSimulated
    quantity: QuantityName
    n: ValueCount
    minimum: Minimum
    maximum: Maximum
    original_low: Annotated[float, Column("Lower bound in the Original population.")]
    original_high: Annotated[float, Column("Upper bound in the Original population.")]
    original_share: Annotated[
        float, Column("Share of values within these bounds.", allowed=FRACTION_RANGE_TEXT)
    ]
    revised_low: Annotated[float, Column("Lower bound in the Revised population.")]
    revised_high: Annotated[float, Column("Upper bound in the Revised population.")]
    revised_share: Annotated[
        float, Column("Share of values within these bounds.", allowed=FRACTION_RANGE_TEXT)
    ]


@dataclass(frozen=True, eq=False)
class PostureTrials:
    """Analysed trials with recorded body posture, of people or of simulated participants."""

    is_simulated: bool
    trials: tuple[TrialRow, ...]

    def list_postures(self) -> list[str]:
        """Returns the different postures in these trials: ``seated``, ``in bed`` or both."""
        return list(dict.fromkeys(find_task_posture(row.task) for row in self.trials))

    def find_trials_in_posture(self, posture: str) -> list[TrialRow]:
        """Returns the trials in one posture: ``seated`` or ``in bed``."""
        return [row for row in self.trials if find_task_posture(row.task) == posture]


def group_posture_trials(trials: Sequence[TrialRow]) -> list[PostureTrials]:
    """Returns the analysed trials with recorded body posture: of people, then of simulated participants.

    A group without such trials is omitted.
    """
    usable = [row for row in trials if row.counted and row.torso_height_m is not None]
    return [
        PostureTrials(simulated, tuple(row for row in usable if row.simulated is simulated))
        for simulated in sorted({row.simulated for row in usable})
    ]


# Distributions


def make_body_measure_rows(
    groups: Sequence[PostureTrials], people: Sequence[SampledPersonRow]
) -> list[BodyMeasureRow]:
    """Returns the distributions of torso height, and of head position by posture.

    Rows of participants are first, then rows of the training populations.
    """
    rows: list[BodyMeasureRow] = []
    for group in groups:
        own = compute_torso_heights(group)
        rows.append(_distribution(group.is_simulated, "torso_height_m", "any", "participants", own))
        for posture, axis in product(group.list_postures(), range(len(AXIS_NAMES))):
            heads = compute_participant_head_positions(group, posture)[:, axis]
            rows.append(
                _distribution(
                    group.is_simulated, f"head_{AXIS_NAMES[axis]}_m", posture, "participants", heads
                )
            )
    for name in TRAINING_POPULATIONS:
        drawn = [row for row in people if row.population == name]
        values = [row.torso_height_m for row in drawn]
        rows.append(_distribution(True, "torso_height_m", "any", name, values))
        for posture, axis in product(dict.fromkeys(row.posture for row in drawn), range(len(AXIS_NAMES))):
            heads = collect_training_head_positions(drawn, name, posture)[:, axis]
            rows.append(_distribution(True, f"head_{AXIS_NAMES[axis]}_m", posture, name, heads))
    return rows


def compute_torso_heights(group: PostureTrials, sex: str | None = None) -> list[float]:
    """Returns the torso height of each participant in metres: the median over trials.

    ``sex``: only participants of this sex; ``None``: all participants.
    """
    own = [row for row in group.trials if sex in (row.sex, None)]
    return [
        median(float(row.torso_height_m or 0.0) for row in own if row.participant == name)
        for name in dict.fromkeys(row.participant for row in own)
    ]


def compute_participant_head_positions(group: PostureTrials, posture: str) -> FloatArray:
    """Returns the mean head position of each participant over trials in ``posture``: (n, 3), world frame, metres."""
    trials = group.find_trials_in_posture(posture)
    who = dict.fromkeys(row.participant for row in trials)
    own = [np.array([read_head_position(row) for row in trials if row.participant == name]) for name in who]
    return np.array([heads.mean(axis=0) for heads in own])


def _distribution(
    simulated: bool, quantity: str, posture: str, people: str, values: Sequence[float] | FloatArray
) -> BodyMeasureRow:
    minimum, lower, median, upper, maximum = (float(v) for v in np.percentile(values, [0, 25, 50, 75, 100]))
    return BodyMeasureRow(
        simulated=simulated,
        quantity=quantity,
        posture=posture,
        population=people,
        n=len(values),
        mean=float(np.mean(values)),
        deviation=float(np.std(values, ddof=1)) if len(values) > 1 else None,
        minimum=minimum,
        lower_quartile=lower,
        median=median,
        upper_quartile=upper,
        maximum=maximum,
    )


# Ranges


def make_body_measure_range_rows(groups: Sequence[PostureTrials]) -> list[BodyMeasureRangeRow]:
    """Returns the ranges over all participants of torso height (by sex) and of waist angles.

    Each waist angle has two ranges: of its means over trials, and of all its values in trials.
    """
    rows: list[BodyMeasureRangeRow] = []
    for group in groups:
        for sex in SEXES:
            spans = [(height_m, height_m) for height_m in compute_torso_heights(group, sex)]
            ends = [
                getattr(TRAINING_POPULATIONS[name], f"torso_height_{sex}_m")
                for name in HEIGHT_POPULATION_NAMES
            ]
            rows += _range(group.is_simulated, f"torso_height_{sex}_m", spans, *ends)
        for axis in AXIS_NAMES:
            ends = [
                (
                    -TRAINING_POPULATIONS[name].max_waist_angle_deg,
                    TRAINING_POPULATIONS[name].max_waist_angle_deg,
                )
                for name in HEIGHT_POPULATION_NAMES
            ]
            means = [_span(row, f"waist_{axis}_deg", f"waist_{axis}_deg") for row in group.trials]
            whole = [_span(row, f"waist_{axis}_min_deg", f"waist_{axis}_max_deg") for row in group.trials]
            rows += _range(group.is_simulated, f"waist_{axis}_deg, mean of a trial", means, *ends)
            rows += _range(group.is_simulated, f"waist_{axis}_deg, all of a trial", whole, *ends)
    return rows


def _span(row: TrialRow, minimum: str, maximum: str) -> tuple[float, float]:
    return float(getattr(row, minimum)), float(getattr(row, maximum))


def _range(
    simulated: bool,
    quantity: str,
    spans: Sequence[tuple[float, float]],
    original: tuple[float, float],
    revised: tuple[float, float],
) -> list[BodyMeasureRangeRow]:
    if not spans:
        return []
    covers = [
        fmean(low - 1e-9 <= minimum and maximum <= high + 1e-9 for minimum, maximum in spans)
        for low, high in (original, revised)
    ]
    return [
        BodyMeasureRangeRow(
            simulated=simulated,
            quantity=quantity,
            n=len(spans),
            minimum=min(minimum for minimum, _ in spans),
            maximum=max(maximum for _, maximum in spans),
            original_low=original[0],
            original_high=original[1],
            original_share=covers[0],
            revised_low=revised[0],
            revised_high=revised[1],
            revised_share=covers[1],
        )
    ]
