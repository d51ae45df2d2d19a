"""Robot record of the Gen3. ``gen3.xml`` contains the kinematics, the package ``rtb-data`` the meshes."""

from importlib.resources import files

import mujoco
import numpy as np

from avrgym.models.robot import Robot, make_arm_with_servo_gains
from avrgym.robots.mounts import make_furniture_mounts
from avrgym.robots.parallel_gripper import SPOON_ROTATION, make_parallel_grips
from avrgym.robots.rtb_data import find_rtb_data_path

ROBOT_ARM_JOINTS = tuple(f"joint_{i}" for i in range(1, 8))
BASE_POS_W, LEFT_BASE_POS_W = (-0.40, -0.50, 0.50), (0.40, -0.50, 0.40)
"""Positions of the base on the person's right and left, world frame, metres. The left base is lower. This leaves space
for the robot's elbow in front of a stretched arm of the person.
"""
MAX_SHOULDER_HEIGHT_M = 0.30
"""Maximum height of the robot's shoulder above the mount, in metres."""


def build(appearance: bool) -> mujoco.MjSpec:
    """Returns the MuJoCo model of the arm with its hand. ``appearance``: whether to add visual geoms."""
    spec = mujoco.MjSpec.from_string(files("avrgym.robots.gen3").joinpath("gen3.xml").read_text())
    spec.meshdir = str(find_rtb_data_path("kortex_description"))
    return spec


SPEED_LIMIT_DEG_S = 50.0
TORQUE_LIMITS_N_M = (39.0, 39.0, 39.0, 39.0, 9.0, 9.0, 9.0)
"""Torque limits of the seven joints (Kinova's description GEN3_URDF_V12)."""
SEED_POSE_DEG = (171.0, -72.0, -150.0, -48.0, -1.0, -112.0, -152.0)
_ARM = make_arm_with_servo_gains(
    build, ROBOT_ARM_JOINTS, "hand", np.radians(SEED_POSE_DEG),
    speed_limit=np.radians(SPEED_LIMIT_DEG_S), effort_limit=TORQUE_LIMITS_N_M,
)  # fmt: skip
GRIP_POINT_M, FINGERTIP_LENGTH_M = (0.0, 0.0, 0.142), 0.0192


def _fingers(opening_rad: float) -> dict[str, float]:
    """Returns the joint positions of both fingers, opened by the same angle, with parallel tips."""
    return {
        "right_finger": opening_rad, "right_fingertip": -opening_rad,
        "left_finger": -opening_rad, "left_fingertip": -opening_rad,
    }  # fmt: skip


GEN3 = Robot(
    name="Gen3",
    build=build,
    base="base",
    torso="base",
    arms={"right": _ARM, "left": _ARM},
    mounts=make_furniture_mounts(BASE_POS_W, MAX_SHOULDER_HEIGHT_M, LEFT_BASE_POS_W),
    grips=make_parallel_grips(
        GRIP_POINT_M,
        FINGERTIP_LENGTH_M,
        SPOON_ROTATION,
        spoon=_fingers(0.095),
        cup=_fingers(0.823),
        scratcher=_fingers(0.118),
        washcloth=_fingers(0.17),
    ),
)
