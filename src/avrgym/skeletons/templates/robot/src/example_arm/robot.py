"""The robot ExampleArm: seven joints on a column next to the person, with a parallel gripper."""

from importlib.resources import files

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models.robot import BaseRange, Grip, Mount, Robot, make_arm_with_servo_gains

JOINTS = (
    "shoulder_turn", "shoulder_lift", "upper_arm_turn", "elbow", "forearm_turn", "wrist_lift", "wrist_turn",
)  # fmt: skip
SEED_POSE_DEG = (-46.0, 72.0, -18.0, -38.0, -38.0, -106.0, 146.0)
"""Initial pose of the inverse kinematics, close to the initial poses of tasks. `docs/how_to/add_a_robot.md` of AVR Gym
explains the search for such a pose.
"""


def build(appearance: bool) -> mujoco.MjSpec:
    """Returns the model of the arm with column and gripper. It always includes the visual geoms, because they are
    few."""
    return mujoco.MjSpec.from_string(files("example_arm").joinpath("arm.xml").read_text())


def compute_finger_positions(opening_m: float) -> dict[str, float]:
    """Joint positions of both fingers, at this distance from the middle of the hand."""
    return {"finger_left": opening_m, "finger_right": opening_m}


_ARM = make_arm_with_servo_gains(
    build,
    JOINTS,
    "hand",
    np.radians(SEED_POSE_DEG),
    speed_limit=2.0,
    effort_limit=[80.0, 80.0, 60.0, 60.0, 30.0, 30.0, 30.0],
)
GRIP_POINT_M = np.array([0.13, 0.0, 0.0])
CUP_ROTATION = transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation of the cup in the hand: the cup's x axis is across the fingers."""
WASHCLOTH_ROTATION = transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation of the washcloth in the hand: the washcloth's z axis is across the fingers."""
STAND_MOUNT = Mount((-0.7, -0.65, 0.0), 0.0, BaseRange((-0.2, 0.1), (-0.3, 0.5), (-0.5, 0.5)))

ROBOT = Robot(
    name="ExampleArm",
    build=build,
    base="stand",
    torso="stand",
    arms={"right": _ARM, "left": _ARM},
    mounts={"wheelchair": STAND_MOUNT, "bed": STAND_MOUNT},
    grips={
        "spoon": Grip(GRIP_POINT_M, transforms.IDENTITY_QUATERNION, compute_finger_positions(0.0045)),
        "cup": Grip(GRIP_POINT_M, CUP_ROTATION, compute_finger_positions(0.042)),
        "scratcher": Grip(GRIP_POINT_M, transforms.IDENTITY_QUATERNION, compute_finger_positions(0.0056)),
        "washcloth": Grip(GRIP_POINT_M, WASHCLOTH_ROTATION, compute_finger_positions(0.0098)),
    },
    base_half_width_m=0.18,
)
