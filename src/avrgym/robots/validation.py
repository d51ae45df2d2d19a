"""Checks ``Robot`` records against their MuJoCo models."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict

import mujoco
import numpy as np

from avrgym.geometry import kinematics
from avrgym.geometry.kinematics import SLIDE_JOINT_TYPE
from avrgym.models import robot as models
from avrgym.models.cameras import SCENE_CAMERA, WRIST_CAMERA
from avrgym.models.robot import PERSON_LOCATIONS, ROBOT_ARM_SIDES, Arm, Robot

HINGE_JOINT_TYPE = int(mujoco.mjtJoint.mjJNT_HINGE)
MIN_ARM_JOINTS = 6
"""Minimum number of joints of an arm. With fewer joints, the hand cannot have any position and rotation."""
MAX_REACH_M, MAX_JOINT_ANGLE_RAD = 2.5, 2.0 * np.pi
"""Maximum reach in metres and maximum joint angle in radians. They bound the observations."""


def check_robot(robot: Robot) -> None:
    """Check a robot record against its model.

    Raises:
        ValueError: if the record is invalid. The message lists all errors and the allowed values.
    """
    wrong = list(_check_names(robot)) or list(_check_model(robot))
    if wrong:
        raise ValueError(f"robot {robot.name!r} is invalid: {'; '.join(wrong)}")


def _check_names(robot: Robot) -> Iterator[str]:
    if not re.fullmatch("[A-Z][A-Za-z0-9]*", robot.name):
        yield "its name is not valid in an environment id; allowed: a capital letter, then letters and digits"
    yield from _check_keys("arms", robot.arms, ROBOT_ARM_SIDES)
    yield from _check_keys("mounts", robot.mounts, PERSON_LOCATIONS)
    if not robot.grips:
        yield "it has no grips; allowed: at least one, by the name of the tool"
    for side, arm in robot.arms.items():
        yield from _check_arm(side, arm, robot.drive is not None)
    yield from _check_drive(robot)
    for name, mount in robot.cameras.items():
        if not name.isidentifier() or name in (WRIST_CAMERA, SCENE_CAMERA):
            yield f"invalid camera name {name!r}; allowed: identifiers except {WRIST_CAMERA} and {SCENE_CAMERA}"
        if not np.isfinite(mount.pos_m).all() or not np.cross(mount.forward, mount.up).any():
            yield (
                f"the camera {name!r} has the position {mount.pos_m}, forward {mount.forward} and up {mount.up}; "
                "allowed: finite numbers, and two different directions"
            )


def _check_keys(field: str, found: Iterable[str], allowed: Iterable[str]) -> Iterator[str]:
    if not found:
        yield f"it has no {field}; allowed: one or more of {', '.join(allowed)}"
    for key in found:
        if key not in allowed:
            yield f"unknown {field} {key!r}; allowed: {', '.join(allowed)}"


def _check_drive(robot: Robot) -> Iterator[str]:
    if robot.drive is None:
        return
    for name, value in asdict(robot.drive).items():
        if not (np.isfinite(value) and value > 0.0):
            yield f"{name} of its drive is {value}; allowed: above 0"
    carried = [place for place, mount in robot.mounts.items() if not mount.is_on_floor]
    if carried:
        yield f"it has a drive, but its mounts for {', '.join(carried)} have a carrier; allowed: mounts on the floor"


def _check_arm(side: str, arm: Arm, drives: bool) -> Iterator[str]:
    count = len(arm.joints)
    if count + drives < MIN_ARM_JOINTS:
        yield f"its {side} arm has {count} joints; allowed: {MIN_ARM_JOINTS} or more, one less with a drive"
    for name in (
        "speed_limit",
        "effort_limit",
        "stiffness",
        "inertia",
        "seed_pose",
    ):
        values = np.asarray(getattr(arm, name))
        if values.shape != (count,):
            yield f"{name} of its {side} arm has the shape {values.shape}; allowed: ({count},), a number for each joint"
        elif not np.isfinite(values).all():
            yield f"{name} of its {side} arm is {values.tolist()}; allowed: finite numbers"
        elif name != "seed_pose" and not (values > 0.0).all():
            yield f"{name} of its {side} arm is {values.tolist()}; allowed: numbers above 0"


def _check_model(robot: Robot) -> Iterator[str]:
    missing = list(_missing_names(robot, robot.build(False)))
    yield from missing
    for side, arm in robot.arms.items() if not missing else ():
        yield from _check_compiled(robot, side, arm)


def _missing_names(robot: Robot, spec: mujoco.MjSpec) -> Iterator[str]:
    """Yields an error message for each name of the record that is missing in the model."""
    bodies, joints = ({thing.name for thing in things} for things in (spec.bodies, spec.joints))
    yield from _unknown("base", [robot.base], bodies)
    yield from _unknown("torso", [robot.torso], bodies)
    yield from _unknown("fixed_joint_positions", robot.fixed_joint_positions, joints)
    yield from _unknown("cameras", [mount.body for mount in robot.cameras.values()], bodies)
    fingers = {finger for grip in robot.grips.values() for finger in grip.finger_joint_positions}
    for side, arm in robot.arms.items():
        yield from _unknown(f"end_effector of its {side} arm", [arm.end_effector], bodies)
        yield from _unknown(f"joints of its {side} arm", arm.joints, joints)
        yield from _unknown(
            "fingers of its grips", sorted(arm.finger_prefix + name for name in fingers), joints
        )


def _unknown(field: str, names: Iterable[str], known: set[str]) -> Iterator[str]:
    for name in names:
        if name not in known:
            yield f"{field}: its model has no {name!r}; it has {', '.join(sorted(known))}"


def _check_compiled(robot: Robot, side: str, arm: Arm) -> Iterator[str]:
    try:
        model = models.compile_robot_model(models.build_robot_spec(robot, arm, appearance=False))
    except ValueError as error:
        yield f"its {side} arm: {error}"
        return
    types = {name: model.joint(name).type[0] for name in arm.joints}
    if others := [name for name, kind in types.items() if kind not in (HINGE_JOINT_TYPE, SLIDE_JOINT_TYPE)]:
        yield (
            f"{', '.join(others)} of its {side} arm is neither hinge nor slide; allowed: revolute, continuous and "
            "prismatic joints"
        )
        return
    try:
        way = kinematics.extract_chain(model, arm.joints, robot.base, arm.end_effector)
    except ValueError as error:
        yield f"its {side} arm: {error}"
        return
    yield from _ways(side, arm, way)


def _ways(side: str, arm: Arm, way: kinematics.Chain) -> Iterator[str]:
    if (reach_m := kinematics.compute_max_reach_m(way)) > MAX_REACH_M:
        yield f"the reach of its {side} arm is {reach_m:.2f} m; allowed: at most {MAX_REACH_M} m"
    turns = np.maximum(np.abs(way.lower_limit), np.abs(way.upper_limit))
    for number, (joint, turn) in enumerate(zip(arm.joints, turns, strict=True)):
        if number not in way.slide_joints and turn > MAX_JOINT_ANGLE_RAD + 1e-9:
            yield f"joint {joint!r} has no range or a too large range; allowed: a range within −2π to 2π"
        if number in way.slide_joints and not np.isfinite(turn):
            yield f"joint {joint!r} has no range; add two finite limits in metres"
    outside = (arm.seed_pose < way.lower_limit) | (arm.seed_pose > way.upper_limit)
    for joint in np.array(arm.joints)[outside]:
        yield (
            f"the seed pose of its {side} arm is outside the range of joint {str(joint)!r}; allowed: joint positions "
            "within all ranges"
        )
