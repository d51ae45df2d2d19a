"""Whom a policy meets: the distributions of people of the paper, section V.

Every person comes from one row of uniform numbers, so that a world's person does not depend on other worlds.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrgym.models import human
from avrgym.models.human import JOINTS, People, Person

Array = NDArray[np.float64]

ATTEMPTS = 8
UNIFORMS = 2 + ATTEMPTS * len(JOINTS)
"""How many uniform numbers a person takes: sex, torso height, and each attempt at a pose."""


@dataclass(frozen=True)
class Distribution:
    """Ranges of uniform distributions: torso heights in metres, waist joints in degrees either way.

    ``cooperating`` people move, see ``cooperation``; others keep the pose they were found in.
    """

    torso_height_man_m: tuple[float, float]
    torso_height_woman_m: tuple[float, float]
    waist_deg: float
    cooperating: bool = False


DISTRIBUTIONS: Mapping[str, Distribution] = {
    "original": Distribution((0.60, 0.60), (0.54, 0.54), waist_deg=0.0),
    "revised": Distribution((0.50, 0.70), (0.44, 0.64), waist_deg=10.0),
    "participants": Distribution((0.51, 0.58), (0.51, 0.58), waist_deg=5.0, cooperating=True),
}

WAIST = np.array([joint.body == "torso" for joint in JOINTS.values()])


@dataclass(frozen=True, eq=False)
class Pose:
    """How a task finds people: joint angles ``rest_rad`` (20,) ± uniform ``spread_rad`` (20,)."""

    rest_rad: Array
    spread_rad: Array


def find_distribution(name: str) -> Distribution:
    """The distribution of that name.

    Raises:
        ValueError: naming the distributions there are.
    """
    if name not in DISTRIBUTIONS:
        raise ValueError(f"unknown people {name!r}; the distributions are {', '.join(DISTRIBUTIONS)}")
    return DISTRIBUTIONS[name]


def sample(distribution: Distribution, pose: Pose, uniforms: Array) -> People:
    """People from uniform numbers (n, ``UNIFORMS``) in 0..1, man or woman with equal chance."""
    is_woman = uniforms[:, 0] < 0.5
    man = _between(distribution.torso_height_man_m, uniforms[:, 1])
    woman = _between(distribution.torso_height_woman_m, uniforms[:, 1])
    spread = pose.spread_rad + np.where(WAIST, np.radians(distribution.waist_deg), 0.0)
    poses = uniforms[:, 2:].reshape(len(uniforms), ATTEMPTS, len(JOINTS))
    angles = np.clip(pose.rest_rad + spread * (2.0 * poses[:, 0] - 1.0), human.LOWER_RAD, human.UPPER_RAD)
    return People.unimpaired(is_woman, np.where(is_woman, woman, man), angles)


def repeat(person: Person, count: int) -> People:
    """The same person in ``count`` worlds."""
    return People.of([person] * count)


def _between(limits: tuple[float, float], uniform: Array) -> Array:
    return limits[0] + (limits[1] - limits[0]) * uniform
