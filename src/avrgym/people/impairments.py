"""What keeps simulated people from moving as they want, as the 2020 reference offers it."""

from dataclasses import replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import constant_like, interpolate, namespace
from avrgym.models.human import JOINTS, LOWER_RAD, UPPER_RAD, People
from avrgym.people.population_names import IMPAIRMENTS, Impairment

MOVING_IMPAIRMENTS: tuple[Impairment, ...] = ("weakness", "tremor")
"""Those that show only in people whose joints move."""

NUM_UNIFORMS = 1 + len(JOINTS)
RANGE_SHARE, STRENGTH_SHARE = (0.5, 1.0), (0.25, 1.0)
TREMOR_TARGET_RAD = np.array(
    [np.radians({"torso": 0.0, "head": 20.0}.get(joint.body, 10.0)) for joint in JOINTS.values()]
)
"""How far the reference sends each joint to and fro at most, either way: head 20°, arms 10°."""
_STEP_RESPONSE = 1.0 - (1.0 - 0.05) ** 5
"""Of the way to its target a person's joint goes so much there in a control step: five steps of physics, in each of
which the motor closes a twentieth of the gap at most (Assistive Gym 1.0: ``motor_gains``, ``frame_skip``)."""
TREMOR_AMPLITUDE_RATIO = _STEP_RESPONSE / (2.0 - _STEP_RESPONSE)
"""So much of an alternating target's extent the joint comes to, about an eighth: it goes 2 a = share (target + a)."""
TREMOR_RAD = TREMOR_AMPLITUDE_RATIO * TREMOR_TARGET_RAD
"""How far each joint trembles at most, either way: head 2.5°, arms 1.3°."""


def find_impairment(name: str) -> Impairment:
    """The impairment of that name.

    Raises:
        ValueError: naming the impairments there are.
    """
    if name not in IMPAIRMENTS:
        raise ValueError(f"unknown impairment {name!r}; the impairments are {', '.join(IMPAIRMENTS)}")
    return name


def apply_impairment(people: People, impairment: Impairment, uniforms: FloatArray) -> People:
    """The same people with an impairment, drawn from uniform numbers (n, ``NUM_UNIFORMS``).

    ``limits``: joint ranges, and the pose, shrink to a share U(0.5, 1); ``weakness``: the joints' torque to a
    share U(0.25, 1); ``tremor``: joints alternate as the reference's do that are sent to and fro by U(0, 20°) for the
    head and U(0, 10°) for the arms, see ``TREMOR_AMPLITUDE_RATIO``, or by what they trembled before where that is more.
    """
    if impairment == "limits":
        return limit_joint_ranges(people, people.range_share * interpolate(RANGE_SHARE, uniforms[:, 0]))
    if impairment == "weakness":
        share = people.strength_share * interpolate(STRENGTH_SHARE, uniforms[:, 0])
        return replace(people, strength_share=share)
    if impairment == "tremor":
        xp, drawn = namespace(uniforms), constant_like(TREMOR_RAD, uniforms) * uniforms[:, 1:]
        return replace(people, tremor_rad=xp.maximum(people.tremor_rad, drawn))
    return people


def limit_joint_ranges(people: People, share: FloatArray) -> People:
    """The same people with so much (n,) of the joints' full ranges, and in a pose within them."""
    limited = replace(people, range_share=share)
    return replace(limited, joint_angles_rad=clip_to_ranges(limited, people.joint_angles_rad))


def clip_to_ranges(people: People, joint_angles_rad: FloatArray) -> FloatArray:
    """Joint angles (n, 20) brought into the people's ranges."""
    share = people.range_share[:, None]
    lower, upper = share * constant_like(LOWER_RAD, share), share * constant_like(UPPER_RAD, share)
    return namespace(joint_angles_rad).clip(joint_angles_rad, lower, upper)
