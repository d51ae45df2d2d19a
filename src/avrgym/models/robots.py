"""The robots: our kinematic descriptions and the public meshes of ``rtb-data``."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import rtbdata
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.models import contacts

PREFIX = "robot/"


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot with one moving arm.

    ``arm_joints`` are named as in the model file. ``speed_limit_rad_s`` and ``torque_limit_n_m`` (7,) are
    those of the public description. ``inertia_kg_m2`` (7,) is what each joint has to turn at the seed pose,
    its motor included; its servo is tuned for it. ``hand_q`` turns the end effector's frame into the frame of
    tools held across the palm like a rod (x towards the tool, z up when the hand reaches in from the side).
    ``finger_angles_rad`` turns bodies of the fingers so that their tips hold a handle. ``seed_pose_rad`` (7,) is
    a pose with free space around it, where inverse kinematics starts.
    """

    name: str
    file: str
    mesh_folder: str
    base: str
    end_effector: str
    arm_joints: tuple[str, ...]
    speed_limit_rad_s: NDArray[np.float64]
    torque_limit_n_m: NDArray[np.float64]
    stiffness_n_m_rad: NDArray[np.float64]
    inertia_kg_m2: NDArray[np.float64]
    hand_q: NDArray[np.float64]
    finger_angles_rad: Mapping[str, float]
    seed_pose_rad: NDArray[np.float64]


JACO = Robot(
    name="Jaco",
    file="jaco.xml",
    mesh_folder="xacro/kinova_description/meshes",
    base="base",
    end_effector="end_effector",
    arm_joints=tuple(f"joint_{i}" for i in range(1, 8)),
    speed_limit_rad_s=np.radians([36.0, 36.0, 36.0, 36.0, 48.0, 48.0, 48.0]),
    torque_limit_n_m=np.array([40.0, 80.0, 40.0, 40.0, 20.0, 20.0, 20.0]),
    stiffness_n_m_rad=np.array([300.0, 300.0, 200.0, 200.0, 80.0, 80.0, 80.0]),
    inertia_kg_m2=np.array([0.55, 0.92, 0.40, 0.37, 0.076, 0.085, 0.051]),
    hand_q=transforms.multiply(
        transforms.from_matrix([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
        transforms.from_axis_angle([1.0, 0.0, 0.0], np.radians(30.0)),
    ),
    finger_angles_rad={
        "finger_1": 1.40,
        "finger_tip_1": 0.40,
        "finger_2": 1.05,
        "finger_tip_2": 0.35,
        "finger_3": 1.20,
        "finger_tip_3": 0.30,
    },
    seed_pose_rad=np.radians([-173.0, 259.0, 0.0, 269.0, 89.0, 121.0, 79.0]),
)

ROBOTS: Mapping[str, Robot] = {robot.name: robot for robot in (JACO,)}


def find_robot(name: str) -> Robot:
    """The robot of that name.

    Raises:
        ValueError: naming the robots there are.
    """
    if name not in ROBOTS:
        raise ValueError(f"unknown robot {name!r}; the robots are {', '.join(ROBOTS)}")
    return ROBOTS[name]


def mesh_path(robot: Robot) -> Path:
    """The folder of the robot's meshes inside the installed ``rtb-data``."""
    return Path(next(iter(rtbdata.__path__))) / robot.mesh_folder


def robot_spec(robot: Robot, *, appearance: bool) -> mujoco.MjSpec:
    """The robot alone: fingers closed, contact bits set, a velocity servo on each arm joint.

    The servo integrates its command into a target angle, never past the joint's range, and pulls the joint
    there like a spring of ``stiffness_n_m_rad`` with critical damping at the seed pose, within the motor's
    torque. (MuJoCo's own damping ratio holds at angle zero, where the arm is folded and five times lighter to
    turn: it lets the arm overshoot.)
    """
    spec = mujoco.MjSpec.from_string(files("avrgym.models").joinpath("assets", robot.file).read_text())
    spec.meshdir = str(mesh_path(robot))
    for geom in list(spec.geoms):
        if geom.group == contacts.VISUAL_GROUP:
            if not appearance:
                spec.delete(geom)
        else:
            geom.contype, geom.conaffinity = contacts.ROBOT.contype, contacts.ROBOT.conaffinity
    if not appearance:
        for mesh in list(spec.meshes):
            spec.delete(mesh)
    _close_fingers(spec, robot)
    _add_servos(spec, robot)
    return spec


def _close_fingers(spec: mujoco.MjSpec, robot: Robot) -> None:
    for name, angle in robot.finger_angles_rad.items():
        body = spec.body(name)
        turn = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(angle))
        body.quat = transforms.multiply(_orientation(body), turn)
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _orientation(body: mujoco.MjsBody) -> NDArray[np.float64]:
    """A body's quaternion (4,), whether the file gives it as such or as angles about fixed axes."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return np.array(body.quat)
    orientation = np.zeros(4)
    mujoco.mju_euler2Quat(orientation, np.asarray(body.alt.euler, float), "XYZ")
    return orientation


def _add_servos(spec: mujoco.MjSpec, robot: Robot) -> None:
    damping = 2.0 * np.sqrt(robot.stiffness_n_m_rad * robot.inertia_kg_m2)
    limits = zip(
        robot.arm_joints,
        robot.speed_limit_rad_s,
        robot.torque_limit_n_m,
        robot.stiffness_n_m_rad,
        damping,
        strict=True,
    )
    for joint, speed, torque, kp, kv in limits:
        actuator = spec.add_actuator(
            name=joint,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=joint,
            ctrlrange=[-speed, speed],
            forcerange=[-torque, torque],
            actrange=spec.joint(joint).range,
            actlimited=True,
        )
        actuator.set_to_intvelocity(kp=kp, kv=kv)
