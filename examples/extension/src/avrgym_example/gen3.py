"""Kinova's Gen3, seven joints, on the wheelchair: from its URDF, with the hand of the Gen3 lite."""

from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models.furniture import NIGHTSTAND_BODY, NIGHTSTAND_TOP_M, add_bracket, add_nightstand
from avrgym.models.robot import BaseRange, Grip, Mount, Robot, tuned_arm
from avrgym.models.urdf import Urdf
from avrgym.robots.rtb_data import rtb_data_path

KORTEX = rtb_data_path("kortex_description")
ARM_MESHES = {
    "base_link": "base_link",
    "Shoulder_Link": "shoulder_link",
    "HalfArm1_Link": "half_arm_1_link",
    "HalfArm2_Link": "half_arm_2_link",
    "ForeArm_Link": "forearm_link",
    "SphericalWrist1_Link": "spherical_wrist_1_link",
    "SphericalWrist2_Link": "spherical_wrist_2_link",
    "Bracelet_Link": "bracelet_no_vision_link",
}
HAND_MESHES = {
    "GRIPPER_FRAME": "gripper_base_link",
    "RIGHT_FINGER_PROX": "right_finger_prox_link",
    "RIGHT_FINGER_DIST": "right_finger_dist_link",
    "LEFT_FINGER_PROX": "left_finger_prox_link",
    "LEFT_FINGER_DIST": "left_finger_dist_link",
}


def description(folder: str, file: str, meshes: dict[str, str]) -> Urdf:
    """A URDF with mesh names mapped to those of the package."""
    return Urdf(
        (KORTEX / folder / "urdf" / file).read_text(),
        lambda name: KORTEX / folder / "meshes" / f"{meshes[Path(name).stem]}.STL",
    )


ARM = description("arms/gen3/7dof", "GEN3_URDF_V12.urdf", ARM_MESHES)
HAND = description("grippers/gen3_lite_2f", "GEN3-LITE-GRIPPER_URDF_SIMPLIFIED_V2.urdf", HAND_MESHES)
JOINTS = tuple(f"Actuator{i}" for i in range(1, 8))


def build(appearance: bool) -> mujoco.MjSpec:
    """The arm with the hand on its flange."""
    arm = ARM.spec(appearance=appearance)
    arm.attach(
        HAND.spec(appearance=appearance), prefix="hand/", frame=arm.body("EndEffector_Link").add_frame()
    )
    return arm


SPEED, TORQUE = ARM.limits(JOINTS)
SEED_DEG = (171.0, -72.0, -150.0, -48.0, -1.0, -112.0, -152.0)
_ARM = tuned_arm(
    build, JOINTS, "hand/GRIPPER_FRAME", np.radians(SEED_DEG),
    speed_limit=SPEED, effort_limit=TORQUE, finger_prefix="hand/",
)  # fmt: skip


def fingers(opening_rad: float) -> dict[str, float]:
    """Both fingers opened equally, with parallel tips."""
    return {
        "RIGHT_BOTTOM": opening_rad, "RIGHT_TIP": -opening_rad,
        "LEFT_BOTTOM": -opening_rad, "LEFT_TIP": -opening_rad,
    }  # fmt: skip


BETWEEN_TIPS_M = np.array([0.0, 0.0, 0.142])
POINTING = transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""The tool's x out of the hand, its y across the fingers."""
UPRIGHT = transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation of a cup in a hand with x pointing out of it."""
ACROSS = transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""As ``UPRIGHT``, with z across the fingers."""
ON_WHEELCHAIR_M = (-0.43, -0.44, 0.48)

GEN3 = Robot(
    name="Gen3",
    build=build,
    base="base_link",
    torso="base_link",
    arms={"right": _ARM, "left": _ARM},
    mounts={
        "wheelchair": Mount(
            ON_WHEELCHAIR_M,
            yaw_rad=-0.5 * np.pi,
            carrier=partial(add_bracket, mount_m=ON_WHEELCHAIR_M, shoulder_m=0.30),
        ),
        "bed": Mount(
            NIGHTSTAND_TOP_M,
            yaw_rad=-0.5 * np.pi,
            base_range=BaseRange((-0.1, 0.1), (-0.1, 0.1), (0.0, 0.0)),
            carrier=add_nightstand,
            carrier_body=NIGHTSTAND_BODY,
        ),
    },
    grips={
        "spoon": Grip(BETWEEN_TIPS_M, POINTING, fingers(0.095)),
        "cup": Grip(BETWEEN_TIPS_M, transforms.multiply(POINTING, UPRIGHT), fingers(0.823)),
        "scratcher": Grip(BETWEEN_TIPS_M, POINTING, fingers(0.118)),
        "washcloth": Grip(BETWEEN_TIPS_M, transforms.multiply(POINTING, ACROSS), fingers(0.17)),
    },
)
