"""Motor impairments of simulated people, as in Assistive Gym (Erickson et al., ICRA 2020)."""

from dataclasses import replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import constant_like, interpolate, namespace
from avrgym.models.human import JOINTS, LOWER_RAD, UPPER_RAD, People
from avrgym.people.population_names import IMPAIRMENTS, Impairment

MOVING_IMPAIRMENTS: tuple[Impairment, ...] = ("weakness", "tremor")
"""Impairments that only affect people with moving joints."""

NUM_UNIFORMS = 1 + len(JOINTS)
RANGE_SHARE, STRENGTH_SHARE = (0.5, 1.0), (0.25, 1.0)
TREMOR_TARGET_RAD = np.array(
    [np.radians({"torso": 0.0, "head": 20.0}.get(joint.body, 10.0)) for joint in JOINTS.values()]
)
"""Largest alternating joint target in Assistive Gym: head ±20°, arms ±10°."""
_STEP_RESPONSE = 1.0 - (1.0 - 0.05) ** 5
"""Share of the distance to its target that a joint covers in one control step.

Assistive Gym takes five physics steps (``frame_skip``). In each step the motor reduces the distance by at most a
twentieth (``motor_gains``).
"""
TREMOR_AMPLITUDE_RATIO = _STEP_RESPONSE / (2.0 - _STEP_RESPONSE)
"""Amplitude of the joint relative to its alternating target, about 1/8: 2 a = share (target + a)."""
TREMOR_RAD = TREMOR_AMPLITUDE_RATIO * TREMOR_TARGET_RAD
"""Largest tremor amplitude: head ±2.5°, arms ±1.3°."""


def find_impairment(name: str) -> Impairment:
    """Check the name of an impairment.

    Raises:
        ValueError: for an unknown name. The message lists the impairments.
    """
    if name not in IMPAIRMENTS:
        raise ValueError(f"unknown impairment {name!r}; allowed: {', '.join(IMPAIRMENTS)}")
    return name


def apply_impairment(people: People, impairment: Impairment, uniforms: FloatArray) -> People:
    """Apply an impairment, sampled from uniform numbers (n, ``NUM_UNIFORMS``).

    - ``limits``: joint ranges and pose shrink by U(0.5, 1).
    - ``weakness``: joint torques shrink by U(0.25, 1).
    - ``tremor``: joints alternate by up to ``TREMOR_RAD``, or by the person's own tremor if that is larger.
    """
    if impairment == "limits":
        return limit_joint_ranges(people, people.range_share * interpolate(RANGE_SHARE, uniforms[:, 0]))
    if impairment == "weakness":
        share = people.strength_share * interpolate(STRENGTH_SHARE, uniforms[:, 0])
        return replace(people, strength_share=share)
    if impairment == "tremor":
        xp, amplitude_rad = namespace(uniforms), constant_like(TREMOR_RAD, uniforms) * uniforms[:, 1:]
        return replace(people, tremor_rad=xp.maximum(people.tremor_rad, amplitude_rad))
    return people


def limit_joint_ranges(people: People, share: FloatArray) -> People:
    """Limit the joints to a share (n,) of their full ranges, and clip the pose."""
    limited = replace(people, range_share=share)
    return replace(limited, joint_angles_rad=clip_to_ranges(limited, people.joint_angles_rad))


def clip_to_ranges(people: People, joint_angles_rad: FloatArray) -> FloatArray:
    """Clip joint angles (n, 20) to the people's ranges."""
    share = people.range_share[:, None]
    lower, upper = share * constant_like(LOWER_RAD, share), share * constant_like(UPPER_RAD, share)
    return namespace(joint_angles_rad).clip(joint_angles_rad, lower, upper)
