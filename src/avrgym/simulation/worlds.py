"""N worlds of one scene, stepped together by an engine."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.models import human, yielding
from avrgym.models.human import Person
from avrgym.models.scene import (
    CONTROL_STEP_S,
    ROBOT_CONTACTS,
    SUBSTEPS,
    TOOL_CONTACTS,
    SceneConfig,
    add_region_sensors,
    build_spec,
)
from avrgym.simulation.brakes import Brakes
from avrgym.simulation.engines.engine import Arrays, make_engine
from avrgym.simulation.names import Names
from avrgym.simulation.person_fields import PersonFields
from avrgym.simulation.region_forces import RegionForces
from avrgym.simulation.room import Geoms
from avrgym.simulation.state import RightArm, Start, State
from avrgym.system.engines import THREADS
from avrgym.system.memory import return_large_blocks

__all__ = ["MAX_LEAD_RAD", "PARKING_W", "Ids", "RightArm", "Simulation", "Start", "State"]

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

MAX_LEAD_RAD = 0.08
"""How far a joint's target may run ahead of the joint: it bounds what a blocked servo presses with."""


PARKING_W = np.array([4.0, 4.0, 0.1])
"""Where particles stay that have left the task: far from everything, weightless, so that they touch nothing."""


class Simulation:
    """N worlds of a scene, each with a person of its own who is set at every reset."""

    def __init__(
        self,
        scene: SceneConfig,
        num_worlds: int,
        *,
        moving: bool = False,
        num_threads: int = 0,
        braked: bool = True,
        gives_way: bool = True,
        by_region: bool = False,
        gliding: bool = False,
        engine: str = THREADS,
    ) -> None:
        """Compile the scene.

        Args:
            scene: what stands in it.
            num_worlds: N.
            moving: whether the people's joints move; else people are static.
            num_threads: threads of the host; 0 takes one per core.
            braked: whether the arm's joints have brakes.
            gives_way: whether people give way and motors press no harder than they lead, see ``models.yielding``.
            by_region: whether ``region_force_n`` is measured, which takes time and changes nothing else.
            gliding: whether moving people go evenly from one target to the next, see ``command_person``.
            engine: where physics runs, one of ``engines.engine.ENGINES``. Brakes and live sessions need threads.

        Raises:
            ValueError: for an unknown engine or device, or more worlds than there is memory for.
            RuntimeError: where what the engine needs is not installed.
        """
        self.scene = scene
        self.num_worlds = num_worlds
        self.moving = moving
        self._gliding = gliding
        spec = build_spec(scene, Person(), moving=moving, appearance=False)
        if gives_way:
            yielding.bound_forces(spec, scene.arm, scene.tool, MAX_LEAD_RAD)
        if by_region:
            add_region_sensors(spec, scene)
        if gliding:
            human.let_targets_glide(spec)
        self.model = spec.compile()
        self.bodies = tuple(self.model.body(body).name for body in range(1, self.model.nbody))
        return_large_blocks()
        self.engine = make_engine(engine, self.model, num_worlds, num_threads)
        self.batch, self._now = self.engine.batch, self.engine.now
        self._host = Arrays.of(self.batch)
        self._names = Names(self.model, scene)
        self._person = PersonFields(self.batch, scene, moving, gives_way=gives_way)
        self._segment_w = np.zeros((num_worlds, len(human.GEOMS), 2, 3))
        self._body_pos, self._body_quat = self.batch.expand("body_pos"), self.batch.expand("body_quat")
        self._speed_limit = scene.arm.speed_limit_rad_s
        self._brakes = Brakes(self.batch, scene.arm) if braked and self.engine.name == THREADS else None
        self._region_forces = RegionForces(self.model, self._now.sensordata) if by_region else None

    def reset(self, ids: Ids, start: Start) -> None:
        """Put worlds ``ids`` (n,) into their start: at rest, particles on the tool, the arm where it aims."""
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        names, host = self._names, self._host
        for name, body in names.placed.items():
            self._body_pos[ids, body] = start.placed_pos_w[name]
        self._body_pos[ids, names.robot_base] = start.robot_pos_w
        self._body_quat[ids, names.robot_base] = start.robot_q_w
        self._person.write(ids, start.people)
        self.batch.set_const(ids)
        self._person.give_way(ids)
        host.qpos[np.ix_(ids, names.arm_qpos)] = start.arm_angles_rad
        host.act[np.ix_(ids, names.arm_act)] = start.arm_angles_rad
        if self.moving:
            host.qpos[np.ix_(ids, names.person_qpos)] = start.people.joint_angles_rad
            if self._gliding:
                host.act[np.ix_(ids, names.person_act)] = start.people.joint_angles_rad
            else:
                host.ctrl[np.ix_(ids, names.person_ctrl)] = start.people.joint_angles_rad
        self._place_particles(ids)
        self.batch.forward(ids)
        self._segment_w[ids] = self._person_segments(host, ids)
        self.engine.take_over(ids)
        self._now = self.engine.now

    def geoms(self, ids: Ids) -> Geoms:
        """All geoms of worlds ``ids`` (n,), as they are."""
        host = self._host
        return Geoms(host.geom_xpos[ids], host.geom_xmat[ids], self._person.geom_size[ids])

    def pose_people(self, ids: Ids, joint_angles_rad: Array) -> None:
        """Put moving people of worlds ``ids`` (n,) into poses (n, 20), at once."""
        self._host.qpos[np.ix_(ids, self._names.person_qpos)] = joint_angles_rad
        self.batch.forward(ids)
        self.engine.take_over(ids)

    def _place_particles(self, ids: Ids) -> None:
        particles, host = self.scene.tool.particles, self._host
        if particles is None:
            return
        self.batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_POS)
        tool_pos, tool_q = host.xpos[ids, self._names.tool], host.xquat[ids, self._names.tool]
        pos = tool_pos[:, None] + transforms.rotate(tool_q[:, None], particles.start)
        host.qpos[ids[:, None, None], self._names.particle_qpos] = pos

    def command_robot(self, action: Array) -> None:
        """Set the arm's speed for the coming steps: action (N, J) in −1..1 of each joint's speed limit."""
        if self._brakes is not None:
            self._brakes.release()
        self.amend_robot(action, np.ones(self.num_worlds, dtype=bool))

    def amend_robot(self, action: Array, which: NDArray[np.bool_]) -> None:
        """Set it anew in some worlds (N,), whose robots have been commanded before."""
        rows, names = np.nonzero(which)[0][:, None], self._names
        self._now.act[rows, names.arm_act] = self.arm_targets_rad()[which]
        self._now.ctrl[rows, names.arm_ctrl] = np.clip(action[which], -1.0, 1.0) * self._speed_limit

    def halt_robot(self) -> None:
        """Brake the arms: they stop at once and hold where they came to rest. Each servo aims at where its joint is."""
        names = self._names
        if self._brakes is not None:
            self._brakes.put_on()
        self._now.act[:, names.arm_act] = self._now.qpos[:, names.arm_qpos]
        self._now.ctrl[:, names.arm_ctrl] = 0.0

    def command_person(self, joint_targets_rad: Array) -> None:
        """Set the targets (N, 20) of a moving person's servos, to be had at once or, gliding, a control step later."""
        names = self._names
        if self._gliding:
            way = joint_targets_rad - self._now.act[:, names.person_act]
            self._now.ctrl[:, names.person_ctrl] = way / CONTROL_STEP_S
        else:
            self._now.ctrl[:, names.person_ctrl] = joint_targets_rad

    def step(self, substeps: int = SUBSTEPS) -> None:
        """Advance all worlds by physics steps; forces are of the last one, positions of its end."""
        self.engine.step(substeps)
        self._now = self.engine.now

    def park(self, gone: NDArray[np.bool_]) -> None:
        """Take particles (N, K) out of play."""
        particles = self.scene.tool.particles
        if particles is None:
            return
        world, particle = np.nonzero(gone)
        columns = self._names.particle_qpos[particle]
        spots = PARKING_W + np.stack([0.02 * particle, 0.0 * particle, 0.0 * particle], axis=-1)
        self._now.qpos[world[:, None], columns] = spots
        dof = self._names.particle_dof[particle]
        self._now.qvel[world[:, None], dof] = 0.0
        self._now.qfrc_applied[world, dof[:, 2]] = -self.model.opt.gravity[2] * particles.mass_kg

    def state(self) -> State:
        """The state of all worlds, in arrays of its own."""
        names = self._names
        sensors = self._now.sensordata
        by_tool = sensors[:, names.tool_contacts].copy().reshape(self.num_worlds, TOOL_CONTACTS, 9)
        by_robot = sensors[:, names.robot_contacts].reshape(self.num_worlds, ROBOT_CONTACTS, 3)
        tool_contact_force_n, total_force_n = norm(by_tool[..., :3]), _added_up(norm(by_robot))
        return State(
            robot_pos_w=self._now.xpos[:, names.robot_torso].copy(),
            arm_angles_rad=self.arm_angles_rad(),
            effector_velocity_w=sensors[:, names.effector_velocity].copy(),
            tool_velocity_w=sensors[:, names.tool_velocity].copy(),
            tool_pos_w=self._now.xpos[:, names.tool].copy(),
            tool_q_w=self._now.xquat[:, names.tool].copy(),
            pad_pos_w=self._now.xpos[:, names.pad].copy(),
            pad_q_w=self._now.xquat[:, names.pad].copy(),
            head_pos_w=self._now.site_xpos[:, names.head_centre].copy(),
            head_q_w=self._now.xquat[:, names.head].copy(),
            mouth_pos_w=self._now.site_xpos[:, names.mouth].copy(),
            **vars(self.right_arm()),
            placed_pos_w={name: self._now.xpos[:, body].copy() for name, body in names.placed.items()},
            particle_pos_w=self._now.qpos[:, names.particle_qpos],
            particle_velocity_w=self._now.qvel[:, names.particle_dof],
            person_segment_w=self._person_segments(self._now) if self.moving else self._segment_w.copy(),
            person_radius_m=self._person.geom_size[:, names.person_geoms, 0],
            robot_force_n=norm(sensors[:, names.robot_force]),
            tool_force_n=norm(sensors[:, names.tool_force]),
            total_force_n=total_force_n,
            links_force_n=np.maximum(total_force_n - _added_up(tool_contact_force_n), 0.0),
            tool_contact_pos_w=by_tool[..., 3:6],
            tool_contact_normal_w=by_tool[..., 6:],
            tool_contact_force_n=tool_contact_force_n,
        )

    def region_force_n(self) -> Array:
        """The forces on each of ``BODY_REGIONS`` in the last physics step, (N, R), added up as ``total_force_n`` is.

        Raises:
            RuntimeError: where they are not measured.
        """
        if self._region_forces is None:
            raise RuntimeError("forces by region are measured only in simulations made with by_region=True")
        return self._region_forces.now_n()

    def right_arm(self) -> RightArm:
        """The people's right arms, in arrays of their own."""
        return RightArm(self._now.xpos[:, self._names.right_arm], self._now.xquat[:, self._names.right_arm])

    def hips(self) -> tuple[Array, Array]:
        """Where the people's hips are: positions (N, 3), quaternions (N, 4), world frame."""
        body = self._names.hips
        return self._now.xpos[:, body].copy(), self._now.xquat[:, body].copy()

    def robot_base(self) -> tuple[Array, Array]:
        """Where the robots' bases stand: positions (N, 3), quaternions (N, 4), world frame."""
        body = self._names.robot_base
        return self._body_pos[:, body].copy(), self._body_quat[:, body].copy()

    def placed_pos_w(self) -> dict[str, Array]:
        """Where the furniture stands that every episode places, (N, 3) by body, world frame."""
        return {name: self._body_pos[:, body].copy() for name, body in self._names.placed.items()}

    def arm_angles_rad(self) -> Array:
        """Where the arm's joints are, (N, J)."""
        return self._now.qpos[:, self._names.arm_qpos]

    def arm_targets_rad(self) -> Array:
        """Where the arm's servos aim, (N, J): no farther ahead of the joints than a command leaves them."""
        angles = self.arm_angles_rad()
        return np.clip(self._now.act[:, self._names.arm_act], angles - MAX_LEAD_RAD, angles + MAX_LEAD_RAD)

    def controls(self) -> Array:
        """What all servos are told, (N, nu)."""
        return self._now.ctrl.copy()

    def integration_state(self, world: int = 0) -> Array:
        """Everything that the next step depends on, as MuJoCo's ``mjSTATE_INTEGRATION`` vector."""
        self.engine.hand_back(np.array([world]))
        return self.batch.state[world].copy()

    def restore(self, state: Array, world: int = 0) -> None:
        """Put one world into a state that ``integration_state`` gave."""
        self.batch.state[world] = state
        self.batch.forward(np.array([world]), stage=mujoco.mjtStage.mjSTAGE_VEL)
        self.engine.take_over(np.array([world]))

    def saved(self) -> dict[str, dict[str, NDArray[Any]]]:
        """All that the next steps of all worlds depend on, and what they show now."""
        self.engine.hand_back(np.arange(self.num_worlds))
        return {
            "fields": {name: array.copy() for name, array in self._expanded().items()},
            "worlds": {
                "state": self.batch.state.copy(),
                "segment_w": self._segment_w.copy(),
                "sensordata": self._now.sensordata.copy(),
            },
        }

    def go_on_from(self, saved: Mapping[str, Mapping[str, NDArray[Any]]]) -> None:
        """Put all worlds into what ``saved`` gave in a simulation made alike."""
        for again in (False, True):  # constants follow from the fields, of which some are then changed
            for name, array in self._expanded().items():
                array[:] = saved["fields"][name]
            if not again:
                self.batch.set_const()
        self.batch.state[:] = saved["worlds"]["state"]
        self.batch.forward(stage=mujoco.mjtStage.mjSTAGE_VEL)
        self._segment_w[:] = saved["worlds"]["segment_w"]
        self.engine.take_over(np.arange(self.num_worlds))
        forces = saved["worlds"]["sensordata"].copy()  # of a step that is not made again
        self._now = replace(self.engine.now, sensordata=forces)

    def _expanded(self) -> dict[str, NDArray[Any]]:
        """The model's fields of which every world has its own, by name."""
        names = [name for name in dir(self.model) if isinstance(getattr(self.model, name, None), np.ndarray)]
        names += [f"opt.{name}" for name in dir(self.model.opt) if not name.startswith("_")]
        return {name: self.batch.expand(name) for name in names if _is_expanded(self.batch, name)}

    def qpos(self, world: int) -> Array:
        """The joint coordinates (nq,) of one world."""
        return self._now.qpos[world].copy()

    def body_poses(self, world: int) -> Array:
        """Poses (B, 7) of one world's ``bodies``: x, y, z, then w, x, y, z; world frame."""
        poses = np.empty((len(self.bodies), 7))
        poses[:, :3], poses[:, 3:] = self._now.xpos[world, 1:], self._now.xquat[world, 1:]
        return poses

    def person_angles_rad(self) -> Array:
        """The joint angles (N, 20) of the moving person."""
        return self._now.qpos[:, self._names.person_qpos]

    def _person_segments(self, arrays: Arrays, ids: Ids | slice = slice(None)) -> Array:
        geoms = self._names.person_geoms
        axis = arrays.geom_xmat[ids][:, geoms, 2::3]
        centre = arrays.geom_xpos[ids][:, geoms]
        reach = axis * self._person.geom_size[ids][:, geoms, 1:2]
        return np.stack([centre - reach, centre + reach], axis=2)


def _is_expanded(batch: Batch, name: str) -> bool:
    try:
        return batch.expanded(name) is not None
    except (AttributeError, KeyError, TypeError, ValueError):  # none that a batch knows
        return False


def _added_up(strongest_first: Array) -> Array:
    """The sums (N,) of forces (N, C), one after the other, so that empty slots at the end change no bit."""
    return strongest_first.cumsum(axis=-1)[:, -1]
