"""Universal Robots' UR5, six joints, on its own column: our MJCF with the public meshes (.dae)."""

from importlib.resources import files

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models.robot import BaseRange, Grip, Mount, Robot, tuned_arm
from avrgym.models.urdf import add_mesh, colour_of, read_mesh
from avrgym.robots.rtb_data import rtb_data_path

MESHES = rtb_data_path("ur_description/meshes/ur5/visual")
LINKS = ("base", "shoulder", "upperarm", "forearm", "wrist1", "wrist2", "wrist3")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


def build(appearance: bool) -> mujoco.MjSpec:
    """The arm on its column, with its hand."""
    spec = mujoco.MjSpec.from_string(files("avrgym_example").joinpath("ur5.xml").read_text())
    for link in LINKS if appearance else ():
        for number, part in enumerate(read_mesh(MESHES / f"{link}.dae")):
            add_mesh(spec, spec.body(link), f"{link}_{number}", part, rgb=colour_of(part))
    return spec


SEED_DEG = (142.0, -125.0, -59.0, 4.0, -142.0, 0.0)
_ARM = tuned_arm(
    build, JOINTS, "hand", np.radians(SEED_DEG),
    speed_limit=3.15, effort_limit=[150.0, 150.0, 150.0, 28.0, 28.0, 28.0],
)  # fmt: skip


def fingers(opening_m: float) -> dict[str, float]:
    """Both fingers at this distance from the middle."""
    return {"finger_left": opening_m, "finger_right": opening_m}


BETWEEN_TIPS_M = np.array([0.13, 0.0, 0.0])
UPRIGHT = transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
ACROSS = transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
BESIDE = Mount((-0.7, -0.65, 0.0), 0.0, BaseRange((-0.2, 0.1), (-0.3, 0.5), (-0.5, 0.5)))

UR5 = Robot(
    name="UR5",
    build=build,
    base="stand",
    torso="stand",
    arms={"right": _ARM, "left": _ARM},
    mounts={"wheelchair": BESIDE, "bed": BESIDE},
    grips={
        "spoon": Grip(BETWEEN_TIPS_M, transforms.IDENTITY_QUATERNION, fingers(0.0045)),
        "cup": Grip(BETWEEN_TIPS_M, UPRIGHT, fingers(0.042)),
        "scratcher": Grip(BETWEEN_TIPS_M, transforms.IDENTITY_QUATERNION, fingers(0.0056)),
        "washcloth": Grip(BETWEEN_TIPS_M, ACROSS, fingers(0.0098)),
    },
    half_width_m=0.18,
)
