"""Bodies of the population ``anthropometric``, sampled from the anthropometric survey ANSUR II.

Source: 4 082 men and 1 986 women of the US Army (Gordon et al., *2012 Anthropometric Survey of U.S. Army Personnel*,
Natick/TR-15/007, 2014). The tables below are percentiles and least-squares regressions of its public data:

- stature: its percentiles from the 5th to the 95th;
- sitting height: regression on stature, plus percentiles of the residual;
- arm (shoulder-elbow plus radiale-stylion length): regression on stature and sitting height, plus its residual;
- body mass index: uniform from 17 (moderate thinness) to 40 (obesity class III; WHO Technical Report Series 894, 2000).
  The distribution covers the range of the index, not its prevalence. In ANSUR II the index does not correlate with
  stature (r = 0.00 and 0.06).

Relative to their medians, torso height is proportional to sitting height, and arm length to the measured arm length.
Legs scale with the torso. Soldiers are younger than most people who need assistance. Old people are a few centimetres
shorter, and bodies change shape with age.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry.arrays import get_namespace, interpolate
from avrgym.models.body_names import Sex
from avrgym.models.human import BODY_DIMENSIONS

PERCENTILES = (5.0, 10.0, 25.0, 50.0, 75.0, 90.0, 95.0)
BMI_RANGE_KG_M2 = (17.0, 40.0)
PercentileValues = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True)
class AnthropometricSurvey:
    """Measures of one sex in metres: percentiles, regressions and percentiles of their residuals.

    A regression is the intercept, followed by the slopes. The medians of sitting height and arm are those of all
    measured people of this sex.
    """

    stature_percentiles_m: PercentileValues
    sitting_height_regression: tuple[float, float]
    sitting_height_residuals_m: PercentileValues
    arm_length_regression: tuple[float, float, float]
    arm_length_residuals_m: PercentileValues
    median_sitting_height_m: float
    median_arm_length_m: float


ANSUR_II: Mapping[Sex, AnthropometricSurvey] = {
    "man": AnthropometricSurvey(
        stature_percentiles_m=(1.648, 1.669, 1.710, 1.755, 1.802, 1.844, 1.870),
        sitting_height_regression=(0.2058, 0.4057),
        sitting_height_residuals_m=(-0.0389, -0.0289, -0.0139, 0.0012, 0.0154, 0.0269, 0.0349),
        arm_length_regression=(0.0573, 0.5529, -0.4319),
        arm_length_residuals_m=(-0.0241, -0.0188, -0.0099, -0.0001, 0.0098, 0.0189, 0.0244),
        median_sitting_height_m=0.918,
        median_arm_length_m=0.631,
    ),
    "woman": AnthropometricSurvey(
        stature_percentiles_m=(1.525, 1.547, 1.5863, 1.626, 1.672, 1.713, 1.740),
        sitting_height_regression=(0.2158, 0.3935),
        sitting_height_residuals_m=(-0.0369, -0.0284, -0.0141, 0.0012, 0.0151, 0.0268, 0.0332),
        arm_length_regression=(0.0490, 0.5624, -0.4544),
        arm_length_residuals_m=(-0.0232, -0.0183, -0.0097, -0.0004, 0.0098, 0.0193, 0.0243),
        median_sitting_height_m=0.857,
        median_arm_length_m=0.574,
    ),
}


class BodyMeasures(NamedTuple):
    """Body measures of n people, arrays (n,), with the same names and units as in ``Person``."""

    torso_height_m: FloatArray
    arm_scale: FloatArray
    stature_m: FloatArray
    bmi_kg_m2: FloatArray


def sample_bodies(is_woman: BoolArray, first: FloatArray, second: FloatArray) -> BodyMeasures:
    """Returns n bodies, sampled from two arrays (n,) of uniform random numbers.

    Each number is split into two random numbers: its first 26 bits and its remaining bits.
    """
    xp = get_namespace(first)
    for_stature, for_sitting = _two_uniforms(first)
    for_arm, for_bmi = _two_uniforms(second)
    each = [_of_sex(sex, for_stature, for_sitting, for_arm) for sex in ("woman", "man")]
    torso, arm, stature = (xp.where(is_woman, *measures) for measures in zip(*each, strict=True))
    return BodyMeasures(torso, arm, stature, interpolate(BMI_RANGE_KG_M2, for_bmi))


def _of_sex(
    sex: Sex, for_stature: FloatArray, for_sitting: FloatArray, for_arm: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns torso heights, arm scales and statures (n,) of people of one sex, sampled from uniform random numbers
    (n,).
    """
    survey = ANSUR_II[sex]
    stature = _quantile(survey.stature_percentiles_m, for_stature)
    base, slope = survey.sitting_height_regression
    sitting = base + slope * stature + _quantile(survey.sitting_height_residuals_m, for_sitting)
    base, slope, on_sitting = survey.arm_length_regression
    arm = base + slope * stature + on_sitting * sitting + _quantile(survey.arm_length_residuals_m, for_arm)
    torso = sitting / survey.median_sitting_height_m
    return BODY_DIMENSIONS[sex].torso_height_m * torso, arm / survey.median_arm_length_m / torso, stature


def _two_uniforms(uniform: FloatArray) -> tuple[FloatArray, FloatArray]:
    scaled = 2.0**26 * uniform
    whole = get_namespace(uniform).floor(scaled)
    return whole / 2.0**26, scaled - whole


def _quantile(table: PercentileValues, uniform: FloatArray) -> FloatArray:
    """Returns values between the 5th and the 95th percentile for uniform numbers (n,), by linear interpolation."""
    xp = get_namespace(uniform)
    share = 0.01 * (PERCENTILES[0] + (PERCENTILES[-1] - PERCENTILES[0]) * uniform)
    value = table[0] + 0.0 * uniform
    knots = np.array(PERCENTILES) / 100.0
    for low, high, first, last in zip(knots, knots[1:], table, table[1:], strict=False):
        value = value + (last - first) / (high - low) * xp.clip(share - float(low), 0.0, float(high - low))
    return value
