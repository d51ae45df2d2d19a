"""Robot record of the Panda. ``panda.xml`` contains the kinematics, the package ``rtb-data`` the meshes."""

from collections.abc import Mapping
from importlib.resources import files

import mujoco
import numpy as np

from avrgym.models.body_names import Side
from avrgym.models.robot import ROBOT_ARM_SIDES, Arm, Robot, make_arm_with_servo_gains
from avrgym.robots.mounts import STAND_BODY, STAND_HALF_WIDTH_M, add_stand, make_stand_mount
from avrgym.robots.parallel_gripper import SPOON_ROTATION, make_parallel_grips
from avrgym.robots.rtb_data import add_meshes

MESH_FOLDER = "franka_description/meshes/visual"
MESH_LINKS = (*(f"link{i}" for i in range(8)), "hand")
FINGER_NAMES = ("left_finger", "right_finger")
ROBOT_ARM_JOINTS = tuple(f"joint{i}" for i in range(1, 8))
STAND_HEIGHT_M = 0.55


def build(appearance: bool) -> mujoco.MjSpec:
    """Returns the MuJoCo model of the arm with its hand, on the stand. ``appearance``: whether to add visual geoms."""
    spec = mujoco.MjSpec.from_string(files("avrgym.robots.panda").joinpath("panda.xml").read_text())
    if appearance:
        meshes = {link: f"{link}.dae" for link in MESH_LINKS} | dict.fromkeys(FINGER_NAMES, "finger.dae")
        add_meshes(spec, MESH_FOLDER, meshes)
    add_stand(spec, "link0", STAND_HEIGHT_M, appearance=appearance)
    return spec


SPEED_LIMITS_DEG_S = (36.0, 36.0, 36.0, 36.0, 48.0, 48.0, 48.0)
TORQUE_LIMITS_N_M = (20.0, 20.0, 20.0, 20.0, 10.0, 10.0, 10.0)
"""Torque limits of the seven joints, reduced below those of the Jaco because a person is near (assumption). Franka
Emika's data sheet allows 87 and 12 N m.
"""
SEED_POSE_DEG: Mapping[Side, tuple[float, ...]] = {
    "right": (0.0, -30.0, 0.0, -120.0, 0.0, 100.0, 45.0),
    "left": (51.0, -1.0, 31.0, -110.0, -47.0, 108.0, -127.0),
}
"""Initial poses of the inverse kinematics, by arm. Because of the joint ranges, each arm needs its own pose."""


def _arm(side: Side) -> Arm:
    return make_arm_with_servo_gains(
        build, ROBOT_ARM_JOINTS, "hand", np.radians(SEED_POSE_DEG[side]),
        speed_limit=np.radians(SPEED_LIMITS_DEG_S), effort_limit=TORQUE_LIMITS_N_M,
    )  # fmt: skip


GRIP_POINT_M, FINGERTIP_LENGTH_M = (0.0, 0.0, 0.1034), 0.0089


def _fingers(opening_m: float) -> dict[str, float]:
    """Returns the joint positions of both fingers: their distance from the middle of the hand, at most 0.04 m."""
    return dict.fromkeys(FINGER_NAMES, opening_m)


PANDA = Robot(
    name="Panda",
    build=build,
    base=STAND_BODY,
    torso=STAND_BODY,
    arms={side: _arm(side) for side in ROBOT_ARM_SIDES},
    mounts={"wheelchair": make_stand_mount(-0.7, -0.65), "bed": make_stand_mount(-0.7, -0.65)},
    grips=make_parallel_grips(
        GRIP_POINT_M,
        FINGERTIP_LENGTH_M,
        SPOON_ROTATION,
        spoon=_fingers(0.0045),
        cup=_fingers(0.040),
        scratcher=_fingers(0.0056),
        washcloth=_fingers(0.0098),
    ),
    base_half_width_m=STAND_HALF_WIDTH_M,
)
