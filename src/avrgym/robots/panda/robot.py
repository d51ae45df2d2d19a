"""The Panda. ``panda.xml`` contains the kinematics, ``rtb-data`` the meshes."""

from importlib.resources import files

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models.robot import Robot, tuned_arm
from avrgym.robots.parallel_gripper import parallel_grips
from avrgym.robots.rtb_data import add_meshes
from avrgym.robots.stand import HALF_WIDTH_M, STAND_BODY, add_stand, next_to_person

MESHES = "franka_description/meshes/visual"
LINKS = (*(f"link{i}" for i in range(8)), "hand")
FINGERS = ("left_finger", "right_finger")
JOINTS = tuple(f"joint{i}" for i in range(1, 8))
STAND_M = 0.55


def build(appearance: bool) -> mujoco.MjSpec:
    """The arm with its hand, on the stand."""
    spec = mujoco.MjSpec.from_string(files("avrgym.robots.panda").joinpath("panda.xml").read_text())
    if appearance:
        meshes = {link: f"{link}.dae" for link in LINKS} | dict.fromkeys(FINGERS, "finger.dae")
        add_meshes(spec, MESHES, meshes)
    add_stand(spec, "link0", STAND_M, appearance=appearance)
    return spec


SPEED_DEG_S = (150.0, 150.0, 150.0, 150.0, 180.0, 180.0, 180.0)
TORQUE_N_M = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
"""Limits of Franka Emika's data sheet (speed) and of the public description (torque)."""
SEED_DEG = (0.0, -30.0, 0.0, -120.0, 0.0, 100.0, 45.0)
_ARM = tuned_arm(
    build, JOINTS, "hand", np.radians(SEED_DEG),
    speed_limit=np.radians(SPEED_DEG_S), effort_limit=TORQUE_N_M,
)  # fmt: skip
BETWEEN_TIPS_M = (0.0, 0.0, 0.1034)
POINTING = transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""The tool's x out of the hand, its y across the fingers."""


def _fingers(opening_m: float) -> dict[str, float]:
    """Both fingers at this distance from the middle; at most 0.04 m."""
    return dict.fromkeys(FINGERS, opening_m)


PANDA = Robot(
    name="Panda",
    build=build,
    base=STAND_BODY,
    torso=STAND_BODY,
    arms={"right": _ARM, "left": _ARM},
    mounts={"wheelchair": next_to_person(-0.7, -0.65), "bed": next_to_person(-0.7, -0.65)},
    grips=parallel_grips(
        BETWEEN_TIPS_M,
        POINTING,
        spoon=_fingers(0.0045),
        cup=_fingers(0.040),
        scratcher=_fingers(0.0056),
        washcloth=_fingers(0.0098),
    ),
    half_width_m=HALF_WIDTH_M,
)
