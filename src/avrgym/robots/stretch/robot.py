"""Robot record of Stretch 3. ``stretch.xml`` contains the kinematics, the package ``hello-robot-stretch-urdf`` the
meshes.
"""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np

from avrgym.models.drive import DifferentialDrive
from avrgym.models.robot import Arm, BaseRange, CameraMount, Grip, Mount, Robot
from avrgym.robots.parallel_gripper import TOOL_ROTATIONS
from avrgym.system.optional_robots import MESH_PACKAGE_BY_ROBOT

ROBOT_MASS_KG, GRAVITY_M_S2, WHEEL_FRICTION_COEFFICIENT = 24.8, 9.81, 0.6


def build(appearance: bool) -> mujoco.MjSpec:
    """Returns the MuJoCo model of the robot; its arm extends to its right.

    ``appearance``: whether to add visual geoms.
    """
    spec = mujoco.MjSpec.from_string(files("avrgym.robots.stretch").joinpath("stretch.xml").read_text())
    spec.meshdir = str(Path(str(files(MESH_PACKAGE_BY_ROBOT["Stretch"]))) / "SE3" / "meshes")
    return spec


def _closed(angle_rad: float) -> dict[str, float]:
    """Returns the joint positions of both fingers, closed by the same angle."""
    return {f"joint_gripper_finger_{side}": angle_rad for side in ("left", "right")}


GRIPS: Mapping[str, Grip] = {
    tool: Grip(np.array(pos), TOOL_ROTATIONS[tool], _closed(angle_rad))
    for tool, pos, angle_rad in (
        ("spoon", (0.0, 0.0, -0.0065), 0.008),
        ("cup", (0.0, 0.0, 0.0), 0.2),
        ("washcloth", (-0.01, 0.0, 0.0), 0.01),
        ("scratcher", (-0.031, 0.0, 0.0), 0.03),
    )
}
"""Grips by tool: the pose of the tool in the hand, and the finger angles. The gap between fingertips and tool is at
most 3 mm.
"""

_ARM = Arm(
    joints=("joint_lift", "joint_arm", "joint_wrist_yaw", "joint_wrist_pitch", "joint_wrist_roll"),
    end_effector="grasp_center",
    # Lift: the maximum of Hello Robot's parameters (stretch_body, robot_params_SE3.py). Arm: reduced speed of
    # ISO 10218-1; the maximum is 0.4 m/s. Wrist: the Jaco's fastest joints.
    speed_limit=np.array([0.15, 0.25, *np.radians([48.0, 48.0, 48.0])]),
    # Slides: force per ampere times the maximum current of the same file. Yaw and pitch: the payload of 2 kg at the
    # grasp centre, 0.25 m from the pitch axis. Roll: an assumption.
    effort_limit=np.array([326.0, 243.0, 5.0, 5.0, 2.0]),
    stiffness=np.array([1900.0, 1000.0, 60.0, 60.0, 40.0]),
    inertia=np.array([4.84, 2.34, 0.031, 0.028, 0.025]),
    seed_pose=np.array([0.8, 0.25, 1.2, 0.0, 0.0]),
)

DRIVE = DifferentialDrive(
    speed_limit_m_s=0.3,
    turn_limit_rad_s=0.5,
    track_width_m=0.3407,
    force_limit_n=40.0,
    lateral_force_limit_n=WHEEL_FRICTION_COEFFICIENT * ROBOT_MASS_KG * GRAVITY_M_S2,
)
"""Differential drive. Source of the maximum speed: Stretch's robot_params_SE3.py; of the track width: the wheel joints
in Stretch's URDF. The turn rate, the force (an acceleration of 1.6 m/s²) and the friction are assumptions.
"""


def _mount(x_m: float, y_m: float, along_m: float) -> Mount:
    """Returns a mount next to the person. The arm extends towards the person; the base moves along their side."""
    return Mount(
        (x_m, y_m, 0.0),
        0.5 * np.pi,
        BaseRange((-0.15, 0.05), (-along_m, along_m), (-0.4, 0.4)),
        left_yaw_rad=-0.5 * np.pi,
    )


STRETCH = Robot(
    name="Stretch",
    build=build,
    base="base",
    torso="base",
    arms={"right": _ARM, "left": _ARM},
    mounts={
        "wheelchair": _mount(-0.62, -0.5, along_m=0.35),
        "bed": _mount(-0.72, -0.4, along_m=0.4),
    },
    grips=GRIPS,
    base_half_width_m=0.18,
    drive=DRIVE,
    cameras={
        # The colour camera of the RealSense D435i at the head's pose in stretch.xml. It is mounted on its side: its 69°
        # are vertical. Images are upright.
        "head": CameraMount("base", (0.019, -0.042, 1.300), (0.318, -0.818, -0.479), (0.0, 0.0, 1.0), 69.0)
    },
)
