"""Indices of joints, bodies and sensors in a scene's model. Each name is looked up once."""

from collections.abc import Sequence
from copy import copy
from typing import Any, NamedTuple

import mujoco
import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry.arrays import constant_like
from avrgym.models import human, robot
from avrgym.models.drive import DRIVE_JOINTS, DRIVE_SERVOS
from avrgym.models.scene import (
    END_EFFECTOR_VELOCITY_SENSOR,
    PERSON_CONTACT_SENSOR,
    PERSON_FORCE_SENSOR,
    ROBOT_CONTACT_SENSOR,
    ROBOT_FORCE_SENSOR,
    SCENE_TOOL_BODY,
    TOOL_CONTACT_SENSOR,
    TOOL_FORCE_SENSOR,
    TOOL_VELOCITY_SENSOR,
    SceneConfig,
)


class ModelAddresses:
    """Indices of joints, actuators, sensors, bodies and geoms in one model."""

    def __init__(self, model: mujoco.MjModel, scene: SceneConfig) -> None:
        arm = [robot.ROBOT_NAME_PREFIX + joint for joint in scene.arm.joints]
        self.arm_qpos = _qpos(model, arm)
        self.arm_ctrl = find_actuator_ids(model, arm)
        self.arm_act = np.array([model.actuator(name).actadr[0] for name in arm])
        self.mimic_joints = _followers(model)
        drives = scene.robot.drive is not None
        self.drive_qpos = _qpos(model, [robot.ROBOT_NAME_PREFIX + joint for joint in DRIVE_JOINTS if drives])
        self.drive_ctrl = find_actuator_ids(
            model, [robot.ROBOT_NAME_PREFIX + servo for servo in DRIVE_SERVOS if drives]
        )
        self.robot_base = model.body(robot.ROBOT_NAME_PREFIX + scene.robot.base).id
        self.robot_torso = model.body(robot.ROBOT_NAME_PREFIX + scene.robot.torso).id
        self.tool = model.body(SCENE_TOOL_BODY).id
        self.pad = model.body(robot.ROBOT_NAME_PREFIX + scene.tool.contact_body).id
        self.head = model.body(human.PERSON_NAME_PREFIX + "head").id
        self.hips = model.body(human.PERSON_NAME_PREFIX + "hips").id
        self.right_arm, self.left_arm = (
            np.array([model.body(human.PERSON_NAME_PREFIX + name).id for name in arm])
            for arm in (human.RIGHT_ARM_BODIES, human.LEFT_ARM_BODIES)
        )
        self.movable_bodies = {name: model.body(name).id for name in scene.movable_bodies}
        self.head_centre = model.site(human.PERSON_NAME_PREFIX + "head_centre").id
        self.mouth = model.site(human.PERSON_NAME_PREFIX + "mouth").id
        self.person_geoms = np.array([model.geom(human.PERSON_NAME_PREFIX + name).id for name in human.GEOMS])
        driven = [
            human.PERSON_NAME_PREFIX + name
            for name in human.JOINTS
            if model.nu > len(arm) + len(self.drive_ctrl)
        ]
        self.person_qpos, self.person_ctrl = _qpos(model, driven), find_actuator_ids(model, driven)
        self.person_act = np.array([model.actuator(name).actadr[0] for name in driven], dtype=np.intp)
        particles = scene.tool.particles.bodies if scene.tool.particles else ()
        cloth = scene.tool.cloth.bodies if scene.tool.cloth else ()
        self.particle_qpos, self.cloth_qpos = _slides_qpos(model, particles), _slides_qpos(model, cloth)
        self.particle_dof = np.array(
            [[model.joint(f"{body}_{axis}").dofadr[0] for axis in "xyz"] for body in particles], dtype=np.intp
        ).reshape(-1, 3)
        self.robot_force = _sensor(model, ROBOT_FORCE_SENSOR)
        self.tool_force = _sensor(model, TOOL_FORCE_SENSOR)
        self.robot_contacts = _sensor(model, ROBOT_CONTACT_SENSOR)
        self.tool_contacts = _sensor(model, TOOL_CONTACT_SENSOR)
        self.person_force = _sensor(model, PERSON_FORCE_SENSOR) if cloth else slice(0)
        self.person_contacts = _sensor(model, PERSON_CONTACT_SENSOR) if cloth else slice(0)
        self.end_effector_velocity = _sensor(model, END_EFFECTOR_VELOCITY_SENSOR)
        self.tool_velocity = _sensor(model, TOOL_VELOCITY_SENSOR)

    def to_device_of(self, array: Any) -> "ModelAddresses":
        """Returns the same indices as arrays on the device of ``array``."""
        there = copy(self)
        for name, addresses in vars(self).items():
            if isinstance(addresses, np.ndarray):
                setattr(there, name, constant_like(addresses, array))
        return there


class MimicJoint(NamedTuple):
    """A joint that mimics another joint, the leader. Its position is a polynomial of the leader's position.

    ``qpos_index`` and ``leader_qpos_index`` are the indices of both joints in MuJoCo's qpos.
    ``polynomial_coefficients``: coefficients (5,).
    """

    qpos_index: int
    leader_qpos_index: int
    polynomial_coefficients: FloatArray


def _followers(model: mujoco.MjModel) -> tuple[MimicJoint, ...]:
    """Returns the joints that equality constraints couple to other joints."""
    return tuple(
        MimicJoint(
            int(model.jnt_qposadr[model.eq_obj1id[each]]),
            int(model.jnt_qposadr[model.eq_obj2id[each]]),
            polynomial,
        )
        for each, polynomial in enumerate(model.eq_data[:, :5])
        if model.eq_type[each] == mujoco.mjtEq.mjEQ_JOINT
    )


def _qpos(model: mujoco.MjModel, joints: Sequence[str]) -> IntArray:
    return np.array([model.joint(name).qposadr[0] for name in joints], dtype=np.intp)


def _slides_qpos(model: mujoco.MjModel, bodies: Sequence[str]) -> IntArray:
    """Returns the indices (K, 3) in qpos of bodies with three slide joints."""
    joints = [f"{body}_{axis}" for body in bodies for axis in "xyz"]
    return _qpos(model, joints).reshape(-1, 3)


def find_actuator_ids(model: mujoco.MjModel, names: Sequence[str]) -> IntArray:
    """Returns the ids (n,) of the actuators of a model with these names, in the same order."""
    return np.array([model.actuator(name).id for name in names], dtype=np.intp)


def _sensor(model: mujoco.MjModel, name: str) -> slice:
    sensor = model.sensor(name)
    return slice(int(sensor.adr[0]), int(sensor.adr[0] + sensor.dim[0]))
