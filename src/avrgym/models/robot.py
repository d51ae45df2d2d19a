"""Descriptions of robots, and functions that build their MuJoCo models. The package ``avrgym.robots`` contains the
robots.
"""

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.body_names import Side
from avrgym.models.collision_bits import CollisionBits
from avrgym.models.drive import (
    DRIVE_ACTION_NAMES,
    DRIVE_JOINTS,
    MOTOR_ACTUATOR_GROUP,
    DifferentialDrive,
    add_drive,
)
from avrgym.models.tools import Tool

ROBOT_NAME_PREFIX = "robot/"
"""Prefix of all names of the robot in a scene."""
ROBOT_ARM_SIDES: tuple[Side, ...] = ("right", "left")
PersonLocation = Literal["wheelchair", "bed"]
PERSON_LOCATIONS: tuple[PersonLocation, ...] = ("wheelchair", "bed")
"""Locations of the person: in the wheelchair or in bed."""
FurnitureBuilder = Callable[[mujoco.MjSpec, bool], None]
"""Function that adds furniture to a scene, in the world frame. Arguments: scene, and whether to add visual geoms."""


@dataclass(frozen=True, eq=False)
class Arm:
    """A robot arm. ``make_arm_with_servo_gains`` creates an arm, and computes its stiffness and inertia.

    Joints are hinges or slides; the model defines their types and ranges. The type determines the units: radians and
    N·m for hinges, metres and N for slides.

    Attributes:
        joints: names of the J joints from base to hand, at least six, each with a range.
        end_effector: body that holds tools.
        speed_limit: speed limits (J,), rad/s or m/s.
        effort_limit: limits of motor torque or force (J,), N·m or N.
        stiffness: servo stiffness (J,), N·m/rad or N/m.
        inertia: inertia or mass at the seed pose, motor included (J,), kg·m² or kg. It determines the servo's damping.
        seed_pose: initial joint positions (J,) for inverse kinematics, rad or m, with clearance around the arm.
        finger_prefix: prefix of the hand's joint names.
    """

    joints: tuple[str, ...]
    end_effector: str
    speed_limit: FloatArray
    effort_limit: FloatArray
    stiffness: FloatArray
    inertia: FloatArray
    seed_pose: FloatArray
    finger_prefix: str = ""


@dataclass(frozen=True, eq=False)
class Grip:
    """Grip of a hand on a tool.

    Attributes:
        pos, quat: pose of the tool's ``grip_pos`` in the end effector's frame, (3,) in metres and (4,).
        finger_joint_positions: joint positions of the hand, without the arm's prefix; radians, or metres for slide
            joints.
    """

    pos: FloatArray
    quat: FloatArray
    finger_joint_positions: Mapping[str, float]


@dataclass(frozen=True)
class BaseRange:
    """Range of the robot's base poses relative to the nominal pose, metres and radians."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    yaw_rad: tuple[float, float]

    def mirror(self) -> "BaseRange":
        """Returns the range mirrored to the other side of the person."""
        (left, right), (least, most) = self.x_m, self.yaw_rad
        return BaseRange((-right, -left), self.y_m, (-most, -least))


@dataclass(frozen=True, eq=False)
class Mount:
    """Pose of a robot's base next to a person, and the furniture that carries the base.

    Attributes:
        pos_w, yaw_rad: base pose, world frame. The person is at the origin and faces −y; their right is −x.
        base_range: range in which each episode searches for a base pose.
        carrier_builder: function that adds the furniture to which the base is attached. ``None``: the robot is on the
            floor, and tasks may move it. A carrier with the keyword ``mirror`` can also be on the person's left.
        carrier_body: body of the carrier that moves with the base.
        left_yaw_rad: base yaw on the person's other side, for a robot with an arm that extends sideways. ``None``: the
            mirrored yaw.
        left_pos_w: base position on the person's other side. ``None``: the mirrored position. A carrier then needs the
            keyword ``mount_m``, see ``add_bracket``.
    """

    pos_w: tuple[float, float, float]
    yaw_rad: float
    base_range: BaseRange | None = None
    carrier_builder: FurnitureBuilder | None = None
    carrier_body: str | None = None
    left_yaw_rad: float | None = None
    left_pos_w: tuple[float, float, float] | None = None

    @property
    def is_on_floor(self) -> bool:
        """Returns whether the robot is on the floor, not on furniture."""
        return self.carrier_builder is None

    def mirror(self) -> "Mount":
        """Returns the mount on the person's other side, mirrored at the sagittal plane.

        Raises:
            UnsuitableRobotError: if the carrier cannot be mirrored.
        """
        x, y, z = self.pos_w
        pos_w = self.left_pos_w or (-x, y, z)
        carrier: Callable[..., None] | None = self.carrier_builder
        if carrier is not None:
            if "mirrored" not in inspect.signature(carrier).parameters:
                raise UnsuitableRobotError(
                    "the function of the robot's carrier has no keyword `mirrored`, so it cannot be on the person's "
                    "left; add the keyword, or choose a robot on the floor"
                )
            to_left = not getattr(carrier, "keywords", {}).get("mirrored", False)
            on_right_m = (-pos_w[0], *pos_w[1:]) if to_left else pos_w
            moved = {} if self.left_pos_w is None else {"mount_m": on_right_m}
            carrier = partial(carrier, mirrored=to_left, **moved)
        yaw_rad = self.left_yaw_rad
        if yaw_rad is None:
            yaw_rad = float(np.remainder(2.0 * np.pi - self.yaw_rad, 2.0 * np.pi) - np.pi)
        return replace(
            self,
            pos_w=pos_w,
            yaw_rad=yaw_rad,
            base_range=None if self.base_range is None else self.base_range.mirror(),
            carrier_builder=carrier,
            left_yaw_rad=None if self.left_yaw_rad is None else self.yaw_rad,
            left_pos_w=None if self.left_pos_w is None else self.pos_w,
        )


@dataclass(frozen=True)
class CameraMount:
    """A camera on a robot's body, in addition to the wrist camera; see ``models.cameras``.

    Attributes:
        body: body of the robot's model.
        pos_m: position in the body's frame.
        forward, up: directions in the body's frame.
        fovy_deg: vertical field of view in degrees.
    """

    body: str
    pos_m: tuple[float, float, float]
    forward: tuple[float, float, float]
    up: tuple[float, float, float]
    fovy_deg: float


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot: its model, arms, mounts and grips. A task needs an arm, a mount and a grip.

    Attributes:
        name: part of the environment ids.
        build: function that returns the model of the robot without a scene. Argument: whether to add visual geoms.
            Geoms of group ``collision_bits.VISUAL_GROUP`` are visible and do not collide; all other geoms collide and
            are not visible.
        base: root body; the mount determines its pose.
        torso: reference body of observations; the base for robots without a torso.
        arms: arms by side. A robot with one arm lists it for both sides.
        mounts: mounts by the location of the person.
        grips: grips by the tool's name.
        base_half_width_m: half the width of a square base on the floor.
        fixed_joint_positions: positions of all other joints, radians or metres; default: 0.
        cameras: cameras by name, such as ``head``.
        drive: drive of a mobile base, which can move at the same time as the arm. The last components of an action are
            then forward speed and turn rate.
    """

    name: str
    build: Callable[[bool], mujoco.MjSpec]
    base: str
    torso: str
    arms: Mapping[Side, Arm]
    mounts: Mapping[PersonLocation, Mount]
    grips: Mapping[str, Grip]
    base_half_width_m: float = 0.0
    fixed_joint_positions: Mapping[str, float] = field(default_factory=dict[str, float])
    cameras: Mapping[str, CameraMount] = field(default_factory=dict[str, CameraMount])
    drive: DifferentialDrive | None = None

    def get_first_moving_joint(self, arm: Arm) -> str:
        """Returns the first joint of the kinematic chain: the arm's first joint, or the drive's."""
        return arm.joints[0] if self.drive is None else DRIVE_JOINTS[0]

    def list_action_names(self, arm: Arm) -> tuple[str, ...]:
        """Returns the names of an action's A components: the arm's joints, and ``DRIVE_ACTION_NAMES`` for a mobile
        base.
        """
        return (*arm.joints, *(() if self.drive is None else DRIVE_ACTION_NAMES))


class UnsuitableRobotError(ValueError):
    """Raised if a robot lacks the arm, mount or grip that a task needs."""


def select_arm_and_mount(robot: Robot, place: PersonLocation, side: Side, tool: Tool) -> tuple[Arm, Mount]:
    """Returns the robot's arm and mount for a tool and a location of the person.

    Raises:
        UnsuitableRobotError: if the robot has no such arm, mount or grip.
    """
    for what, wanted, found in (
        ("arm", side, robot.arms), ("mount", place, robot.mounts), ("grip", tool.grip_name, robot.grips)
    ):  # fmt: skip
        if wanted not in found:
            raise UnsuitableRobotError(
                f"robot {robot.name} has no {what} {wanted!r}; allowed: {', '.join(found)}"
            )
    return robot.arms[side], robot.mounts[place]


def make_robot_obstacle(
    robot: Robot, name: str, place: tuple[float, float], yaw_rad: float
) -> FurnitureBuilder:
    """Returns a function that adds a robot as furniture: a static obstacle on the floor.

    Raises:
        ValueError: for a robot without a mount on the floor.
    """
    heights_m = [mount.pos_w[2] for mount in robot.mounts.values() if mount.is_on_floor]
    if not heights_m:
        raise ValueError(
            f"robot {robot.name} has no mount on the floor; choose a robot with a mount on the floor"
        )
    positions = {
        joint: float(value)
        for arm in robot.arms.values()
        for joint, value in zip(arm.joints, arm.seed_pose, strict=True)
    }

    def add(spec: mujoco.MjSpec, appearance: bool) -> None:
        standing = robot.build(appearance)
        _set_collision_bits(standing, collision_bits.FURNITURE, appearance)
        fix_joints(standing, (), positions | dict(robot.fixed_joint_positions))
        turn = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(yaw_rad))
        frame = spec.worldbody.add_frame(pos=[*place, heights_m[0]], quat=turn)
        spec.attach(standing, prefix=f"{name}/", frame=frame)

    return add


def build_robot_spec(robot: Robot, arm: Arm, grip: Grip | None = None, *, appearance: bool) -> mujoco.MjSpec:
    """Returns the model of a robot without a scene.

    Geoms have collision bits, and joints of the arm have velocity servos. All other joints are fixed, except mimic
    joints of the arm. A drive has three joints, see ``DRIVE_JOINTS``.

    The servo integrates its command into a target angle within the joint's range. It behaves like a spring of
    ``stiffness`` with critical damping at the seed pose. Its torque is limited to that of the motor. MuJoCo's damping
    ratio is not used, because it refers to joint angle zero. At this angle the folded arm has less inertia, and the
    servo would overshoot.
    """
    spec = robot.build(appearance)
    _set_collision_bits(spec, collision_bits.ROBOT, appearance)
    fixed = dict(robot.fixed_joint_positions)
    if grip is not None:
        fixed |= {arm.finger_prefix + finger: value for finger, value in grip.finger_joint_positions.items()}
    fix_joints(spec, arm.joints, fixed)
    _add_servos(spec, arm)
    if robot.drive is not None:
        add_drive(spec, spec.body(robot.base), robot.drive)
    _shape_brakes(spec, (*arm.joints, *(DRIVE_JOINTS if robot.drive is not None else ())))
    return spec


def build_robot_spec_with_tool(
    robot: Robot, arm: Arm, tool: Tool, name: str, *, appearance: bool
) -> mujoco.MjSpec:
    """Returns the model of a robot with a tool in its hand, without a scene. ``name``: name of the tool's body."""
    grip = robot.grips[tool.grip_name]
    spec = build_robot_spec(robot, arm, grip, appearance=appearance)
    body = spec.body(arm.end_effector).add_body(
        name=name,
        pos=grip.pos - transforms.rotate(grip.quat, tool.grip_pos),
        quat=grip.quat,
        gravcomp=1.0,
    )
    tool.build(spec, body, appearance)
    return spec


def _set_collision_bits(spec: mujoco.MjSpec, bits: CollisionBits, appearance: bool) -> None:
    """Set the bits of all collision geoms. Without ``appearance``, delete all visual geoms."""
    for geom in list(spec.geoms):
        if geom.group == collision_bits.VISUAL_GROUP:
            if not appearance:
                spec.delete(geom)
        else:
            geom.contype, geom.conaffinity = bits.contype, bits.conaffinity
    _delete_unused_meshes(spec)


def _delete_unused_meshes(spec: mujoco.MjSpec) -> None:
    used = {geom.meshname for geom in spec.geoms}
    for mesh in [mesh for mesh in spec.meshes if mesh.name not in used]:
        spec.delete(mesh)


def fix_joints(spec: mujoco.MjSpec, moving: Sequence[str], fixed: Mapping[str, float]) -> None:
    """Remove all joints except the moving ones, at ``fixed`` positions (radians or metres; 0 by default).

    A mimic joint (coupled by a MuJoCo equality) follows its joint. If that joint moves, the mimic joint is not removed.

    Raises:
        ValueError: for a moving joint that mimics another one.
    """
    fixed, following = _with_mimics(spec, moving, fixed)
    for joint in [joint for joint in spec.joints if joint.name not in {*moving, *following}]:
        if value := fixed.get(joint.name, 0.0):
            _displace(joint.parent, joint, value)
        spec.delete(joint)


def _with_mimics(
    spec: mujoco.MjSpec, moving: Sequence[str], fixed: Mapping[str, float]
) -> tuple[Mapping[str, float], set[str]]:
    """Returns the positions of the fixed joints with mimic joints, and the names of joints that mimic a moving joint.

    The equalities of the fixed joints are removed from the model.
    """
    mimics = [each for each in spec.equalities if each.type == mujoco.mjtEq.mjEQ_JOINT]
    for each in mimics:
        if each.name1 in moving:
            raise ValueError(
                f"joint {each.name1!r} of the arm mimics joint {each.name2!r}; allowed: joints that do not mimic others"
            )
    following = {each.name1 for each in mimics if each.name2 in moving}
    mimics = [each for each in mimics if each.name1 not in following]
    positions = dict(fixed)
    for _ in mimics:  # a joint may mimic a joint that mimics another one
        for each in mimics:
            if each.name1 not in fixed:
                leads = positions.get(each.name2, 0.0)
                positions[each.name1] = sum(float(each.data[power]) * leads**power for power in range(5))
    for each in mimics:
        spec.delete(each)
    return positions, following


def compile_robot_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile and return the model of a robot.

    Raises:
        ValueError: for an invalid model, for example a moving link without mass.
    """
    try:
        return spec.compile()
    except ValueError as error:
        massless = re.search("mass and inertia of moving bodies.*name '([^']*)'", str(error), re.DOTALL)
        if massless is None:
            raise
        raise ValueError(
            f"link {massless[1]!r} moves but has no mass; add an <inertial> element with mass and inertia above 0"
        ) from error


def _displace(body: mujoco.MjsBody, joint: mujoco.MjsJoint, value: float) -> None:
    """Move a body of a model to its pose at the joint position ``value``, in radians or metres."""
    q = _orientation(body)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        body.pos = body.pos + value * transforms.rotate(q, transforms.normalize(joint.axis))
    else:
        body.quat = transforms.multiply(q, transforms.from_axis_angle(joint.axis, np.asarray(value)))
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _orientation(body: mujoco.MjsBody) -> FloatArray:
    """Returns the quaternion (4,) of a body, converted from Euler angles if necessary."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return np.array(body.quat)
    orientation = np.zeros(4)
    mujoco.mju_euler2Quat(orientation, np.asarray(body.alt.euler, float), "XYZ")
    return orientation


MAX_JOINT_SPEED_RAD_S, MAX_SLIDE_SPEED_M_S = np.radians(48.0), 0.25
"""Speed limits of all arms. For hinges: the maximum joint speed of the Jaco, an assistive arm. For slides: the reduced
speed of ISO 10218-1:2011.
"""
ARM_SERVO_FREQUENCY_RAD_S = 20.0
"""Natural frequency of a servo. The joint lags 0.1 s behind the servo target."""


def make_arm_with_servo_gains(
    build: Callable[[bool], mujoco.MjSpec],
    joints: Sequence[str],
    end_effector: str,
    seed_pose: ArrayLike,
    *,
    speed_limit: ArrayLike,
    effort_limit: ArrayLike,
    finger_prefix: str = "",
) -> Arm:
    """Returns an arm with servo gains that are computed from its inertia at the seed pose.

    Args:
        build: returns the robot's model, as in ``Robot``.
        joints: names of the J joints, from base to hand.
        end_effector: body that holds tools.
        seed_pose: start pose of the inverse kinematics (J,).
        speed_limit: speed limits (J,) or one value, rad/s or m/s. Larger values are reduced to
            ``MAX_JOINT_SPEED_RAD_S`` and ``MAX_SLIDE_SPEED_M_S``.
        effort_limit: limits of torque or force (J,) or one value, N·m or N.
        finger_prefix: prefix of the names of the hand's joints.

    Raises:
        ValueError: for a joint that is not in the model, or arrays of a wrong length.
    """
    spec = build(False)
    missing = [name for name in joints if spec.joint(name) is None]
    if missing:
        raise ValueError(
            f"unknown joint {', '.join(missing)}; allowed: {', '.join(j.name for j in spec.joints)}"
        )
    seed, speed, torque = (
        _per_joint(name, values, len(joints))
        for name, values in (
            ("seed_pose", seed_pose),
            ("speed_limit", speed_limit),
            ("effort_limit", effort_limit),
        )
    )
    slides = [spec.joint(name).type == mujoco.mjtJoint.mjJNT_SLIDE for name in joints]
    fix_joints(spec, joints, {})
    model = compile_robot_model(spec)
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
        speed_limit=np.minimum(speed, np.where(slides, MAX_SLIDE_SPEED_M_S, MAX_JOINT_SPEED_RAD_S)),
        effort_limit=torque,
        stiffness=ARM_SERVO_FREQUENCY_RAD_S**2 * turned,
        inertia=turned,
        seed_pose=seed,
        finger_prefix=finger_prefix,
    )


def _per_joint(name: str, values: ArrayLike, count: int) -> FloatArray:
    found = np.asarray(values, float)
    if found.shape not in ((), (count,)):
        raise ValueError(
            f"{name} has the shape {found.shape}; allowed: ({count},), one number for each joint"
        )
    return np.broadcast_to(found, count).copy()


def _add_servos(spec: mujoco.MjSpec, arm: Arm) -> None:
    damping = 2.0 * np.sqrt(arm.stiffness * arm.inertia)
    limits = zip(arm.joints, arm.speed_limit, arm.effort_limit, arm.stiffness, damping, strict=True)
    for joint, speed, torque, kp, kv in limits:
        actuator = spec.add_actuator(
            name=joint,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=joint,
            ctrlrange=[-speed, speed],
            forcerange=[-torque, torque],
            actrange=spec.joint(joint).range,
            actlimited=True,
            group=MOTOR_ACTUATOR_GROUP,
        )
        actuator.set_to_intvelocity(kp=kp, kv=kv)


BRAKE_TIME_CONSTANT_S = 0.04
"""Time constant of the brakes. The brakes halve the speed of all joints every 10 ms. The hand therefore stops along a
straight line: within 2 cm from a speed of 1 m/s."""
BRAKE_IMPEDANCE = 0.9999
"""Impedance of a brake, the maximum in MuJoCo. The brake therefore carries almost the whole load; the rest moves the
joint slowly.
"""


def _shape_brakes(spec: mujoco.MjSpec, joints: Sequence[str]) -> None:
    """Set the friction parameters (impedance and time constant) of joints with brakes, see ``safety.brakes``."""
    for joint in joints:
        spec.joint(joint).solref_friction = [BRAKE_TIME_CONSTANT_S, 1.0]
        spec.joint(joint).solimp_friction = [BRAKE_IMPEDANCE, BRAKE_IMPEDANCE, 0.001, 0.5, 2.0]
