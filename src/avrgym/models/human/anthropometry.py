"""Anthropometry: lengths, radii and masses of a man and a woman, and their scaling.

The values are those of the 50th percentile man and woman in the code of the paper (after Tilley, *The Measure of Man
and Woman*, 2002).
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import elementary
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.models.body_names import Sex

TORSO_HEIGHT_RANGE_M = (0.40, 0.75)
ARM_SCALE_RANGE = (0.8, 1.25)
STATURE_RANGE_M, BMI_RANGE_KG_M2 = (1.2, 2.2), (12.0, 60.0)


@dataclass(frozen=True)
class BodyDimensions:
    """Body measures of one sex at its reference torso height; metres and kilograms.

    Fields may be arrays (N,) for N people. ``*_offset_z`` is the height of a part above the part below it.
    ``*_offset_x`` is the lateral distance of a joint from the middle of the body. ``hip_joint_depth_m`` is the distance
    of the hip joints below the origin of the hips. ``mouth_forward_offset_m`` is the distance of the mouth in front
    of the head joint.
    """

    torso_height_m: float
    mass_kg: float
    hips_radius_m: float
    hips_length_m: float
    hip_joint_depth_m: float
    waist_offset_z_m: float
    waist_radius_m: float
    waist_length_m: float
    chest_offset_z_m: float
    chest_radius_m: float
    chest_length_m: float
    shoulder_offset_z_m: float
    shoulder_radius_m: float
    shoulder_length_m: float
    shoulder_offset_x_m: float
    upper_arm_radius_m: float
    upper_arm_length_m: float
    forearm_radius_m: float
    forearm_length_m: float
    hand_radius_m: float
    neck_offset_z_m: float
    neck_radius_m: float
    neck_length_m: float
    head_offset_z_m: float
    head_centre_offset_z_m: float
    mouth_forward_offset_m: float
    thigh_offset_x_m: float
    thigh_radius_m: float
    thigh_length_m: float
    shin_radius_m: float
    shin_length_m: float
    foot_radius_m: float
    foot_length_m: float
    seated_hips_height_m: float


MAN = BodyDimensions(
    torso_height_m=0.60, mass_kg=78.4,
    hips_radius_m=0.1335, hips_length_m=0.094, hip_joint_depth_m=0.08125,
    waist_offset_z_m=0.08125, waist_radius_m=0.1205, waist_length_m=0.049,
    chest_offset_z_m=0.156, chest_radius_m=0.127, chest_length_m=0.056,
    shoulder_offset_z_m=0.1415, shoulder_radius_m=0.106, shoulder_length_m=0.032, shoulder_offset_x_m=0.106 + 0.073,
    upper_arm_radius_m=0.043, upper_arm_length_m=0.279,
    forearm_radius_m=0.033, forearm_length_m=0.257, hand_radius_m=0.043,
    neck_offset_z_m=0.1515, neck_radius_m=0.06, neck_length_m=0.124,
    head_offset_z_m=0.137, head_centre_offset_z_m=0.07425, mouth_forward_offset_m=0.11,
    thigh_offset_x_m=0.089, thigh_radius_m=0.08, thigh_length_m=0.424,
    shin_radius_m=0.05, shin_length_m=0.403, foot_radius_m=0.05, foot_length_m=0.215,
    seated_hips_height_m=0.65275,
)  # fmt: skip

WOMAN = BodyDimensions(
    torso_height_m=0.54, mass_kg=62.5,
    hips_radius_m=0.127, hips_length_m=0.117, hip_joint_depth_m=0.075,
    waist_offset_z_m=0.075, waist_radius_m=0.11, waist_length_m=0.009,
    chest_offset_z_m=0.150, chest_radius_m=0.127, chest_length_m=0.010,
    shoulder_offset_z_m=0.132, shoulder_radius_m=0.092, shoulder_length_m=0.028, shoulder_offset_x_m=0.092 + 0.067,
    upper_arm_radius_m=0.0355, upper_arm_length_m=0.264,
    forearm_radius_m=0.027, forearm_length_m=0.234, hand_radius_m=0.0355,
    neck_offset_z_m=0.132, neck_radius_m=0.05, neck_length_m=0.121,
    head_offset_z_m=0.12, head_centre_offset_z_m=0.063, mouth_forward_offset_m=0.10,
    thigh_offset_x_m=0.092, thigh_radius_m=0.0775, thigh_length_m=0.391,
    shin_radius_m=0.045, shin_length_m=0.367, foot_radius_m=0.045, foot_length_m=0.195,
    seated_hips_height_m=0.635,
)  # fmt: skip

BODY_DIMENSIONS: Mapping[Sex, BodyDimensions] = {"man": MAN, "woman": WOMAN}


def select_unscaled_dimensions(is_woman: BoolArray, like: Any = 0.0) -> BodyDimensions:
    """Returns the unscaled measures of N people, (N,) each. ``like`` is an array that determines the array library and
    the device.
    """
    where = get_namespace(is_woman).where
    measures: dict[str, Any] = {
        each.name: where(is_woman, *[constant_like(getattr(sex, each.name), like) for sex in (WOMAN, MAN)])
        for each in fields(BodyDimensions)
    }
    return BodyDimensions(**measures)


REFERENCE_STATURE_M: Mapping[Sex, float] = {"man": 1.755, "woman": 1.626}
"""Statures of ``MAN`` and ``WOMAN``: medians of ANSUR II (Gordon et al., Natick/TR-15/007, 2014)."""
GIRTH_EXPONENTS: Mapping[str, tuple[float, float]] = {
    "hips_radius_m": (0.455, 0.645),
    "waist_radius_m": (0.725, 0.585),
    "chest_radius_m": (0.515, 0.505),
    "shoulder_radius_m": (0.27, 0.56),
    "shoulder_offset_x_m": (0.48, 0.505),
    "upper_arm_radius_m": (0.59, 0.49),
    "forearm_radius_m": (0.375, 0.555),
    "hand_radius_m": (0.135, 0.56),
    "neck_radius_m": (0.325, 0.355),
    "thigh_offset_x_m": (0.45, 0.715),
    "thigh_radius_m": (0.575, 0.615),
    "shin_radius_m": (0.415, 0.55),
    "foot_radius_m": (0.26, 0.605),
}
"""Exponents b and c of the model log girth = a + b log BMI + c log stature, by name of the measure. They are means of
men and women.

The exponents are least-squares fits to the 4 082 men and 1 986 women of ANSUR II. The girths are circumferences of
buttocks, waist, chest, shoulders, biceps, forearm, hand, neck, thigh, calf and ankle. ``shoulder_offset_x_m`` uses the
forearm-forearm breadth, ``thigh_offset_x_m`` the hip breadth of sitting people.
"""


def scale_girths(
    p: BodyDimensions, is_woman: BoolArray, stature_m: FloatArray, bmi_kg_m2: FloatArray
) -> BodyDimensions:
    """Returns the measures of N people, with radii, breadths and mass scaled to stature and body mass index (N,).

    If a person's body mass index is NaN, the measures ``p`` of this person do not change.
    """
    xp, known = get_namespace(bmi_kg_m2), ~get_namespace(bmi_kg_m2).isnan(bmi_kg_m2)
    if xp is np and not known.any():
        return p
    reference_m = xp.where(
        is_woman, *(constant_like(REFERENCE_STATURE_M[sex], stature_m) for sex in ("woman", "man"))
    )
    reference_bmi = p.mass_kg / (reference_m * reference_m)
    taller = xp.where(known, stature_m, reference_m) / reference_m
    heavier = xp.where(known, bmi_kg_m2, reference_bmi) / reference_bmi
    changes: dict[str, Any] = {
        name: xp.where(known, elementary.power(heavier, bmi) * elementary.power(taller, stature), 1.0)
        for name, (bmi, stature) in GIRTH_EXPONENTS.items()
    }
    built: dict[str, Any] = {name: getattr(p, name) * factor for name, factor in changes.items()}
    mass = xp.where(known, bmi_kg_m2 * stature_m * stature_m, p.mass_kg)
    return replace(p, mass_kg=mass, **built)
