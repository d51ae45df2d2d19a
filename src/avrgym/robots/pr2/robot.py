"""Robot record of the PR2. ``pr2.xml`` contains the kinematics, the package ``rtb-data`` the meshes."""

from collections.abc import Mapping
from importlib.resources import files

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.body_names import Side
from avrgym.models.robot import ROBOT_ARM_SIDES, Arm, BaseRange, CameraMount, Grip, Mount, Robot
from avrgym.robots.jaco.robot import JACO
from avrgym.robots.rtb_data import find_rtb_data_path

MESH_FOLDER = find_rtb_data_path("pr2_description/meshes")
BASE_POS_M = (-0.85, -0.4, 0.0)
"""Position of the base next to the person, world frame. The robot faces the person's right side (paper's code)."""
BASE_YAW_RANGE_RAD = (-np.radians(30.0), np.radians(30.0))
ROBOT_ARM_JOINTS = (
    "shoulder_pan", "shoulder_lift", "upper_arm_roll", "elbow_flex", "forearm_roll", "wrist_flex", "wrist_roll",
)  # fmt: skip
FIXED_ARM_POSE_RAD = np.array([1.75, 1.25, 1.5, -0.5, 1.0, 0.0, 1.0])
SEED_POSE_RAD = np.array([0.7, 0.2, 1.5, -1.85, -3.1, -1.45, 0.0])
"""Initial pose (7,) of the left arm for the inverse kinematics. The pose of the right arm is mirrored."""
MIRRORED_JOINT_SIGNS = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])


def build(appearance: bool) -> mujoco.MjSpec:
    """Returns the MuJoCo model of the robot with raised torso and tilted head. ``appearance``: whether to add visual
    geoms.
    """
    spec = mujoco.MjSpec.from_string(files("avrgym.robots.pr2").joinpath("pr2.xml").read_text())
    spec.meshdir = str(MESH_FOLDER)
    return spec


def _joints(side: Side) -> tuple[str, ...]:
    return tuple(f"{side[0]}_{joint}_joint" for joint in ROBOT_ARM_JOINTS)


def _pose(side: Side, left_rad: FloatArray) -> FloatArray:
    return left_rad if side == "left" else MIRRORED_JOINT_SIGNS * left_rad


def _arm(side: Side) -> Arm:
    """Returns the arm on one side. Its speed limits are those of the Jaco. The PR2's own limits are too high next to a
    person.
    """
    return Arm(
        joints=_joints(side),
        end_effector=f"{side[0]}_gripper_tool_frame",
        speed_limit=JACO.arms[side].speed_limit,
        effort_limit=np.array([30.0, 30.0, 30.0, 30.0, 30.0, 10.0, 10.0]),
        stiffness=np.array([900.0, 550.0, 220.0, 220.0, 80.0, 80.0, 80.0]),
        inertia=np.array([2.81, 1.395, 0.447, 0.437, 0.0899, 0.0741, 0.0631]),
        seed_pose=_pose(side, SEED_POSE_RAD),
        finger_prefix=f"{side[0]}_gripper_",
    )


def _parallel_fingers(opening_rad: float) -> dict[str, float]:
    """Returns the joint positions of both fingers, opened by the same angle, with parallel tips."""
    return {
        f"{side}_finger_{part}joint": sign * opening_rad
        for side, opened in (("l", 1.0), ("r", -1.0))
        for part, sign in (("", opened), ("tip_", -opened))
    }


GRIPS: Mapping[str, Grip] = {
    "spoon": Grip(
        pos=np.array([0.0, 0.0, -0.0065]),
        quat=transforms.IDENTITY_QUATERNION,
        finger_joint_positions=_parallel_fingers(0.051),
    ),
    "cup": Grip(
        pos=np.zeros(3),
        quat=transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        finger_joint_positions=_parallel_fingers(0.48),
    ),
    "washcloth": Grip(
        pos=np.array([-0.021, 0.0, 0.0]),
        quat=transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
        finger_joint_positions=_parallel_fingers(0.075),
    ),
    "scratcher": Grip(
        pos=np.array([-0.020, 0.0, 0.0]),
        quat=transforms.IDENTITY_QUATERNION,
        finger_joint_positions=_parallel_fingers(0.066),
    ),
}
"""Grips by tool: the pose of the tool in the hand, and the finger positions. The gap between fingertips and tool is at
most 3 mm.
"""


PR2 = Robot(
    name="PR2",
    build=build,
    base="base",
    torso="torso_lift_link",
    arms={side: _arm(side) for side in ROBOT_ARM_SIDES},
    mounts={
        "wheelchair": Mount(BASE_POS_M, 0.0, BaseRange((-0.5, 0.0), (-0.5, 0.5), BASE_YAW_RANGE_RAD)),
        # With a larger y, the raised backrest blocks the arm.
        "bed": Mount(BASE_POS_M, 0.0, BaseRange((-0.5, 0.0), (-0.5, 0.3), BASE_YAW_RANGE_RAD)),
    },
    grips=GRIPS,
    base_half_width_m=0.335,
    fixed_joint_positions={
        joint: float(angle)
        for side in ROBOT_ARM_SIDES
        for joint, angle in zip(_joints(side), _pose(side, FIXED_ARM_POSE_RAD), strict=True)
    },
    cameras={
        # The colour camera of the Kinect above the head: 57° wide at 4 : 3 (kinect_prosilica_camera.urdf.xacro).
        "head": CameraMount("head_tilt_link", (-0.147, -0.018, 0.292), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 44.3)
    },
)
