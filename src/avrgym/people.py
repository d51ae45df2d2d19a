"""Whom a policy meets: the distributions of people of the paper, section V.

Every person comes from one row of uniform numbers, so that a world's person does not depend on other worlds.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrgym.models.human import JOINT_INDEX, SEATED_RAD, People, Person

Array = NDArray[np.float64]

UNIFORMS = 8
"""How many uniform numbers a person takes: sex, torso height, three of the waist, three of the head."""

_WAIST = [JOINT_INDEX[f"waist_{axis}"] for axis in "xyz"]
_HEAD = [JOINT_INDEX[f"head_{axis}"] for axis in "xyz"]


@dataclass(frozen=True)
class Distribution:
    """Ranges of uniform distributions: torso heights in metres, joint angles in degrees either way."""

    torso_height_man_m: tuple[float, float]
    torso_height_woman_m: tuple[float, float]
    waist_deg: float
    head_deg: float


DISTRIBUTIONS: Mapping[str, Distribution] = {
    "original": Distribution((0.60, 0.60), (0.54, 0.54), waist_deg=0.0, head_deg=30.0),
    "revised": Distribution((0.50, 0.70), (0.44, 0.64), waist_deg=10.0, head_deg=30.0),
}


def find_distribution(name: str) -> Distribution:
    """The distribution of that name.

    Raises:
        ValueError: naming the distributions there are.
    """
    if name not in DISTRIBUTIONS:
        raise ValueError(f"unknown people {name!r}; the distributions are {', '.join(DISTRIBUTIONS)}")
    return DISTRIBUTIONS[name]


def sample(distribution: Distribution, uniforms: Array) -> People:
    """Seated people from uniform numbers (n, 8) in 0..1, man or woman with equal chance."""
    is_woman = uniforms[:, 0] < 0.5
    man = _between(distribution.torso_height_man_m, uniforms[:, 1])
    woman = _between(distribution.torso_height_woman_m, uniforms[:, 1])
    angles = np.tile(SEATED_RAD, (len(uniforms), 1))
    angles[:, _WAIST] += np.radians(distribution.waist_deg) * (2.0 * uniforms[:, 2:5] - 1.0)
    angles[:, _HEAD] += np.radians(distribution.head_deg) * (2.0 * uniforms[:, 5:8] - 1.0)
    return People(is_woman, np.where(is_woman, woman, man), angles)


def repeat(person: Person, count: int) -> People:
    """The same person in ``count`` worlds."""
    return People.of([person] * count)


def _between(limits: tuple[float, float], uniform: Array) -> Array:
    return limits[0] + (limits[1] - limits[0]) * uniform
