"""Robot record of the Jaco. ``jaco.xml`` contains the kinematics, the package ``rtb-data`` the meshes (j2s7s300)."""

from collections.abc import Mapping
from importlib.resources import files

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models.robot import Arm, Grip, Robot
from avrgym.robots.mounts import make_furniture_mounts
from avrgym.robots.rtb_data import find_rtb_data_path

MESH_FOLDER = find_rtb_data_path("kinova_description/meshes")
MAX_SHOULDER_HEIGHT_M = 0.33
"""Maximum height of the robot's shoulder above the mount, in metres."""
BASE_POS_W = (-0.35, -0.30, 0.36)


def build(appearance: bool) -> mujoco.MjSpec:
    """Returns the MuJoCo model of the arm with its hand. ``appearance``: whether to add visual geoms."""
    spec = mujoco.MjSpec.from_string(files("avrgym.robots.jaco").joinpath("jaco.xml").read_text())
    spec.meshdir = str(MESH_FOLDER)
    return spec


def _three_fingers(*bends_rad: tuple[float, float]) -> dict[str, float]:
    """Returns joint angles by name, for the angles of each finger and its tip (thumb first)."""
    return {
        f"finger_{part}{number}": bend
        for number, bends in enumerate(bends_rad, start=1)
        for part, bend in zip(("", "tip_"), bends, strict=True)
    }


GRIPS: Mapping[str, Grip] = {
    "spoon": Grip(
        pos=np.zeros(3),
        quat=transforms.multiply(
            transforms.from_matrix([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
            transforms.from_axis_angle([1.0, 0.0, 0.0], np.radians(30.0)),
        ),
        finger_joint_positions=_three_fingers((1.40, 0.40), (1.05, 0.35), (1.20, 0.30)),
    ),
    "cup": Grip(
        pos=np.zeros(3),
        quat=transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        finger_joint_positions=_three_fingers((0.54, 0.61), (0.38, 0.78), (0.59, 0.50)),
    ),
    "washcloth": Grip(
        pos=np.zeros(3),
        quat=transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        finger_joint_positions=_three_fingers((1.40, -0.30), (1.30, -0.20), (1.30, -0.20)),
    ),
    "scratcher": Grip(
        pos=np.zeros(3),
        quat=transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        finger_joint_positions=_three_fingers((1.15, 0.30), (1.23, 0.30), (1.23, 0.30)),
    ),
}
"""Grips by tool: the pose of the tool in the hand, and the finger angles. The gap between fingertips and tool is at
most 3 mm.
"""


_ARM = Arm(
    joints=tuple(f"joint_{i}" for i in range(1, 8)),
    end_effector="end_effector",
    speed_limit=np.radians([36.0, 36.0, 36.0, 36.0, 48.0, 48.0, 48.0]),
    effort_limit=np.array([40.0, 80.0, 40.0, 40.0, 20.0, 20.0, 20.0]),
    stiffness=np.array([300.0, 300.0, 200.0, 200.0, 80.0, 80.0, 80.0]),
    inertia=np.array([0.55, 0.92, 0.40, 0.37, 0.076, 0.085, 0.051]),
    seed_pose=np.radians([-173.0, 259.0, 0.0, 269.0, 89.0, 121.0, 79.0]),
)

JACO = Robot(
    name="Jaco",
    build=build,
    base="base",
    torso="base",
    arms={"right": _ARM, "left": _ARM},
    mounts=make_furniture_mounts(BASE_POS_W, MAX_SHOULDER_HEIGHT_M),
    grips=GRIPS,
)
