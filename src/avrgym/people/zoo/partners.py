"""Partners of the zoo: each style has one partner for each combination of levels on its axes.

A partner of the zoo is a row of ``PARTNER_PARAMETERS``. The training population is ``zoo/train``. The held-out
populations are ``zoo/unseen`` and ``zoo/extreme``. On every axis the values of ``zoo/unseen`` are between the training
values, and no value is in both populations. The values of ``zoo/extreme`` are outside the range of the training values:
slower and faster, smaller and larger. Fitted populations have their own partners, see ``sample_fitted_partners``.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import cycle, product
from typing import Any, NamedTuple

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.commands.preferences import MAX_SPEED_FACTOR, MIN_SPEED_FACTOR
from avrgym.geometry.arrays import RAD_PER_DEGREE, choose_index, constant_like, get_namespace
from avrgym.models.human import JOINTS, People
from avrgym.people import impairments
from avrgym.people.impairments import MAX_TREMOR_TARGET_RAD
from avrgym.people.motor_model import DEFAULT_TREMOR_HZ
from avrgym.people.population_names import EXTREME_ZOO, TRAIN_ZOO, UNSEEN_ZOO
from avrgym.people.zoo.styles import STYLES, BehaviourStyle
from avrgym.system import random_streams

STYLE_LEVELS: Mapping[str, tuple[float, ...]] = {
    TRAIN_ZOO: (0.0, 0.5, 1.0),
    UNSEEN_ZOO: (0.13, 0.37, 0.63, 0.87),
    EXTREME_ZOO: (-0.4, 1.4),
}
"""Levels on each axis of a style, by population of the zoo. Level 0 is the first value of each range, level 1 the last
value.
"""
PARAMETER_BOUNDS: Mapping[str, tuple[float, float]] = {
    "reaction_s": (0.1, 0.95),
    "facing_share": (0.0, 1.0),
    "glance_share": (0.0, 0.9),
    "glance_period_s": (0.1, np.inf),
    "shift_period_s": (0.1, np.inf),
    "speed_share": (0.1, np.inf),
    "tremor_hz": (2.0, 12.0),
    "strength_share": (0.1, 1.0),
    "range_share": (0.2, 1.0),
    "ready_delay_s": (0.1, np.inf),
    "comfortable_speed": (MIN_SPEED_FACTOR, MAX_SPEED_FACTOR),
}
"""Bounds of behaviour parameters. All other parameters have the bounds 0 and infinity. Values of ``zoo/extreme`` are
clipped to these bounds.
"""
DEFAULT_PARAMETER_BOUNDS = (0.0, np.inf)


@dataclass(frozen=True)
class BehaviourParameters:
    """Behaviour parameters of P partners, arrays (P,). With the default values a partner does not move.

    Attributes:
        reaction_s: reaction delay to the tool.
        facing_share: executed share of the head rotation that is needed to face the tool.
        approach_share: extent of the approach to a near tool (lean, or lift the arm), relative to
            ``people.cooperation``.
        pause_s: waiting time before the approach, and again at half the approach.
        withdrawal_deg: extent of withdrawal while the tool is near.
        startle_deg, startle_distance_m, startle_duration_s: extent of a startle, the tool distance that triggers it,
            and its duration.
        glance_deg, random_glance_deg: occasional head turns to one side, and to a random side.
        glance_period_s, glance_share: period of the head turns, and their share of the period.
        chew_deg, chew_hz: head motion with the jaw.
        shift_deg, shift_period_s: extent and period of posture shifts.
        sway_deg, sway_hz: amplitude and frequency of sway.
        speed_share: speed and acceleration relative to the limits of ``population_names.motor_model``.
        tremor_deg, tremor_hz: tremor amplitude of the head, and frequency. The amplitude of the arms is half as large.
        strength_share, range_share: joint torques and joint ranges, relative to the full ones.
    """

    reaction_s: FloatArray
    facing_share: FloatArray
    approach_share: FloatArray
    pause_s: FloatArray
    withdrawal_deg: FloatArray
    startle_deg: FloatArray
    startle_distance_m: FloatArray
    startle_duration_s: FloatArray
    glance_deg: FloatArray
    random_glance_deg: FloatArray
    glance_period_s: FloatArray
    glance_share: FloatArray
    chew_deg: FloatArray
    chew_hz: FloatArray
    shift_deg: FloatArray
    shift_period_s: FloatArray
    sway_deg: FloatArray
    sway_hz: FloatArray
    speed_share: FloatArray
    tremor_deg: FloatArray
    tremor_hz: FloatArray
    strength_share: FloatArray
    range_share: FloatArray

    def select_partners(self, rows: IntArray, like: Any = 0.0) -> "BehaviourParameters":
        """Returns the parameters of the partners ``rows``, with the array library and device of ``like``."""
        return BehaviourParameters(*(constant_like(array, like)[rows] for array in vars(self).values()))

    @classmethod
    def from_table(cls, table: FloatArray) -> "BehaviourParameters":
        """Returns the parameters in a table (P, 23) with a column for each of ``PARAMETER_NAMES``."""
        return cls(*(table[:, column] for column in range(len(PARAMETER_NAMES))))

    def to_table(self) -> FloatArray:
        """Returns the parameters as a table (P, 23) with a column for each of ``PARAMETER_NAMES``."""
        arrays = list(vars(self).values())
        return get_namespace(arrays[0]).stack(arrays, axis=-1)


PARAMETER_NAMES = tuple(each.name for each in fields(BehaviourParameters))
_DEFAULTS: Mapping[str, float] = {
    "speed_share": 1.0,
    "strength_share": 1.0,
    "range_share": 1.0,
    "glance_period_s": 1.0,
    "shift_period_s": 1.0,
    "tremor_hz": DEFAULT_TREMOR_HZ,
}


class Partner(NamedTuple):
    """A partner of the zoo: its population (such as ``zoo/train``), its style, and its level on each axis."""

    zoo: str
    style: str
    levels: tuple[float, ...]


def _partners() -> tuple[Partner, ...]:
    """Returns all partners. Partners of the same zoo and style are adjacent."""
    return tuple(
        Partner(zoo, name, chosen)
        for zoo, levels in STYLE_LEVELS.items()
        for name, style in STYLES.items()
        for chosen in product(*(levels if axis else (0.0,) for axis in style.axis_ranges))
    )


def interpolate_style_parameters(style: BehaviourStyle, levels: tuple[float, ...]) -> dict[str, float]:
    """Returns the parameter values of a style by name, at the given levels on its axes."""
    return {
        trait: float(
            np.clip(first + level * (last - first), *PARAMETER_BOUNDS.get(trait, DEFAULT_PARAMETER_BOUNDS))
        )
        for axis, level in zip(style.axis_ranges, levels, strict=True)
        for trait, (first, last) in axis.items()
    }


PARTNERS = _partners()


def make_behaviour_parameters(values: Sequence[Mapping[str, float]]) -> BehaviourParameters:
    """Returns the parameters of partners, given values by name. Missing values are the defaults."""
    return BehaviourParameters(
        *(
            np.array([each.get(trait, _DEFAULTS.get(trait, 0.0)) for each in values], float)
            for trait in PARAMETER_NAMES
        )
    )


PARTNER_PARAMETERS = make_behaviour_parameters(
    [interpolate_style_parameters(STYLES[each.style], each.levels) for each in PARTNERS]
)
"""Behaviour parameters of all ``PARTNERS``, in the same order."""


@dataclass(frozen=True, eq=False)
class PartnerSet:
    """A set of partners. To sample a partner, a group is sampled first, then a partner of this group.

    ``group_starts_and_sizes`` contains the row of the first partner and the number of partners of each group. In the
    zoo, a group is a style.
    """

    parameters: BehaviourParameters
    group_starts_and_sizes: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return sum(count for _, count in self.group_starts_and_sizes)

    def sample_partner_rows(self, uniforms: FloatArray) -> IntArray:
        """Sample n partners from uniform numbers (n, 2). Returns their rows (n,) in ``parameters``."""
        first, count = (
            constant_like(each, uniforms) for each in np.array(self.group_starts_and_sizes).T.copy()
        )
        group = choose_index(uniforms[:, 0], len(self.group_starts_and_sizes))
        return first[group] + choose_index(uniforms[:, 1], count[group])

    def sample(self, uniforms: FloatArray) -> BehaviourParameters:
        """Sample n partners from uniform numbers (n, 2). Returns their parameters, arrays (n,)."""
        return self.parameters.select_partners(self.sample_partner_rows(uniforms), uniforms)


NUM_FITTED_PARTNERS = 512
"""Number of partners that are sampled for a population that was fitted to a study."""


def sample_fitted_partners(estimates: Sequence[Mapping[str, tuple[float, float]]]) -> PartnerSet:
    """Returns partners that behave like n participants.

    Args:
        estimates: means and standard deviations of each participant's parameters. Each partner behaves like one
            participant. The parameters of the partner are normally distributed and clipped to ``PARAMETER_BOUNDS``.
            Parameters without an estimate have their default values.
    """
    random = random_streams.make_fitted_population_rng()
    normal = random.standard_normal((NUM_FITTED_PARTNERS, len(PARAMETER_NAMES)))
    values = [
        {
            name: float(np.clip(mean + deviation * z, *PARAMETER_BOUNDS.get(name, DEFAULT_PARAMETER_BOUNDS)))
            for name, z in zip(PARAMETER_NAMES, row, strict=True)
            if name in estimate
            for mean, deviation in [estimate[name]]
        }
        for row, estimate in zip(normal.tolist(), cycle(estimates), strict=False)
    ]
    return PartnerSet(make_behaviour_parameters(values), ((0, len(values)),))


def _zoo_set(zoo: str, styles: Collection[str]) -> PartnerSet:
    """Returns the set of all partners of the given styles in one population of the zoo."""
    places = [
        [row for row, partner in enumerate(PARTNERS) if (partner.zoo, partner.style) == (zoo, style)]
        for style in styles
    ]
    return PartnerSet(PARTNER_PARAMETERS, tuple((rows[0], len(rows)) for rows in places))


ZOO_PARTNER_SETS: Mapping[str, PartnerSet] = {zoo: _zoo_set(zoo, STYLES) for zoo in STYLE_LEVELS}
SINGLE_STYLE_PARTNER_SETS: Mapping[str, PartnerSet] = {
    f"{zoo}/{style}": _zoo_set(zoo, [style]) for zoo in STYLE_LEVELS for style in STYLES
}

_TREMOR_SHARE = MAX_TREMOR_TARGET_RAD / MAX_TREMOR_TARGET_RAD[list(JOINTS).index("head_x")]


def apply_partner_bodies(people: People, parameters: BehaviourParameters) -> People:
    """Returns the people (n,) with the joint ranges, strength and tremor of partners (n,)."""
    share = constant_like(_TREMOR_SHARE, people.torso_height_m)
    tremor_rad = (RAD_PER_DEGREE * parameters.tremor_deg)[:, None] * share
    strong = replace(people, strength_share=parameters.strength_share, tremor_rad=tremor_rad)
    return impairments.limit_joint_ranges(strong, parameters.range_share)
