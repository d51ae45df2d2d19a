"""Body parameters of simulated people: ``Person`` for one person, ``People`` with arrays for many people."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry.arrays import get_namespace_and_floats
from avrgym.models.body_names import PERSON_ARM_SIDES, SEXES, Sex, Side
from avrgym.models.human.anthropometry import (
    ARM_SCALE_RANGE,
    BMI_RANGE_KG_M2,
    STATURE_RANGE_M,
    TORSO_HEIGHT_RANGE_M,
)
from avrgym.models.human.joints import JOINTS, SEATED_POSE_RAD

SKIN_TONES: Mapping[str, tuple[float, float, float]] = {
    "light": (0.90, 0.74, 0.65),
    "fair": (0.83, 0.65, 0.54),
    "medium": (0.75, 0.56, 0.43),
    "olive": (0.64, 0.46, 0.34),
    "brown": (0.48, 0.33, 0.24),
    "dark": (0.31, 0.21, 0.16),
}
"""Rendered skin colours by name: red, green and blue, 0 to 1."""


@dataclass(frozen=True)
class Person:
    """Body parameters of one simulated person.

    Attributes:
        sex: ``man`` or ``woman``, which selects the body model.
        torso_height_m: distance from the hip bone to the centre of the head.
        joint_angles_rad: joint angles in the order of ``human.JOINTS`` (20,).
        skin_tone: a name in ``SKIN_TONES``.
        arm_scale: length of upper arms and forearms relative to the average for this torso height.
        stature_m, bmi_kg_m2: stature and body mass index, which determine radii and mass. With ``None``, radii and mass
            are those of the paper's man or woman.
        absent_arms: amputated arms, which have no contacts and are not drawn. The joints of these arms remain in the
            model. Observations therefore contain their pose.

    Raises:
        ValueError: for a value out of range.
    """

    sex: Sex = "woman"
    torso_height_m: float = 0.54
    joint_angles_rad: FloatArray = field(default_factory=lambda: SEATED_POSE_RAD.copy())
    skin_tone: str = "fair"
    arm_scale: float = 1.0
    stature_m: float | None = None
    bmi_kg_m2: float | None = None
    absent_arms: tuple[Side, ...] = ()

    def __post_init__(self) -> None:
        if self.sex not in SEXES:
            raise ValueError(f"unknown sex {self.sex!r}; allowed: {', '.join(SEXES)}")
        if self.skin_tone not in SKIN_TONES:
            raise ValueError(f"unknown skin tone {self.skin_tone!r}; allowed: {', '.join(SKIN_TONES)}")
        check_torso_height(self.torso_height_m)
        check_arm_scale(self.arm_scale)
        if not {*self.absent_arms} <= {*PERSON_ARM_SIDES}:
            raise ValueError(f"absent_arms is {self.absent_arms!r}; allowed: {', '.join(PERSON_ARM_SIDES)}")
        if (self.stature_m is None) != (self.bmi_kg_m2 is None):
            raise ValueError(
                f"stature_m is {self.stature_m} and bmi_kg_m2 is {self.bmi_kg_m2}; allowed: numbers for both, or "
                "None for both"
            )
        for name, (low, high) in (("stature_m", STATURE_RANGE_M), ("bmi_kg_m2", BMI_RANGE_KG_M2)):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f"{name} is {value:g}; allowed: {low:g} to {high:g}")
        if np.shape(self.joint_angles_rad) != (len(JOINTS),):
            raise ValueError(
                f"joint_angles_rad has the shape {np.shape(self.joint_angles_rad)}; allowed: ({len(JOINTS)},)"
            )


def convert_to_person(person: "Person | Mapping[str, Any] | None") -> "Person | None":
    """Convert a mapping of field values, as in JSON, to a person. Returns a ``Person`` or ``None`` unchanged.

    Raises:
        ValueError: for an unknown field or a value out of range.
    """
    if person is None or isinstance(person, Person):
        return person
    names = [each.name for each in fields(Person)]
    unknown = ", ".join(str(name) for name in person if name not in names)
    if unknown:
        raise ValueError(f"unknown field {unknown} of a person; allowed: {', '.join(names)}")
    values = dict(person)
    if "joint_angles_rad" in values:
        values["joint_angles_rad"] = np.array(values["joint_angles_rad"], float)
    return Person(**values)


def check_arm_scale(arm_scale: float) -> None:
    """Raises ``ValueError`` for an arm scale out of range. The message contains the range."""
    low, high = ARM_SCALE_RANGE
    if not low <= arm_scale <= high:
        raise ValueError(f"arm_scale is {arm_scale:.2f}; allowed: {low:g} to {high:g}")


def check_torso_height(torso_height_m: float) -> None:
    """Raises ``ValueError`` for a torso height out of range. The message contains the range."""
    low, high = TORSO_HEIGHT_RANGE_M
    if not low <= torso_height_m <= high:
        raise ValueError(f"the torso height is {torso_height_m:.3f} m; allowed: {low:.2f} to {high:.2f} m")


@dataclass(frozen=True)
class People:
    """Body parameters of N simulated people, as arrays.

    Attributes:
        is_woman: whether the body model is that of a woman (N,).
        torso_height_m: distance from the hip bone to the centre of the head (N,).
        joint_angles_rad: joint angles in the order of ``human.JOINTS`` (N, 20).
        range_share: joint ranges as a share of the full ranges (N,).
        strength_share: joint torques as a share of the full torques, (N,) or by joint (N, 20).
        tremor_rad: tremor amplitude of each joint (N, 20).
        arm_scale: length of upper arms and forearms relative to the average for the torso height (N,).
        torque_fraction: torques towards the lower and the upper limit of each joint, as a share of the full torques (N,
        20, 2).
        damping_n_m_s: passive damping of each joint, N m s/rad (N, 20).
        stature_m, bmi_kg_m2: stature and body mass index (N,); NaN for the radii and mass of the paper's man or woman.
    """

    is_woman: BoolArray
    torso_height_m: FloatArray
    joint_angles_rad: FloatArray
    range_share: FloatArray
    strength_share: FloatArray
    tremor_rad: FloatArray
    arm_scale: FloatArray
    torque_fraction: FloatArray
    damping_n_m_s: FloatArray
    stature_m: FloatArray
    bmi_kg_m2: FloatArray

    @classmethod
    def from_persons(cls, persons: Iterable[Person]) -> "People":
        """Returns the body parameters of several ``Person`` records as arrays."""
        persons = list(persons)
        people = cls.make_unimpaired(
            np.array([person.sex == "woman" for person in persons]),
            np.array([person.torso_height_m for person in persons], float),
            np.stack([np.asarray(person.joint_angles_rad, float) for person in persons]),
        )
        return replace(
            people,
            arm_scale=np.array([person.arm_scale for person in persons], float),
            stature_m=np.array([person.stature_m for person in persons], float),
            bmi_kg_m2=np.array([person.bmi_kg_m2 for person in persons], float),
        )

    @classmethod
    def make_unimpaired(
        cls, is_woman: BoolArray, torso_height_m: FloatArray, joint_angles_rad: FloatArray
    ) -> "People":
        """Returns people with full joint ranges and strength, without tremor and damping, with average arm lengths."""
        xp, height, angles = get_namespace_and_floats(torso_height_m, joint_angles_rad)
        full = xp.ones_like(height)
        torques = xp.ones_like(xp.stack([angles, angles], axis=-1))
        none = xp.zeros_like(angles)
        unknown = xp.nan * full
        return cls(
            is_woman,
            torso_height_m,
            joint_angles_rad,
            full,
            full,
            none,
            full,
            torques,
            none,
            unknown,
            unknown,
        )

    def get_person(self, index: int) -> Person:
        """Returns the body parameters of the person with index ``index`` as a ``Person``."""
        sex = SEXES[int(self.is_woman[index])]
        return Person(
            sex,
            float(self.torso_height_m[index]),
            self.joint_angles_rad[index].copy(),
            arm_scale=float(self.arm_scale[index]),
            stature_m=None if np.isnan(self.stature_m[index]) else float(self.stature_m[index]),
            bmi_kg_m2=None if np.isnan(self.bmi_kg_m2[index]) else float(self.bmi_kg_m2[index]),
        )
