"""Motor impairments of simulated people: impairments of Assistive Gym (Erickson et al., ICRA 2020), and clinical
impairments.
"""

from dataclasses import replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import constant_like, get_namespace, interpolate
from avrgym.models.human import JOINTS, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, People
from avrgym.people.clinical_impairments import sample_motor_signs
from avrgym.people.population_names import ALLOWED_IMPAIRMENTS_TEXT, IMPAIRMENTS, SEVERITIES, ImpairmentName

NUM_RANDOM_NUMBERS = 1 + len(JOINTS)
LIMITED_JOINT_RANGE_FRACTIONS, WEAKNESS_STRENGTH_FRACTIONS = (0.5, 1.0), (0.25, 1.0)
MAX_TREMOR_TARGET_RAD = np.array(
    [np.radians({"torso": 0.0, "head": 20.0}.get(joint.body, 10.0)) for joint in JOINTS.values()]
)
"""Maximum amplitude of the alternating joint targets in Assistive Gym: head ±20°, arms ±10°."""
_STEP_RESPONSE = 1.0 - (1.0 - 0.05) ** 5
"""Share of the distance to its target that a joint covers in one control step.

Assistive Gym takes five physics steps (``frame_skip``). In each step the motor reduces the distance by at most a
twentieth (``motor_gains``).
"""
TREMOR_AMPLITUDE_RATIO = _STEP_RESPONSE / (2.0 - _STEP_RESPONSE)
"""Amplitude a of the joint's motion divided by the amplitude of its alternating target, about 1/8.

It is the solution of 2 a = ``_STEP_RESPONSE`` (target + a).
"""
MAX_TREMOR_AMPLITUDE_RAD = TREMOR_AMPLITUDE_RATIO * MAX_TREMOR_TARGET_RAD
"""Maximum tremor amplitude of each joint (20,): head ±2.5°, arms ±1.3°."""


def parse_impairment(name: str) -> ImpairmentName:
    """Checks the name of an impairment, and returns it.

    Raises:
        ValueError: for an unknown name or severity. The message lists the impairments.
    """
    base, colon, severity = name.partition(":")
    if base not in IMPAIRMENTS or (colon and severity not in SEVERITIES.get(base, ())):
        raise ValueError(f"unknown impairment {name!r}; allowed: {ALLOWED_IMPAIRMENTS_TEXT}")
    return name


def is_clinical_impairment(impairment: ImpairmentName) -> bool:
    """Returns whether ``people.impaired_motion`` computes the motion of people with this impairment."""
    return impairment.partition(":")[0] in SEVERITIES


def needs_movable_joints(impairment: ImpairmentName) -> bool:
    """Returns whether the impairment has an effect only on people with movable joints."""
    return impairment in ("weakness", "tremor") or is_clinical_impairment(impairment)


def apply_impairment(people: People, impairment: ImpairmentName, uniforms: FloatArray) -> People:
    """Returns people with an impairment. Its severity is sampled from uniform numbers (n, ``NUM_RANDOM_NUMBERS``).

    - ``limits``: joint ranges are multiplied by a factor from U(0.5, 1), and the pose is clipped to them.
    - ``weakness``: joint torques are multiplied by a factor from U(0.25, 1).
    - ``tremor``: amplitudes are sampled between 0 and ``MAX_TREMOR_AMPLITUDE_RAD``. A larger tremor of the person does
      not change.
    - Clinical impairments change torques by joint and direction, and damping, see ``people.clinical_impairments``.
    """
    if impairment == "limits":
        return limit_joint_ranges(
            people, people.range_share * interpolate(LIMITED_JOINT_RANGE_FRACTIONS, uniforms[:, 0])
        )
    if impairment == "weakness":
        share = people.strength_share * interpolate(WEAKNESS_STRENGTH_FRACTIONS, uniforms[:, 0])
        return replace(people, strength_share=share)
    if impairment == "tremor":
        xp, amplitude_rad = (
            get_namespace(uniforms),
            constant_like(MAX_TREMOR_AMPLITUDE_RAD, uniforms) * uniforms[:, 1:],
        )
        return replace(people, tremor_rad=xp.maximum(people.tremor_rad, amplitude_rad))
    if is_clinical_impairment(impairment):
        signs = sample_motor_signs(impairment, uniforms)
        return replace(people, torque_fraction=signs.torque_fraction, damping_n_m_s=signs.damping_n_m_s)
    return people


def limit_joint_ranges(people: People, share: FloatArray) -> People:
    """Returns people with joint ranges that are the share (n,) of the full ranges. The pose is clipped to these
    ranges.
    """
    limited = replace(people, range_share=share)
    return replace(limited, joint_angles_rad=clip_to_joint_ranges(limited, people.joint_angles_rad))


def clip_to_joint_ranges(people: People, joint_angles_rad: FloatArray) -> FloatArray:
    """Returns joint angles (..., n, 20), clipped to the joint ranges of ``people``."""
    share = people.range_share[:, None]
    lower, upper = (
        share * constant_like(LOWER_LIMITS_RAD, share),
        share * constant_like(UPPER_LIMITS_RAD, share),
    )
    return get_namespace(joint_angles_rad).clip(joint_angles_rad, lower, upper)
