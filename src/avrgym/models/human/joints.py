"""Actuated joints: axes, ranges, strength, and inertia for the servo gains."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import FloatArray

X_AXIS, Y_AXIS, Z_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Joint:
    """A hinge joint: body, axis in the body's frame, range in degrees and torque limit (N m).

    Ranges are those of the paper's code, with its wider range of shoulder abduction in VR. Torques are rounded
    isometric maxima of healthy adults (Chaffin, Andersson and Martin, *Occupational Biomechanics*, 2006).
    """

    body: str
    axis: tuple[float, float, float]
    lower_limit_deg: float
    upper_limit_deg: float
    torque_limit_n_m: float


def _arm(side: str) -> dict[str, Joint]:
    right = side == "right"
    shoulder_y = (-180.0, 198.0) if right else (-198.0, 180.0)
    wrist_y = (-27.0, 47.0) if right else (-47.0, 27.0)
    return {
        f"{side}_shoulder_y": Joint(f"{side}_upper_arm", Y_AXIS, *shoulder_y, 60.0),
        f"{side}_shoulder_x": Joint(f"{side}_upper_arm", X_AXIS, -188.0, 61.0, 60.0),
        f"{side}_shoulder_z": Joint(f"{side}_upper_arm", Z_AXIS, -90.0, 90.0, 40.0),
        f"{side}_elbow_x": Joint(f"{side}_forearm", X_AXIS, -128.0, 0.0, 50.0),
        f"{side}_forearm_z": Joint(f"{side}_forearm", Z_AXIS, -90.0, 90.0, 10.0),
        f"{side}_wrist_x": Joint(f"{side}_hand", X_AXIS, -81.0, 90.0, 10.0),
        f"{side}_wrist_y": Joint(f"{side}_hand", Y_AXIS, *wrist_y, 10.0),
    }


JOINTS: Mapping[str, Joint] = {
    "waist_x": Joint("torso", X_AXIS, -30.0, 75.0, 200.0),
    "waist_y": Joint("torso", Y_AXIS, -30.0, 30.0, 150.0),
    "waist_z": Joint("torso", Z_AXIS, -30.0, 30.0, 100.0),
    "head_x": Joint("head", X_AXIS, -50.0, 50.0, 30.0),
    "head_y": Joint("head", Y_AXIS, -34.0, 34.0, 30.0),
    "head_z": Joint("head", Z_AXIS, -70.0, 70.0, 20.0),
    **_arm("right"),
    **_arm("left"),
}
"""The 20 actuated joints (paper, section III), in the order of all arrays of joint angles. Hinges of one body are
adjacent; the first of them rotates about an axis that is fixed in the parent body."""

JOINT_INDEX = {name: i for i, name in enumerate(JOINTS)}
LOWER_LIMITS_RAD = np.radians([joint.lower_limit_deg for joint in JOINTS.values()])
UPPER_LIMITS_RAD = np.radians([joint.upper_limit_deg for joint in JOINTS.values()])
JOINT_TORQUE_LIMITS_N_M = np.array([joint.torque_limit_n_m for joint in JOINTS.values()])


JOINT_ARMATURE_KG_M2: Mapping[str, float] = {
    "torso": 0.1, "head": 0.02,
    **{f"{side}_{part}": value for side in ("right", "left")
       for part, value in (("upper_arm", 0.02), ("forearm", 0.01), ("hand", 0.005))},
}  # fmt: skip
SERVO_INERTIA_KG_M2: Mapping[str, float] = {
    "torso": 3.0, "head": 0.07,
    **{f"{side}_{part}": value for side in ("right", "left")
       for part, value in (("upper_arm", 0.25), ("forearm", 0.07), ("hand", 0.012))},
}  # fmt: skip
"""Inertia of each moving body about its joint, including the armature. It determines the servo gains."""


def make_seated_joint_angles(**degrees: float) -> FloatArray:
    """Returns the seated pose (20,) in radians. Keyword arguments replace the angles of joints, in degrees.

    Raises:
        ValueError: for an unknown joint name.
    """
    pose = {"right_elbow_x": -90.0, "left_elbow_x": -90.0} | degrees
    unknown = sorted(set(pose) - set(JOINTS))
    if unknown:
        raise ValueError(f"unknown joint {unknown[0]!r}; allowed: {', '.join(JOINTS)}")
    return np.radians([pose.get(name, 0.0) for name in JOINTS])


SEATED_POSE_RAD = make_seated_joint_angles()
