"""Robot record of the UR5. ``ur5.xml`` contains the kinematics, the package ``rtb-data`` the meshes."""

from collections.abc import Mapping
from importlib.resources import files

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models.body_names import Side
from avrgym.models.robot import ROBOT_ARM_SIDES, Arm, Robot, make_arm_with_servo_gains
from avrgym.robots.mounts import STAND_BODY, STAND_HALF_WIDTH_M, add_stand, make_stand_mount
from avrgym.robots.parallel_gripper import make_parallel_grips
from avrgym.robots.rtb_data import add_meshes

MESH_FOLDER = "ur_description/meshes/ur5/visual"
MESH_LINKS = ("base", "shoulder", "upperarm", "forearm", "wrist1", "wrist2", "wrist3")
ROBOT_ARM_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
STAND_HEIGHT_M = 0.65


def build(appearance: bool) -> mujoco.MjSpec:
    """Returns the MuJoCo model of the arm with a parallel gripper, on the stand. ``appearance``: whether to add visual
    geoms.
    """
    spec = mujoco.MjSpec.from_string(files("avrgym.robots.ur5").joinpath("ur5.xml").read_text())
    if appearance:
        add_meshes(spec, MESH_FOLDER, {link: f"{link}.dae" for link in MESH_LINKS})
    add_stand(spec, "base", STAND_HEIGHT_M, appearance=appearance)
    return spec


SPEED_LIMITS_DEG_S = (36.0, 36.0, 36.0, 48.0, 48.0, 48.0)
TORQUE_LIMITS_N_M = (20.0, 20.0, 20.0, 10.0, 10.0, 10.0)
"""Torque limits of the six joints, reduced below those of the Jaco because a person is near (assumption). The public
description of the robot allows 150 and 28 N m.
"""
SEED_POSE_DEG: Mapping[Side, tuple[float, ...]] = {
    "right": (142.0, -125.0, -59.0, 4.0, -142.0, 0.0),
    "left": (-84.0, -97.0, -83.0, -96.0, 45.0, 9.0),
}
"""Initial poses (6,) of the inverse kinematics in degrees, by arm."""


def _arm(side: Side) -> Arm:
    return make_arm_with_servo_gains(
        build, ROBOT_ARM_JOINTS, "hand", np.radians(SEED_POSE_DEG[side]),
        speed_limit=np.radians(SPEED_LIMITS_DEG_S), effort_limit=TORQUE_LIMITS_N_M,
    )  # fmt: skip


GRIP_POINT_M, FINGERTIP_LENGTH_M = (0.13, 0.0, 0.0), 0.015


def _fingers(opening_m: float) -> dict[str, float]:
    """Returns the joint positions of both fingers by name: their distance from the middle of the hand, metres."""
    return {"finger_left": opening_m, "finger_right": opening_m}


UR5 = Robot(
    name="UR5",
    build=build,
    base=STAND_BODY,
    torso=STAND_BODY,
    arms={side: _arm(side) for side in ROBOT_ARM_SIDES},
    mounts={"wheelchair": make_stand_mount(-0.78, -0.65), "bed": make_stand_mount(-0.7, -0.65)},
    grips=make_parallel_grips(
        GRIP_POINT_M,
        FINGERTIP_LENGTH_M,
        transforms.IDENTITY_QUATERNION,
        spoon=_fingers(0.0045),
        cup=_fingers(0.042),
        scratcher=_fingers(0.0056),
        washcloth=_fingers(0.0098),
    ),
    base_half_width_m=STAND_HALF_WIDTH_M,
)
