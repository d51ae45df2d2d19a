"""N worlds of one scene, stepped by a physics engine."""

from collections.abc import Collection, Mapping
from copy import copy
from dataclasses import replace
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from avrgym.array_types import BoolArray, FloatArray, IntArray, NumpyArray
from avrgym.geometry import elementary, kinematics, transforms
from avrgym.geometry.arrays import constant_like, copy_as_float, get_namespace, to_device_of, to_numpy
from avrgym.geometry.transforms import norm
from avrgym.models import compliance, human, robot
from avrgym.models.body_names import Side
from avrgym.models.drive import DifferentialDrive
from avrgym.models.human import Person
from avrgym.models.scene import (
    CONTROL_STEP_S,
    DEFAULT_SUBSTEPS,
    MAX_PERSON_CONTACTS,
    MAX_ROBOT_CONTACTS,
    MAX_TOOL_CONTACTS,
    SceneConfig,
    build_scene_spec,
)
from avrgym.safety.brakes import Brakes
from avrgym.safety.region_forces import RegionForceSensors, add_region_sensors
from avrgym.simulation.engines.engine import WorldArrays, make_engine
from avrgym.simulation.model_addresses import ModelAddresses
from avrgym.simulation.person_model_fields import PersonModelFields
from avrgym.simulation.start_clearance import WorldGeoms
from avrgym.simulation.state import ArmPoses, InitialState, RightArmPoses, State
from avrgym.simulation.unused_computation import remove_unused_computation
from avrgym.system.engine_names import THREADS
from avrgym.system.memory import set_mmap_threshold

__all__ = [
    "MAX_SERVO_LEAD_RAD",
    "REMOVED_PARTICLE_POS_W",
    "ArmPoses",
    "InitialState",
    "RightArmPoses",
    "Simulation",
    "State",
]


MAX_SERVO_LEAD_RAD = 0.08
"""Maximum difference between a servo's target and the joint position, in radians. This limit also limits the force of a
blocked servo. For slide joints, see ``kinematics.compute_joint_scales``.
"""


BASE_JOINT_TYPES = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
"""Types of the three joints of a driving base: two slides and a hinge."""
REMOVED_PARTICLE_POS_W = np.array([4.0, 4.0, 0.1])
"""Position of removed particles. Removed particles are far from all bodies, have no weight, and have no contacts."""


@lru_cache(maxsize=16)
def _compiled(
    scene: SceneConfig, moving: bool, by_region: bool, interpolate_person_targets: bool
) -> mujoco.MjModel:
    """Returns the scene's compiled model, see ``Simulation``. The model is cached: copy it before you change it."""
    spec = build_scene_spec(scene, Person(), moving=moving, appearance=False)
    compliance.limit_contact_forces(spec, scene.arm, scene.tool, MAX_SERVO_LEAD_RAD)
    if by_region:
        add_region_sensors(spec, scene)
    if interpolate_person_targets:
        human.convert_to_speed_servos(spec)
    return spec.compile()


class Simulation:
    """Simulates N worlds of a scene. Each world has its own person. Each reset sets a new person."""

    def __init__(
        self,
        scene: SceneConfig,
        num_worlds: int,
        *,
        moving: bool = False,
        num_threads: int = 0,
        by_region: bool = False,
        interpolate_person_targets: bool = False,
        engine: str = THREADS,
        on_device: bool = False,
    ) -> None:
        """Compile the scene, and create the worlds.

        Args:
            scene: furniture, robot and tool.
            num_worlds: number N of worlds.
            moving: whether the people's joints move; otherwise people are static.
            num_threads: number of threads on the host; 0 means one per core.
            by_region: whether ``compute_region_force_n`` is measured. The measurement slows the simulation down, but
                does not change other results.
            interpolate_person_targets: whether joint targets of moving people are interpolated, see ``command_person``.
            engine: name of the physics engine, one of ``engines.engine.ENGINE_CHOICES``. Brakes and live sessions need
                ``threads``.
            on_device: whether states and commands are tensors on the engine's device, see ``make_engine``. Resets run
                on the host.

        Raises:
            ValueError: for an unknown engine or device, more worlds than memory allows, or options that a device does
                not support.
            RuntimeError: if a package that the engine needs is not installed.
        """
        if by_region and on_device:
            raise ValueError(
                "by_region and on_device are both true; allowed: one of them, because forces by region are "
                "measured on the host"
            )
        self.scene = scene
        self.num_worlds = num_worlds
        self.has_moving_people = moving
        self._gliding = interpolate_person_targets
        self.model = copy(_compiled(scene, moving, by_region, interpolate_person_targets))
        self.bodies = tuple(self.model.body(body).name for body in range(1, self.model.nbody))
        set_mmap_threshold()
        engine_model = remove_unused_computation(self.model)
        self.engine = make_engine(engine, engine_model, num_worlds, num_threads, on_device=on_device)
        self.batch, self._now = self.engine.batch, self.engine.world_arrays
        self._host = WorldArrays.from_batch(self.batch)
        self._names = ModelAddresses(self.model, scene)
        self._at = self._names.to_device_of(self.reference_array)
        self._person = PersonModelFields(self.batch, scene, moving)
        geoms = num_worlds, len(human.GEOMS), 2
        self._segment_w: Any = to_device_of(np.zeros((*geoms, 3)), self.reference_array)
        self._capsule_m: Any = to_device_of(np.zeros(geoms), self.reference_array)
        self._body_pos, self._body_quat = self.batch.expand("body_pos"), self.batch.expand("body_quat")
        self._speed_limit = scene.arm.speed_limit
        self._drive = scene.robot.drive
        types = [self.model.joint(robot.ROBOT_NAME_PREFIX + joint).type[0] for joint in scene.arm.joints]
        units = kinematics.compute_joint_scales(types)
        self._max_lead = MAX_SERVO_LEAD_RAD * units
        of_base = kinematics.compute_joint_scales(BASE_JOINT_TYPES if self._drive is not None else ())
        self.configuration_scales = np.concatenate([units, of_base])
        """Units of the joint positions in a configuration, see ``kinematics.Chain.compute_joint_scales``."""
        self._brakes = Brakes(self.batch, scene) if self.engine.name == THREADS else None
        self._region_forces = RegionForceSensors(self.model, self._now.sensordata) if by_region else None
        self._absent_geoms = np.zeros(0, dtype=np.intp)

    @property
    def reference_array(self) -> Any:
        """An example array with the device and data type of states and commands."""
        return self._now.qpos

    def reset(self, ids: IntArray, start: InitialState) -> None:
        """Set worlds ``ids`` (n,) to the initial states ``start``.

        All bodies are at rest, particles are on the tool, and servo targets are the joint positions.
        """
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        names, host = self._names, self._host
        for name, body in names.movable_bodies.items():
            self._body_pos[ids, body] = start.furniture_pos_w[name]
        self._body_pos[ids, names.robot_base] = start.robot_base_pos_w
        self._body_quat[ids, names.robot_base] = start.robot_base_quat_w
        self._person.write(ids, start.people)
        self.batch.set_const(ids)
        self._person.make_contacts_compliant(ids)
        host.qpos[np.ix_(ids, names.arm_qpos)] = start.joint_positions
        for joint in names.mimic_joints:
            leader = host.qpos[ids, joint.leader_qpos_index]
            host.qpos[ids, joint.qpos_index] = sum(
                share * leader**power for power, share in enumerate(joint.polynomial_coefficients)
            )
        host.act[np.ix_(ids, names.arm_act)] = start.joint_positions
        if self.has_moving_people:
            host.qpos[np.ix_(ids, names.person_qpos)] = start.people.joint_angles_rad
            if self._gliding:
                host.act[np.ix_(ids, names.person_act)] = start.people.joint_angles_rad
            else:
                host.ctrl[np.ix_(ids, names.person_ctrl)] = start.people.joint_angles_rad
        self._place_carried(ids)
        self.batch.forward(ids)
        self._show_person(ids)
        self.engine.copy_from_host(ids)
        self._now = self.engine.world_arrays

    def _show_person(self, ids: IntArray) -> None:
        """Copies sizes and positions of the people's capsules in worlds ``ids`` (n,) to the device of the states."""
        size_m = self._person.geom_size[np.ix_(ids, self._names.person_geoms)][..., :2]
        self._capsule_m[ids] = to_device_of(size_m, self._capsule_m)
        segment_w = _segments(self._host, self._names.person_geoms, size_m[..., 1:], ids)
        self._segment_w[ids] = to_device_of(segment_w, self._segment_w)

    def set_absent_arms(self, arms: Collection[Side]) -> None:
        """Remove amputated arms of the people in all worlds. Their geoms are reported at ``REMOVED_PARTICLE_POS_W``."""
        self._absent_geoms = np.flatnonzero(self._person.set_absent_arms(arms))

    def get_geoms(self, ids: IntArray) -> WorldGeoms:
        """Returns poses and sizes of all geoms in worlds ``ids`` (n,), world frame."""
        pos_w = self._host.geom_xpos[ids]
        pos_w[:, self._names.person_geoms[self._absent_geoms]] = REMOVED_PARTICLE_POS_W
        return WorldGeoms(pos_w, self._host.geom_xmat[ids], self._person.geom_size[ids])

    def set_people_joint_angles(self, ids: IntArray, joint_angles_rad: FloatArray) -> None:
        """Set the joint angles (n, 20) of moving people in worlds ``ids`` (n,), without motion."""
        self._host.qpos[np.ix_(ids, self._names.person_qpos)] = joint_angles_rad
        self.batch.forward(ids)
        self.engine.copy_from_host(ids)

    def _place_carried(self, ids: IntArray) -> None:
        """Place particles and cloth on the tools in worlds ``ids`` (n,)."""
        tool, host, names = self.scene.tool, self._host, self._names
        carried = ((tool.particles, names.particle_qpos), (tool.cloth, names.cloth_qpos))
        if all(part is None for part, _ in carried):
            return
        self.batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_POS)
        tool_pos, tool_q = host.xpos[ids, names.tool], host.xquat[ids, names.tool]
        for part, qpos in carried:
            if part is not None:
                pos = tool_pos[:, None] + transforms.rotate(tool_q[:, None], part.initial_pos)
                host.qpos[ids[:, None, None], qpos] = pos

    def command_robot(self, action: FloatArray, world_mask: BoolArray | None = None) -> None:
        """Command the robots' speeds for the next steps. Actions (N, A) in [−1, 1] are speeds divided by their limits.

        If a wheel would exceed its speed limit, the base drives the same curve more slowly. ``world_mask`` (N,) limits
        the command to some worlds; it is not available on a device.
        """
        if self._brakes is not None:
            self._brakes.release()
        at = self._at
        if world_mask is None:
            self._now.act[:, at.arm_act] = self.get_joint_targets()
            self._now.ctrl[:, at.arm_ctrl] = self._joint_speed(action)
            if self._drive is not None:
                self._now.ctrl[:, at.drive_ctrl] = self._base_velocity(action, self._drive)
        else:
            rows = np.nonzero(world_mask)[0][:, None]
            self._now.act[rows, self._names.arm_act] = self.get_joint_targets()[world_mask]
            self._now.ctrl[rows, self._names.arm_ctrl] = self._joint_speed(action[world_mask])
            if self._drive is not None:
                self._now.ctrl[rows, at.drive_ctrl] = self._base_velocity(action[world_mask], self._drive)

    def _joint_speed(self, action: FloatArray) -> FloatArray:
        """Returns the joint speeds (n, J) of actions (n, A), rad/s or m/s."""
        of_arm = action[:, : len(self._speed_limit)]
        return get_namespace(of_arm).clip(of_arm, -1.0, 1.0) * constant_like(self._speed_limit, of_arm)

    def _base_velocity(self, action: FloatArray, drive: DifferentialDrive) -> FloatArray:
        """Returns the velocity (n, 3) of the base for actions (n, A): forward, sideways (0), turning; m/s and rad/s."""
        xp, of_drive = get_namespace(action), action[:, len(self._speed_limit) :]
        forward, turn = (xp.clip(of_drive, -1.0, 1.0) * constant_like(drive.speed_limit, of_drive)).T
        wheel = xp.abs(forward) + 0.5 * drive.track_width_m * xp.abs(turn)
        share = drive.speed_limit_m_s / xp.maximum(wheel, drive.speed_limit_m_s)
        return xp.stack([share * forward, 0.0 * forward, share * turn], axis=-1)

    def brake_robot(self) -> None:
        """Apply the brakes of arms and drives. Servo targets become the current joint positions."""
        at = self._at
        if self._brakes is not None:
            self._brakes.engage()
        self._now.act[:, at.arm_act] = self._now.qpos[:, at.arm_qpos]
        self._now.ctrl[:, at.arm_ctrl] = 0.0
        if self._drive is not None:
            self._now.ctrl[:, at.drive_ctrl] = 0.0

    def command_person(self, joint_targets_rad: FloatArray, world_mask: BoolArray | None = None) -> None:
        """Set the targets (N, 20) of a moving person's servos.

        With ``interpolate_person_targets``, the servo inputs change linearly to the targets in 0.1 s. ``world_mask``
        (N,) limits the command to some worlds; it is not available on a device.
        """
        at, command = self._at, joint_targets_rad
        if self._gliding:
            command = (joint_targets_rad - self._now.act[:, at.person_act]) / CONTROL_STEP_S
        if world_mask is None:
            self._now.ctrl[:, at.person_ctrl] = command
        else:
            self._now.ctrl[np.nonzero(world_mask)[0][:, None], self._names.person_ctrl] = command[world_mask]

    def step(self, substeps: int = DEFAULT_SUBSTEPS, person_targets_rad: FloatArray | None = None) -> None:
        """Advance all worlds by physics steps. Forces are from the last step, positions from its end.

        ``person_targets_rad`` (``substeps``, N, 20): targets of the servos of moving people for each physics step. This
        argument is not available with ``interpolate_person_targets``.
        """
        if person_targets_rad is None:
            self.engine.step(substeps)
        else:
            self.engine.step_with_controls(self._at.person_ctrl, person_targets_rad)
        self._now = self.engine.world_arrays

    def check_overflow(self) -> None:
        """Check all steps since the last check for overflow. On a device, call this method once per episode.

        Raises:
            RuntimeError: if the contacts or constraints of a world exceeded the engine's memory.
        """
        self.engine.check_overflow()

    def remove_particles(self, removed: BoolArray) -> None:
        """Move the particles of the mask ``removed`` (N, K) to ``REMOVED_PARTICLE_POS_W``, and cancel their weight."""
        particles, xp, at, now = self.scene.tool.particles, get_namespace(removed), self._at, self._now
        if particles is None or (xp is np and not removed.any()):
            return
        number, each = np.arange(len(particles.bodies)), removed[:, :, None]
        spots = REMOVED_PARTICLE_POS_W + np.stack([0.02 * number, 0.0 * number, 0.0 * number], axis=-1)
        pos, velocity = now.qpos[:, at.particle_qpos], now.qvel[:, at.particle_dof]
        now.qpos[:, at.particle_qpos] = xp.where(each, constant_like(spots, pos), pos)
        now.qvel[:, at.particle_dof] = xp.where(each, 0.0, velocity)
        push = now.qfrc_applied[:, at.particle_dof[:, 2]]
        weight_n = -float(self.model.opt.gravity[2]) * particles.mass_kg
        now.qfrc_applied[:, at.particle_dof[:, 2]] = xp.where(removed, weight_n, push)

    def get_state(self) -> State:
        """Returns the physical state of all worlds, in new arrays; see ``State``."""
        at, now = self._at, self._now
        sensors, xp = now.sensordata, get_namespace(now.sensordata)
        by_tool = copy_as_float(sensors[:, at.tool_contacts]).reshape(self.num_worlds, MAX_TOOL_CONTACTS, 9)
        by_robot = sensors[:, at.robot_contacts].reshape(self.num_worlds, MAX_ROBOT_CONTACTS, 3)
        tool_contact_force_n, total_force_n = norm(by_tool[..., :3]), _added_up(norm(by_robot))
        links_force_n = xp.maximum(total_force_n - _added_up(tool_contact_force_n), 0.0)
        robot_force, tool_force = sensors[:, at.robot_force], sensors[:, at.tool_force]
        cloth_force_n = xp.zeros_like(total_force_n)
        if self.scene.tool.cloth is not None:
            by_any = sensors[:, at.person_contacts].reshape(self.num_worlds, MAX_PERSON_CONTACTS, 3)
            any_force, any_force_n = sensors[:, at.person_force], _added_up(norm(by_any))
            cloth_force_n = xp.maximum(any_force_n - total_force_n, 0.0)
            robot_force, tool_force = any_force, tool_force + any_force - robot_force
            total_force_n = any_force_n
        return State(
            robot_torso_pos_w=copy_as_float(now.xpos[:, at.robot_torso]),
            joint_positions=self.get_joint_positions(),
            base_displacement=self.get_base_displacement(),
            end_effector_velocity_w=copy_as_float(sensors[:, at.end_effector_velocity]),
            tool_velocity_w=copy_as_float(sensors[:, at.tool_velocity]),
            tool_pos_w=copy_as_float(now.xpos[:, at.tool]),
            tool_quat_w=copy_as_float(now.xquat[:, at.tool]),
            tool_pad_pos_w=copy_as_float(now.xpos[:, at.pad]),
            tool_pad_quat_w=copy_as_float(now.xquat[:, at.pad]),
            head_pos_w=copy_as_float(now.site_xpos[:, at.head_centre]),
            head_quat_w=copy_as_float(now.xquat[:, at.head]),
            mouth_pos_w=copy_as_float(now.site_xpos[:, at.mouth]),
            **vars(self.get_arm_poses()),
            furniture_pos_w={
                name: copy_as_float(now.xpos[:, body]) for name, body in at.movable_bodies.items()
            },
            particle_pos_w=now.qpos[:, at.particle_qpos],
            particle_velocity_w=now.qvel[:, at.particle_dof],
            cloth_pos_w=now.qpos[:, at.cloth_qpos],
            person_capsule_ends_w=self._person_segments(),
            person_radius_m=copy_as_float(self._capsule_m[..., 0]),
            robot_force_n=norm(robot_force),
            tool_force_n=norm(tool_force),
            total_force_n=total_force_n,
            links_force_n=links_force_n,
            cloth_force_n=cloth_force_n,
            tool_contact_pos_w=by_tool[..., 3:6],
            tool_contact_normal_w=by_tool[..., 6:],
            tool_contact_force_n=tool_contact_force_n,
        )

    def get_tool_net_force_n(self) -> FloatArray:
        """Returns the magnitude (N,) of the tool's net contact force on the person in the last physics step."""
        return norm(self._now.sensordata[:, self._at.tool_force])

    def compute_region_force_n(self) -> FloatArray:
        """Returns the forces (N, R) on ``BODY_REGIONS`` in the last physics step, in newtons.

        Each force is the sum of the magnitudes of all contact forces on the region.

        Raises:
            RuntimeError: if these forces are not measured.
        """
        if self._region_forces is None:
            raise RuntimeError(
                "forces by body region are not measured; create the simulation with by_region=True"
            )
        return self._region_forces.read_forces_n()

    def get_arm_poses(self) -> ArmPoses:
        """Returns the poses of the people's arms, in new arrays."""
        pos_w, q_w, at = self._now.xpos, self._now.xquat, self._at
        return ArmPoses(
            pos_w[:, at.right_arm], q_w[:, at.right_arm], pos_w[:, at.left_arm], q_w[:, at.left_arm]
        )

    def get_hips_pose(self) -> tuple[FloatArray, FloatArray]:
        """Returns the poses of the people's hips: positions (N, 3), quaternions (N, 4), world frame."""
        body = self._names.hips
        return self._now.xpos[:, body].copy(), self._now.xquat[:, body].copy()

    def get_initial_base_pose(self) -> tuple[FloatArray, FloatArray]:
        """Returns the initial poses of the robots' bases: positions (N, 3), quaternions (N, 4), world frame."""
        body = self._names.robot_base
        return self._body_pos[:, body].copy(), self._body_quat[:, body].copy()

    def get_base_pose(self) -> tuple[FloatArray, FloatArray]:
        """Returns the current poses of the robots' bases: positions (N, 3), quaternions (N, 4), world frame."""
        if self._drive is None:
            return self.get_initial_base_pose()
        body = self._names.robot_base
        return copy_as_float(self._now.xpos[:, body]), copy_as_float(self._now.xquat[:, body])

    def get_furniture_pos_w(self) -> dict[str, FloatArray]:
        """Returns the positions (N, 3) of the scene's movable furniture, by body, world frame."""
        return {name: self._body_pos[:, body].copy() for name, body in self._names.movable_bodies.items()}

    def get_joint_positions(self) -> FloatArray:
        """Returns the joint positions of the arm, (N, J), rad or m."""
        return self._now.qpos[:, self._at.arm_qpos]

    def get_base_displacement(self) -> FloatArray:
        """Returns the displacement of driving bases from their start, (N, 3): x, y (m) and yaw (rad).

        The values are in the frame of the base's start pose. The shape is (N, 0) for robots without a drive.
        """
        return self._now.qpos[:, self._at.drive_qpos]

    def get_configuration(self) -> FloatArray:
        """Returns the configuration of the robots: ``joint_positions`` and ``base_displacement``, (N, J) or (N, J +
        3).
        """
        return np.concatenate([self.get_joint_positions(), self.get_base_displacement()], axis=-1)

    def compute_action_to_configuration(self, configuration: FloatArray, duration_s: float) -> FloatArray:
        """Returns the speeds (N, A) that reach a configuration after ``duration_s``, divided by the speed limits.

        The motion of an arm starts at its servo targets. A drive covers the forward distance and the rotation, but not
        a sideways distance.
        """
        share = (configuration[:, : len(self._speed_limit)] - self.get_joint_targets()) / (
            duration_s * self._speed_limit
        )
        if self._drive is None:
            return share
        x, y, yaw = (configuration[:, len(self._speed_limit) :] - self.get_base_displacement()).T
        sine, cosine = elementary.sine_and_cosine(self.get_base_displacement()[:, 2])
        motion = np.stack([cosine * x + sine * y, yaw], axis=-1)
        return np.concatenate([share, motion / (duration_s * self._drive.speed_limit)], axis=-1)

    def get_joint_targets(self) -> FloatArray:
        """Returns the targets (N, J) of the arm's servos, at most ``MAX_SERVO_LEAD_RAD`` from the joint positions."""
        positions, targets = self.get_joint_positions(), self._now.act[:, self._at.arm_act]
        lead = constant_like(self._max_lead, targets)
        return get_namespace(targets).clip(targets, positions - lead, positions + lead)

    def get_servo_commands(self) -> FloatArray:
        """Returns the inputs (N, nu) of all servos, MuJoCo's ``ctrl``."""
        return copy_as_float(self._now.ctrl)

    def get_integration_state(self, world: int = 0) -> FloatArray:
        """Returns the state of one world that determines the next step: MuJoCo's ``mjSTATE_INTEGRATION`` vector."""
        self.engine.copy_to_host(np.array([world]))
        return self.batch.state[world].copy()

    def set_integration_state(self, state: FloatArray, world: int = 0) -> None:
        """Set the state of one world to a result of ``get_integration_state``."""
        self.batch.state[world] = state
        self.batch.forward(np.array([world]), stage=mujoco.mjtStage.mjSTAGE_VEL)
        self.engine.copy_from_host(np.array([world]))

    def snapshot(self) -> dict[str, dict[str, NumpyArray]]:
        """Returns all data that determine the next steps of all worlds, and the current sensor values, by name."""
        self.engine.copy_to_host(np.arange(self.num_worlds))
        return {
            "fields": {name: array.copy() for name, array in self._expanded().items()},
            "worlds": {
                "state": self.batch.state.copy(),
                "segment_w": to_numpy(copy_as_float(self._segment_w)),
                "sensordata": to_numpy(copy_as_float(self._now.sensordata)),
            },
        }

    def restore(self, snapshot: Mapping[str, Mapping[str, NumpyArray]]) -> None:
        """Restores the state from the result of ``snapshot``. Both simulations must have the same arguments."""
        for again in (False, True):  # set_const computes constants from the fields and changes some fields
            for name, array in self._expanded().items():
                array[:] = snapshot["fields"][name]
            if not again:
                self.batch.set_const()
        self.batch.state[:] = snapshot["worlds"]["state"]
        self.batch.forward(stage=mujoco.mjtStage.mjSTAGE_VEL)
        everywhere = np.arange(self.num_worlds)
        self._show_person(everywhere)
        self._segment_w[:] = to_device_of(snapshot["worlds"]["segment_w"], self._segment_w)
        self.engine.copy_from_host(everywhere)
        forces = snapshot["worlds"]["sensordata"].copy()  # the last step is not repeated
        self._now = replace(self.engine.world_arrays, sensordata=to_device_of(forces, self.reference_array))

    def _expanded(self) -> dict[str, NumpyArray]:
        """Returns the values of the model fields that differ between worlds, by name."""
        names = [name for name in dir(self.model) if isinstance(getattr(self.model, name, None), np.ndarray)]
        names += [f"opt.{name}" for name in dir(self.model.opt) if not name.startswith("_")]
        return {name: self.batch.expand(name) for name in names if _is_expanded(self.batch, name)}

    def get_qpos(self, world: int) -> FloatArray:
        """Returns the joint coordinates (nq,) of one world."""
        return np.array(to_numpy(self._now.qpos[world]), float)

    def get_body_poses(self, world: int) -> FloatArray:
        """Returns the poses (B, 7) of one world's ``bodies``: x, y, z, then w, x, y, z; world frame."""
        poses = np.empty((len(self.bodies), 7))
        poses[:, :3], poses[:, 3:] = to_numpy(self._now.xpos[world, 1:]), to_numpy(self._now.xquat[world, 1:])
        return poses

    def get_person_joint_angles_rad(self) -> FloatArray:
        """Returns the current joint angles (N, 20) of moving people, radians."""
        return self._now.qpos[:, self._at.person_qpos]

    def _person_segments(self) -> FloatArray:
        if not self.has_moving_people:
            segment_w = copy_as_float(self._segment_w)
        else:
            segment_w = _segments(self._now, self._at.person_geoms, self._capsule_m[..., 1:])
        if len(self._absent_geoms):
            segment_w[:, self._absent_geoms] = constant_like(REMOVED_PARTICLE_POS_W, segment_w)
        return segment_w


def _segments(
    arrays: WorldArrays, geoms: IntArray, half_length_m: FloatArray, ids: IntArray | slice = slice(None)
) -> FloatArray:
    """Returns the axis ends (n, G, 2, 3) of capsules with half lengths (n, G, 1) in worlds ``ids`` (n,)."""
    axis, centre = arrays.geom_xmat[ids][:, geoms, 2::3], arrays.geom_xpos[ids][:, geoms]
    reach = axis * half_length_m
    return get_namespace(centre).stack([centre - reach, centre + reach], axis=2)


def _is_expanded(batch: Batch, name: str) -> bool:
    try:
        return batch.expanded(name) is not None
    except (AttributeError, KeyError, TypeError, ValueError):  # the batch does not have this field
        return False


def _added_up(strongest_first: FloatArray) -> FloatArray:
    """Returns the sums (N,) of forces (N, C). They are added in order, and zeros at the end therefore change no bit."""
    return get_namespace(strongest_first).cumulative_sum(strongest_first, axis=-1)[:, -1]
