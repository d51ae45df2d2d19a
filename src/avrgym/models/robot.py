"""What a robot is, as plain data, and how its model is built from that; the records are in ``avrgym.robots``."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.tools import Tool

PREFIX = "robot/"
MOTORS = 1
"""The group of the moving arm's actuators."""
Side = Literal["right", "left"]
SIDES: tuple[Side, ...] = ("right", "left")
Place = Literal["wheelchair", "bed"]
PLACES: tuple[Place, ...] = ("wheelchair", "bed")
"""Where people are helped."""
Furniture = Callable[[mujoco.MjSpec, bool], None]
"""Adds bodies to a scene, in the world's frame; the second argument says whether to add what only pictures need."""


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm that may be the moving one.

    ``joints`` are the names of its J hinges from base to hand, six or more, each with a range; ``end_effector`` is the
    body that holds tools. ``speed_limit_rad_s``, ``torque_limit_n_m``, ``stiffness_n_m_rad`` and ``inertia_kg_m2``
    (J,) are each joint's highest speed, its motor's torque, the spring constant of its servo, and what it has to turn
    at the seed pose, its motor included; the servo's damping follows from the last two. ``seed_pose_rad`` (J,) is a
    pose with free space around it, where inverse kinematics starts. ``finger_prefix`` stands before the names of
    joints in the robot's grips. See ``tuned_arm`` for what may be computed.
    """

    joints: tuple[str, ...]
    end_effector: str
    speed_limit_rad_s: FloatArray
    torque_limit_n_m: FloatArray
    stiffness_n_m_rad: FloatArray
    inertia_kg_m2: FloatArray
    seed_pose_rad: FloatArray
    finger_prefix: str = ""


@dataclass(frozen=True, eq=False)
class Grip:
    """Where the hand holds a tool.

    ``pos`` (3,), metres, and ``q`` (4,) place the tool's frame, moved to its ``grip_pos``, in the end effector's
    frame. ``fingers`` are the positions of the hand's joints, named without the arm's prefix: radians, or metres where
    they slide.
    """

    pos: FloatArray
    q: FloatArray
    fingers: Mapping[str, float]


@dataclass(frozen=True)
class BaseRange:
    """Where the robot's base may stand: metres and radians added to its nominal place."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    yaw_rad: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Mount:
    """Where a robot's base is beside a person.

    ``pos_w`` (3,) and ``yaw_rad`` place the base, world frame: the person is at the origin and faces −y, their right is
    −x. With ``base_range`` every episode searches for a better place around that. ``carrier`` is what the base is
    fastened to; without one the robot stands on the floor by itself, and tasks may shift it. ``carrier_body`` is the
    carrier's body that is placed under the base wherever this stands.
    """

    pos_w: tuple[float, float, float]
    yaw_rad: float
    base_range: BaseRange | None = None
    carrier: Furniture | None = None
    carrier_body: str | None = None

    @property
    def on_floor(self) -> bool:
        """Whether the robot stands by itself."""
        return self.carrier is None


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot.

    ``build(appearance)`` gives the model of the robot alone, whose root body ``base`` is placed by its mount; geoms of
    group ``contacts.VISUAL_GROUP`` are only seen, all others only touch. ``torso`` is the body that observations are
    relative to, the base of a robot without one. ``arms`` are by the side of the person that tasks are done with;
    a robot with one arm has the same for both. ``mounts`` are by where the person is, ``grips`` by the tool's name:
    a robot does the tasks for which it has arm, mount and grip. ``half_width_m`` is that of a square base on the floor.
    ``fixed_joints`` are the positions of other joints, radians or metres, 0 for those not named.
    """

    name: str
    build: Callable[[bool], mujoco.MjSpec]
    base: str
    torso: str
    arms: Mapping[Side, Arm]
    mounts: Mapping[Place, Mount]
    grips: Mapping[str, Grip]
    half_width_m: float = 0.0
    fixed_joints: Mapping[str, float] = field(default_factory=dict[str, float])


class UnsuitableError(ValueError):
    """A robot lacks what a task asks for."""


def select_equipment(robot: Robot, place: Place, side: Side, tool: Tool) -> tuple[Arm, Mount]:
    """The arm that holds a tool beside a person, and the mount there.

    Raises:
        UnsuitableError: where the robot has no such arm, mount or grip, saying which.
    """
    for what, wanted, found in (
        ("arm", side, robot.arms), ("mount", place, robot.mounts), ("grip", tool.name, robot.grips)
    ):  # fmt: skip
        if wanted not in found:
            raise UnsuitableError(f"{robot.name} has no {what} {wanted!r}, only {', '.join(found)}")
    return robot.arms[side], robot.mounts[place]


def robot_spec(robot: Robot, arm: Arm, grip: Grip | None = None, *, appearance: bool) -> mujoco.MjSpec:
    """The robot alone: contact bits set, a velocity servo on each joint of the arm, all else held.

    The servo integrates its command into a target angle, never past the joint's range, and pulls the joint
    there like a spring of ``stiffness_n_m_rad`` with critical damping at the seed pose, within the motor's
    torque. (MuJoCo's own damping ratio holds at angle zero, where the arm is folded and five times lighter to
    turn: it lets the arm overshoot.)
    """
    spec = robot.build(appearance)
    for geom in list(spec.geoms):
        if geom.group == collision_bits.VISUAL_GROUP:
            if not appearance:
                spec.delete(geom)
        else:
            geom.contype, geom.conaffinity = collision_bits.ROBOT.contype, collision_bits.ROBOT.conaffinity
    _delete_unused_meshes(spec)
    fixed = dict(robot.fixed_joints)
    if grip is not None:
        fixed |= {arm.finger_prefix + finger: value for finger, value in grip.fingers.items()}
    fix_joints(spec, arm.joints, fixed)
    _add_servos(spec, arm)
    _shape_brakes(spec, arm)
    return spec


def robot_with(robot: Robot, arm: Arm, tool: Tool, name: str, *, appearance: bool) -> mujoco.MjSpec:
    """The robot alone with a tool in its hand, whose body is named ``name``."""
    grip = robot.grips[tool.name]
    spec = robot_spec(robot, arm, grip, appearance=appearance)
    body = spec.body(arm.end_effector).add_body(
        name=name,
        pos=grip.pos - transforms.rotate(grip.q, tool.grip_pos),
        quat=grip.q,
        gravcomp=1.0,
    )
    tool.build(spec, body, appearance)
    return spec


def _delete_unused_meshes(spec: mujoco.MjSpec) -> None:
    used = {geom.meshname for geom in spec.geoms}
    for mesh in [mesh for mesh in spec.meshes if mesh.name not in used]:
        spec.delete(mesh)


def fix_joints(spec: mujoco.MjSpec, moving: Sequence[str], fixed: Mapping[str, float]) -> None:
    """Weld all joints but the moving ones: hinges at radians, slides at metres, 0 where ``fixed`` names none.

    A joint that mimics another one, in MuJoCo by an equality, is where that one puts it.

    Raises:
        ValueError: for a moving joint that mimics another one, or is mimicked.
    """
    fixed = _with_mimics(spec, moving, fixed)
    for joint in [joint for joint in spec.joints if joint.name not in moving]:
        if value := fixed.get(joint.name, 0.0):
            _displace(joint.parent, joint, value)
        spec.delete(joint)


def _with_mimics(
    spec: mujoco.MjSpec, moving: Sequence[str], fixed: Mapping[str, float]
) -> Mapping[str, float]:
    """The positions of held joints, those that mimic others included; their equalities are deleted."""
    mimics = [each for each in spec.equalities if each.type == mujoco.mjtEq.mjEQ_JOINT]
    positions = dict(fixed)
    for each in mimics:
        if {each.name1, each.name2} & {*moving}:
            raise ValueError(
                f"the joint {each.name1!r} mimics {each.name2!r}; allowed: joints of a hand, not of the moving arm"
            )
    for _ in mimics:  # a joint may mimic one that mimics
        for each in mimics:
            if each.name1 not in fixed:
                leads = positions.get(each.name2, 0.0)
                positions[each.name1] = sum(float(each.data[power]) * leads**power for power in range(5))
    for each in mimics:
        spec.delete(each)
    return positions


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a robot.

    Raises:
        ValueError: naming a moving body without mass, and for whatever else MuJoCo refuses.
    """
    try:
        return spec.compile()
    except ValueError as error:
        massless = re.search("mass and inertia of moving bodies.*name '([^']*)'", str(error), re.DOTALL)
        if massless is None:
            raise
        raise ValueError(
            f"the link {massless[1]!r} moves and has no mass; allowed: an <inertial> with mass and inertia above 0"
        ) from error


def _displace(body: mujoco.MjsBody, joint: mujoco.MjsJoint, value: float) -> None:
    """Put a body where its joint has it at a position."""
    q = _orientation(body)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        body.pos = body.pos + value * transforms.rotate(q, transforms.normalize(joint.axis))
    else:
        body.quat = transforms.multiply(q, transforms.from_axis_angle(joint.axis, np.asarray(value)))
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _orientation(body: mujoco.MjsBody) -> FloatArray:
    """A body's quaternion (4,), whether the file gives it as such or as angles about fixed axes."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return np.array(body.quat)
    orientation = np.zeros(4)
    mujoco.mju_euler2Quat(orientation, np.asarray(body.alt.euler, float), "XYZ")
    return orientation


COMFORTABLE_RAD_S = np.radians(48.0)
"""No joint of the Jaco, made for such work, turns faster."""
SERVO_RAD_S = 20.0
"""Natural frequency of a servo: at full speed its joint lags by 0.1 s."""


def tuned_arm(
    build: Callable[[bool], mujoco.MjSpec],
    joints: Sequence[str],
    end_effector: str,
    seed_pose_rad: ArrayLike,
    *,
    speed_limit_rad_s: ArrayLike,
    torque_limit_n_m: ArrayLike,
    finger_prefix: str = "",
) -> Arm:
    """An arm whose servos are tuned by what its joints have to turn at the seed pose, all else at position 0.

    Args:
        build: gives the robot's model, as in ``Robot``.
        joints: the names of its J hinges, from base to hand.
        end_effector: the body that holds tools.
        seed_pose_rad: (J,).
        speed_limit_rad_s: (J,) or one for all, such as the description's; cut to what is comfortable beside a person.
        torque_limit_n_m: (J,) or one for all.
        finger_prefix: see ``Arm``.

    Raises:
        ValueError: for a joint that the model lacks, or arrays that do not have a number for each joint.
    """
    spec = build(False)
    missing = [name for name in joints if spec.joint(name) is None]
    if missing:
        raise ValueError(
            f"no joint {', '.join(missing)}; the joints are {', '.join(j.name for j in spec.joints)}"
        )
    seed, speed, torque = (
        _per_joint(name, values, len(joints))
        for name, values in (
            ("seed_pose_rad", seed_pose_rad),
            ("speed_limit_rad_s", speed_limit_rad_s),
            ("torque_limit_n_m", torque_limit_n_m),
        )
    )
    fix_joints(spec, joints, {})
    model = compiled(spec)
    data = mujoco.MjData(model)
    places = [model.joint(name).qposadr[0] for name in joints]
    data.qpos[places] = seed
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    turned = np.diag(inertia)[[model.joint(name).dofadr[0] for name in joints]]
    return Arm(
        joints=tuple(joints),
        end_effector=end_effector,
        speed_limit_rad_s=np.minimum(speed, COMFORTABLE_RAD_S),
        torque_limit_n_m=torque,
        stiffness_n_m_rad=SERVO_RAD_S**2 * turned,
        inertia_kg_m2=turned,
        seed_pose_rad=seed,
        finger_prefix=finger_prefix,
    )


def _per_joint(name: str, values: ArrayLike, count: int) -> FloatArray:
    found = np.asarray(values, float)
    if found.shape not in ((), (count,)):
        raise ValueError(f"{name} has shape {found.shape}; allowed: ({count},), a number for each joint")
    return np.broadcast_to(found, count).copy()


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
BRAKE_FIRMNESS = 0.9999
"""Which share of a load on a joint its brake takes at once, the largest that MuJoCo knows; under the rest it creeps."""


def _shape_brakes(spec: mujoco.MjSpec, arm: Arm) -> None:
    """How the joints' friction acts when ``safety.brakes.Brakes`` puts it on."""
    for joint in arm.joints:
        spec.joint(joint).solref_friction = [BRAKING_S, 1.0]
        spec.joint(joint).solimp_friction = [BRAKE_FIRMNESS, BRAKE_FIRMNESS, 0.001, 0.5, 2.0]
