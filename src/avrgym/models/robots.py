"""The robots: our kinematic descriptions and the public meshes of ``rtb-data``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
import rtbdata
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.models import contacts

PREFIX = "robot/"
MOTORS = 1
"""The group of the moving arm's actuators."""
Side = Literal["right", "left"]


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm that may be the moving one; its joints are named as in the model file.

    ``speed_limit_rad_s`` and ``torque_limit_n_m`` (7,) are those of the public description unless the robot's
    entry says otherwise. ``inertia_kg_m2`` (7,) is what each joint has to turn at the seed pose, its motor
    included; its servo is tuned for it. ``seed_pose_rad`` (7,) is a pose with free space around it, where
    inverse kinematics starts. ``finger_prefix`` stands before the names of the hand's bodies in ``grips``.
    """

    joints: tuple[str, ...]
    end_effector: str
    finger_prefix: str
    speed_limit_rad_s: NDArray[np.float64]
    torque_limit_n_m: NDArray[np.float64]
    stiffness_n_m_rad: NDArray[np.float64]
    inertia_kg_m2: NDArray[np.float64]
    seed_pose_rad: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot, its arms by side, and what observations are relative to: its torso, or its base without one.

    ``mobile`` robots drive to the place they work from, others are mounted; ``half_width_m`` is that of a square
    base on the floor. ``holding_rad`` are the angles of joints that stay as they are while another arm moves.
    """

    name: str
    file: str
    mesh_folder: str
    base: str
    torso: str
    mobile: bool
    half_width_m: float
    arms: Mapping[Side, Arm]
    holding_rad: Mapping[str, float]


_JACO_ARM = Arm(
    joints=tuple(f"joint_{i}" for i in range(1, 8)),
    end_effector="end_effector",
    finger_prefix="",
    speed_limit_rad_s=np.radians([36.0, 36.0, 36.0, 36.0, 48.0, 48.0, 48.0]),
    torque_limit_n_m=np.array([40.0, 80.0, 40.0, 40.0, 20.0, 20.0, 20.0]),
    stiffness_n_m_rad=np.array([300.0, 300.0, 200.0, 200.0, 80.0, 80.0, 80.0]),
    inertia_kg_m2=np.array([0.55, 0.92, 0.40, 0.37, 0.076, 0.085, 0.051]),
    seed_pose_rad=np.radians([-173.0, 259.0, 0.0, 269.0, 89.0, 121.0, 79.0]),
)

JACO = Robot(
    name="Jaco",
    file="jaco.xml",
    mesh_folder="xacro/kinova_description/meshes",
    base="base",
    torso="base",
    mobile=False,
    half_width_m=0.0,
    arms={"right": _JACO_ARM, "left": _JACO_ARM},
    holding_rad={},
)

_SIDES: tuple[Side, ...] = ("right", "left")
_PR2_JOINTS = (
    "shoulder_pan", "shoulder_lift", "upper_arm_roll", "elbow_flex", "forearm_roll", "wrist_flex", "wrist_roll",
)  # fmt: skip
_PR2_HOLDING_RAD = np.array([1.75, 1.25, 1.5, -0.5, 1.0, 0.0, 1.0])
_PR2_SEED_RAD = np.array([0.7, 0.2, 1.5, -1.85, -3.1, -1.45, 0.0])
"""Of the left arm; the right arm's poses are their mirror images."""
_PR2_MIRROR = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])


def _pr2_joints(side: Side) -> tuple[str, ...]:
    return tuple(f"{side[0]}_{joint}_joint" for joint in _PR2_JOINTS)


def _pr2_pose(side: Side, left_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    return left_rad if side == "left" else _PR2_MIRROR * left_rad


def _pr2_arm(side: Side) -> Arm:
    """Its speeds are the Jaco's: the PR2's own, 119 to 206 °/s, are too fast for comfort beside a person."""
    return Arm(
        joints=_pr2_joints(side),
        end_effector=f"{side[0]}_gripper_tool_frame",
        finger_prefix=f"{side[0]}_gripper_",
        speed_limit_rad_s=_JACO_ARM.speed_limit_rad_s,
        torque_limit_n_m=np.array([30.0, 30.0, 30.0, 30.0, 30.0, 10.0, 10.0]),
        stiffness_n_m_rad=np.array([900.0, 550.0, 220.0, 220.0, 80.0, 80.0, 80.0]),
        inertia_kg_m2=np.array([2.81, 1.395, 0.447, 0.437, 0.0899, 0.0741, 0.0631]),
        seed_pose_rad=_pr2_pose(side, _PR2_SEED_RAD),
    )


PR2 = Robot(
    name="PR2",
    file="pr2.xml",
    mesh_folder="xacro/pr2_description/meshes",
    base="base",
    torso="torso_lift_link",
    mobile=True,
    half_width_m=0.335,
    arms={side: _pr2_arm(side) for side in _SIDES},
    holding_rad={
        joint: float(angle)
        for side in _SIDES
        for joint, angle in zip(_pr2_joints(side), _pr2_pose(side, _PR2_HOLDING_RAD), strict=True)
    },
)

ROBOTS: Mapping[str, Robot] = {robot.name: robot for robot in (JACO, PR2)}


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


def robot_spec(robot: Robot, arm: Arm, *, appearance: bool) -> mujoco.MjSpec:
    """The robot alone: contact bits set, a velocity servo on each joint of the arm, all else held.

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
    _hold_other_joints(spec, robot, arm)
    _add_servos(spec, arm)
    _shape_brakes(spec, arm)
    return spec


def turn_body(spec: mujoco.MjSpec, name: str, axis: Sequence[float], angle_rad: float) -> None:
    """Turn a body about an axis of its own frame."""
    body = spec.body(name)
    turn = transforms.from_axis_angle(axis, np.asarray(angle_rad))
    body.quat = transforms.multiply(_orientation(body), turn)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _hold_other_joints(spec: mujoco.MjSpec, robot: Robot, arm: Arm) -> None:
    for joint in [joint for joint in spec.joints if joint.name not in arm.joints]:
        turn_body(spec, joint.parent.name, joint.axis, robot.holding_rad[joint.name])
        spec.delete(joint)


def _orientation(body: mujoco.MjsBody) -> NDArray[np.float64]:
    """A body's quaternion (4,), whether the file gives it as such or as angles about fixed axes."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return np.array(body.quat)
    orientation = np.zeros(4)
    mujoco.mju_euler2Quat(orientation, np.asarray(body.alt.euler, float), "XYZ")
    return orientation


def _add_servos(spec: mujoco.MjSpec, arm: Arm) -> None:
    damping = 2.0 * np.sqrt(arm.stiffness_n_m_rad * arm.inertia_kg_m2)
    limits = zip(
        arm.joints, arm.speed_limit_rad_s, arm.torque_limit_n_m, arm.stiffness_n_m_rad, damping, strict=True
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
            group=MOTORS,
        )
        actuator.set_to_intvelocity(kp=kp, kv=kv)


BRAKING_S = 0.04
"""Time constant of the brakes' friction: they halve the speed of all joints every 10 ms, whatever these turn,
so that the hand runs on straight ahead, 2 cm at 1 m/s."""
BRAKE_FIRMNESS = 0.999
"""Which share of a load on a joint its brake takes at once; of the rest it gives way by less than 1 mrad/s."""


def _shape_brakes(spec: mujoco.MjSpec, arm: Arm) -> None:
    """How the joints' friction acts when ``simulation.brakes.Brakes`` puts it on."""
    for joint in arm.joints:
        spec.joint(joint).solref_friction = [BRAKING_S, 1.0]
        spec.joint(joint).solimp_friction = [BRAKE_FIRMNESS, 0.9999, 0.001, 0.5, 2.0]
