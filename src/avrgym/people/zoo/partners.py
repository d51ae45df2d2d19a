"""Who lives in the zoo: every style at every combination of levels of its axes, some to train with and others to meet.

A partner is a row of ``PARTNER_PARAMETERS``. Those of ``zoo/unseen`` lie between those of ``zoo/train`` on every axis:
no trait that a style moves has the same value in both.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry.arrays import RAD_PER_DEGREE, choose_index, constant_like
from avrgym.models.human import JOINTS, People
from avrgym.people import impairments
from avrgym.people.impairments import TREMOR_TARGET_RAD
from avrgym.people.population_names import TRAIN_ZOO, UNSEEN_ZOO
from avrgym.people.zoo.styles import STYLES, Style

LEVELS: Mapping[str, tuple[float, ...]] = {
    TRAIN_ZOO: (0.0, 0.5, 1.0),
    UNSEEN_ZOO: (0.13, 0.37, 0.63, 0.87),
}
"""Where on each axis of a style the partners are, from its traits' first values, 0, to their last, 1."""


@dataclass(frozen=True)
class BehaviourParameters:
    """How P partners behave, (P,) each; the defaults are of those who do nothing.

    Attributes:
        reaction_s: what they see of the tool lies so far in the past.
        facing_share: how far they turn the face to it.
        approach_share: how far they lean to it, or lift the arm, when it is near; 1 is as far as participants do.
        pause_s: how long they wait before they do, and half-way.
        away_deg: how far they withdraw as long as it is near.
        startle_deg, startle_m, startle_s: how far they withdraw the first time that it comes so near, and for how long.
        glance_deg, wander_deg: how far to one side, and how far to any, they turn the head from time to time.
        glance_every_s, glance_share: how often, and for what share of the time.
        chew_deg, chew_hz: how far and how often the head goes back with the jaw.
        shift_deg, shift_every_s: how far and how often they shift in their seat.
        sway_deg, sway_hz: how they sway.
        speed_share: how fast they move, of the usual.
        tremor_deg: how far the head trembles either way; the arms do half as far.
        strength_share, range_share: of their joints' torques and ranges.
    """

    reaction_s: FloatArray
    facing_share: FloatArray
    approach_share: FloatArray
    pause_s: FloatArray
    away_deg: FloatArray
    startle_deg: FloatArray
    startle_m: FloatArray
    startle_s: FloatArray
    glance_deg: FloatArray
    wander_deg: FloatArray
    glance_every_s: FloatArray
    glance_share: FloatArray
    chew_deg: FloatArray
    chew_hz: FloatArray
    shift_deg: FloatArray
    shift_every_s: FloatArray
    sway_deg: FloatArray
    sway_hz: FloatArray
    speed_share: FloatArray
    tremor_deg: FloatArray
    strength_share: FloatArray
    range_share: FloatArray

    def of(self, rows: IntArray, numbers: Any = 0.0) -> "BehaviourParameters":
        """Those of some partners, as arrays of the library and type of ``numbers``, or else of NumPy."""
        return BehaviourParameters(*(constant_like(array, numbers)[rows] for array in vars(self).values()))


PARAMETER_NAMES = tuple(each.name for each in fields(BehaviourParameters))
_USUAL: Mapping[str, float] = {
    "speed_share": 1.0,
    "strength_share": 1.0,
    "range_share": 1.0,
    "glance_every_s": 1.0,
    "shift_every_s": 1.0,
}


class Partner(NamedTuple):
    """One of a zoo: its style, and its level on each axis of it, 0 to 1."""

    zoo: str
    style: str
    levels: tuple[float, ...]


def _partners() -> tuple[Partner, ...]:
    """All partners; those of a style in a zoo follow each other."""
    return tuple(
        Partner(zoo, name, chosen)
        for zoo, levels in LEVELS.items()
        for name, style in STYLES.items()
        for chosen in product(*(levels if axis else (0.0,) for axis in style.axes))
    )


def _traits(style: Style, levels: tuple[float, ...]) -> dict[str, float]:
    """What the traits of a style are that it moves."""
    return {
        trait: first + level * (last - first)
        for axis, level in zip(style.axes, levels, strict=True)
        for trait, (first, last) in axis.items()
    }


PARTNERS = _partners()
_MOVED = [_traits(STYLES[partner.style], partner.levels) for partner in PARTNERS]
PARTNER_PARAMETERS = BehaviourParameters(
    *(np.array([moved.get(trait, _USUAL.get(trait, 0.0)) for moved in _MOVED]) for trait in PARAMETER_NAMES)
)
"""The manner of each of ``PARTNERS``."""


class PartnerSet:
    """Some of the partners to draw from: each style with the same chance, then each of its partners."""

    def __init__(self, zoo: str, styles: Collection[str]) -> None:
        self.zoo, self.styles = zoo, tuple(styles)
        places = [
            [row for row, partner in enumerate(PARTNERS) if (partner.zoo, partner.style) == (zoo, style)]
            for style in styles
        ]
        self._first = np.array([rows[0] for rows in places])
        self._count = np.array([len(rows) for rows in places])

    def __len__(self) -> int:
        return int(self._count.sum())

    def draw(self, uniforms: FloatArray) -> IntArray:
        """Partners (n,) from uniform numbers (n, 2)."""
        first, count = constant_like(self._first, uniforms), constant_like(self._count, uniforms)
        style = choose_index(uniforms[:, 0], len(self.styles))
        return first[style] + choose_index(uniforms[:, 1], count[style])


ZOOS: Mapping[str, PartnerSet] = {zoo: PartnerSet(zoo, STYLES) for zoo in LEVELS}
SINGLE_STYLE_SETS: Mapping[str, PartnerSet] = {
    f"{zoo}/{style}": PartnerSet(zoo, [style]) for zoo in LEVELS for style in STYLES
}

_TREMOR_SHARE = TREMOR_TARGET_RAD / TREMOR_TARGET_RAD[list(JOINTS).index("head_x")]


def apply_partner_bodies(people: People, partners: IntArray) -> People:
    """The same people with what the bodies of partners (n,) are like: ranges, strength and tremor."""
    manner = PARTNER_PARAMETERS.of(partners, people.torso_height_m)
    share = constant_like(_TREMOR_SHARE, people.torso_height_m)
    tremor_rad = (RAD_PER_DEGREE * manner.tremor_deg)[:, None] * share
    strong = replace(people, strength_share=manner.strength_share, tremor_rad=tremor_rad)
    return impairments.limit_joint_ranges(strong, manner.range_share)
