"""The Gen3. ``gen3.xml`` contains the kinematics, ``rtb-data`` the meshes."""

from functools import partial
from importlib.resources import files

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models.furniture import NIGHTSTAND_BODY, NIGHTSTAND_TOP_M, add_bracket, add_nightstand
from avrgym.models.robot import BaseRange, Mount, Robot, tuned_arm
from avrgym.robots.parallel_gripper import parallel_grips
from avrgym.robots.rtb_data import rtb_data_path

JOINTS = tuple(f"joint_{i}" for i in range(1, 8))
ON_WHEELCHAIR_M = (-0.40, -0.50, 0.50)
SHOULDER_M = 0.30
"""Maximum height of the shoulder above the arm's mount."""


def build(appearance: bool) -> mujoco.MjSpec:
    """Returns the model of the arm with its hand."""
    spec = mujoco.MjSpec.from_string(files("avrgym.robots.gen3").joinpath("gen3.xml").read_text())
    spec.meshdir = str(rtb_data_path("kortex_description"))
    return spec


SPEED_DEG_S = 50.0
TORQUE_N_M = (39.0, 39.0, 39.0, 39.0, 9.0, 9.0, 9.0)
"""Limits of Kinova's description (GEN3_URDF_V12)."""
SEED_DEG = (171.0, -72.0, -150.0, -48.0, -1.0, -112.0, -152.0)
_ARM = tuned_arm(
    build, JOINTS, "hand", np.radians(SEED_DEG),
    speed_limit=np.radians(SPEED_DEG_S), effort_limit=TORQUE_N_M,
)  # fmt: skip
BETWEEN_TIPS_M, TIP_END_M = (0.0, 0.0, 0.142), 0.0192
POINTING = transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""Rotation of a tool in the hand: its x axis points out of the hand, its y axis is across the fingers."""


def _fingers(opening_rad: float) -> dict[str, float]:
    """Joint positions of both fingers, opened by the same angle, with parallel tips."""
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
    mounts={
        "wheelchair": Mount(
            ON_WHEELCHAIR_M,
            yaw_rad=-0.5 * np.pi,
            carrier=partial(add_bracket, mount_m=ON_WHEELCHAIR_M, shoulder_m=SHOULDER_M),
        ),
        "bed": Mount(
            NIGHTSTAND_TOP_M,
            yaw_rad=-0.5 * np.pi,
            base_range=BaseRange((-0.1, 0.1), (-0.1, 0.1), (0.0, 0.0)),
            carrier=add_nightstand,
            carrier_body=NIGHTSTAND_BODY,
        ),
    },
    grips=parallel_grips(
        BETWEEN_TIPS_M,
        TIP_END_M,
        POINTING,
        spoon=_fingers(0.095),
        cup=_fingers(0.823),
        scratcher=_fingers(0.118),
        washcloth=_fingers(0.17),
    ),
)
