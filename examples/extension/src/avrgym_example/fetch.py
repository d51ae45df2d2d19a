"""Fetch Robotics' Fetch, seven joints and a parallel gripper on a mobile base: from its URDF."""

import re
from pathlib import Path

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models.robot import BaseRange, Grip, Mount, Robot, make_arm_with_servo_gains
from avrgym.models.urdf import Urdf
from avrgym.robots.rtb_data import find_rtb_data_path

FOLDER = find_rtb_data_path("fetch_description")
JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "upperarm_roll_joint", "elbow_flex_joint", "forearm_roll_joint",
    "wrist_flex_joint", "wrist_roll_joint",
)  # fmt: skip
FINGERS = ("l_gripper_finger_joint", "r_gripper_finger_joint")


def _text() -> str:
    """The URDF. Its fingers get a slide and an inertia that is possible."""
    text = (FOLDER / "robots" / "fetch.urdf").read_text()
    text = re.sub(r'(name="[lr]_gripper_finger_joint" type=)"fixed"', r'\1"prismatic"', text)
    return re.sub(r'(ixx|iyy|izz)="(?:0|0\.002)"', r'\1="0.0001"', text)


def _find_mesh(name: str) -> Path:
    """A mesh for collisions instead of its detailed one, where there is one."""
    file = FOLDER / "meshes" / Path(name).name
    coarse = file.with_name(f"{file.stem}_collision.STL")
    return coarse if coarse.exists() else file


FETCH_URDF = Urdf(_text(), _find_mesh)


def build(appearance: bool) -> mujoco.MjSpec:
    """The robot with its gripper."""
    return FETCH_URDF.build_spec(appearance=appearance)


SPEED, TORQUE = FETCH_URDF.read_joint_limits(JOINTS)
SEED_POSE_DEG = (0.0, 0.0, 0.0, 90.0, 0.0, -90.0, 0.0)
_ARM = make_arm_with_servo_gains(
    build, JOINTS, "gripper_link", np.radians(SEED_POSE_DEG), speed_limit=SPEED, effort_limit=TORQUE
)


def fingers(opening_m: float) -> dict[str, float]:
    """Both fingers at this distance from the middle."""
    return dict.fromkeys(FINGERS, opening_m)


GRIP_POINT_M = np.zeros(3)
CUP_ROTATION = transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""The cup's x across the fingers."""
WASHCLOTH_ROTATION = transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The washcloth's z across the fingers."""
NEXT_TO_PERSON = Mount((-0.85, -0.6, 0.0), 0.0, BaseRange((-0.4, 0.1), (-0.4, 0.5), (-0.5, 0.5)))

FETCH = Robot(
    name="Fetch",
    build=build,
    base="base0",
    torso="torso_lift_link",
    arms={"right": _ARM, "left": _ARM},
    mounts={"wheelchair": NEXT_TO_PERSON, "bed": NEXT_TO_PERSON},
    grips={
        "spoon": Grip(GRIP_POINT_M, transforms.IDENTITY_QUATERNION, fingers(0.0045)),
        "cup": Grip(GRIP_POINT_M, CUP_ROTATION, fingers(0.0415)),
        "scratcher": Grip(GRIP_POINT_M, transforms.IDENTITY_QUATERNION, fingers(0.0056)),
        "washcloth": Grip(GRIP_POINT_M, WASHCLOTH_ROTATION, fingers(0.012)),
    },
    base_half_width_m=0.3,
    fixed_joint_positions={"torso_lift_joint": 0.2},
)
