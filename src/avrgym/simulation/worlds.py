"""N worlds of one scene, stepped together on threads."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.models import human, robot, yielding
from avrgym.models.human import People, Person
from avrgym.models.scene import (
    CONTROL_STEP_S,
    EFFECTOR_VELOCITY_SENSOR,
    ROBOT_CONTACT_SENSOR,
    ROBOT_CONTACTS,
    ROBOT_FORCE_SENSOR,
    SUBSTEPS,
    TOOL,
    TOOL_CONTACT_SENSOR,
    TOOL_CONTACTS,
    TOOL_FORCE_SENSOR,
    TOOL_VELOCITY_SENSOR,
    SceneConfig,
    add_region_sensors,
    build_spec,
)
from avrgym.simulation.brakes import Brakes
from avrgym.simulation.region_forces import RegionForces
from avrgym.simulation.room import Geoms
from avrgym.system.memory import return_large_blocks

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

MAX_LEAD_RAD = 0.08
"""How far a joint's target may run ahead of the joint: it bounds what a blocked servo presses with."""


PARKING_W = np.array([4.0, 4.0, 0.1])
"""Where particles stay that have left the task: far from everything, weightless, so that they touch nothing."""


@dataclass(frozen=True)
class RightArm:
    """The frames of upper arm, forearm and hand: shoulder, elbow and wrist; (N, 3, 3) and (N, 3, 4), world frame."""

    right_arm_pos_w: Array
    right_arm_q_w: Array


@dataclass(frozen=True)
class State(RightArm):
    """What tasks see of N worlds at one instant; metres, seconds, radians, newtons, world frame.

    Positions are (N, 3), quaternions (N, 4). ``robot_pos_w`` is the robot's torso, or its base where it has none. The
    pad is what of the tool touches people, see ``Tool``. ``placed_pos_w`` holds the furniture that every episode
    places, by body. ``particle_*`` have shape (N, K, 3); ``person_segment_w`` (N, G, 2, 3) holds the axes' ends of the
    G capsules of the person's body, in the order of ``human.GEOMS``, and ``person_radius_m`` (N, G) their radii.
    ``tool_contact_*`` (N, ``TOOL_CONTACTS``, …) are the tool's strongest contacts with the person; force zero where
    there is none; normals point from the tool to the person.

    Forces on the person, (N,): ``robot_force_n`` and ``tool_force_n`` are the lengths of the net forces of robot with
    tool and of the tool, in which what presses from two sides cancels out. ``total_force_n`` and ``links_force_n``
    add up the lengths of the forces of single contacts, of the robot with its tool and of its links alone.
    """

    robot_pos_w: Array
    arm_angles_rad: Array
    effector_velocity_w: Array
    tool_velocity_w: Array
    tool_pos_w: Array
    tool_q_w: Array
    pad_pos_w: Array
    pad_q_w: Array
    head_pos_w: Array
    head_q_w: Array
    mouth_pos_w: Array
    placed_pos_w: Mapping[str, Array]
    particle_pos_w: Array
    particle_velocity_w: Array
    person_segment_w: Array
    person_radius_m: Array
    robot_force_n: Array
    tool_force_n: Array
    total_force_n: Array
    links_force_n: Array
    tool_contact_pos_w: Array
    tool_contact_normal_w: Array
    tool_contact_force_n: Array


@dataclass(frozen=True)
class Start:
    """How n worlds begin.

    The people; the robot's base, (n, 3) and (n, 4); the arm's angles (n, J); places (n, 3) of the scene's
    movable furniture.
    """

    people: People
    robot_pos_w: Array
    robot_q_w: Array
    arm_angles_rad: Array
    placed_pos_w: Mapping[str, Array]


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
    ) -> None:
        """Compile the scene.

        Args:
            scene: what stands in it.
            num_worlds: N.
            moving: whether the people's joints move; else people are static.
            num_threads: threads for the physics; 0 takes one per core.
            braked: whether the arm's joints have brakes.
            gives_way: whether people give way and motors press no harder than they lead, see ``models.yielding``.
            by_region: whether ``region_force_n`` is measured, which takes time and changes nothing else.
            gliding: whether moving people go evenly from one target to the next, see ``command_person``.
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
        self.batch = Batch(self.model, num_worlds, num_threads, persistent=True)
        self._names = _Names(self.model, scene)
        self._person = _PersonFields(self.batch, scene, moving, gives_way=gives_way)
        self._qpos, self._qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self._act, self._ctrl = self.batch.bind("act"), self.batch.bind("ctrl")
        self._qfrc_applied = self.batch.bind("qfrc_applied")
        self._xpos, self._xquat = self.batch.bind("xpos"), self.batch.bind("xquat")
        self._site_xpos, self._measured = self.batch.bind("site_xpos"), self.batch.bind("sensordata")
        self._sensordata = self._measured
        self._geom_xpos, self._geom_xmat = self.batch.bind("geom_xpos"), self.batch.bind("geom_xmat")
        self._segment_w = np.zeros((num_worlds, len(human.GEOMS), 2, 3))
        self._body_pos, self._body_quat = self.batch.expand("body_pos"), self.batch.expand("body_quat")
        self._speed_limit = scene.arm.speed_limit_rad_s
        self._brakes = Brakes(self.batch, scene.arm) if braked else None
        self._region_forces = RegionForces(self.batch) if by_region else None

    def reset(self, ids: Ids, start: Start) -> None:
        """Put worlds ``ids`` (n,) into their start: at rest, particles on the tool, the arm where it aims."""
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        names = self._names
        for name, body in names.placed.items():
            self._body_pos[ids, body] = start.placed_pos_w[name]
        self._body_pos[ids, names.robot_base] = start.robot_pos_w
        self._body_quat[ids, names.robot_base] = start.robot_q_w
        self._person.write(ids, start.people)
        self.batch.set_const(ids)
        self._person.give_way(ids)
        self._qpos[np.ix_(ids, names.arm_qpos)] = start.arm_angles_rad
        self._act[np.ix_(ids, names.arm_act)] = start.arm_angles_rad
        if self.moving:
            self._qpos[np.ix_(ids, names.person_qpos)] = start.people.joint_angles_rad
            if self._gliding:
                self._act[np.ix_(ids, names.person_act)] = start.people.joint_angles_rad
            else:
                self._ctrl[np.ix_(ids, names.person_ctrl)] = start.people.joint_angles_rad
        self._place_particles(ids)
        self.batch.forward(ids)
        self._segment_w[ids] = self._person_segments(ids)
        self._sensordata = self._measured

    def geoms(self, ids: Ids) -> Geoms:
        """All geoms of worlds ``ids`` (n,), as they are."""
        return Geoms(self._geom_xpos[ids], self._geom_xmat[ids], self._person.geom_size[ids])

    def pose_people(self, ids: Ids, joint_angles_rad: Array) -> None:
        """Put moving people of worlds ``ids`` (n,) into poses (n, 20), at once."""
        self._qpos[np.ix_(ids, self._names.person_qpos)] = joint_angles_rad
        self.batch.forward(ids)

    def _place_particles(self, ids: Ids) -> None:
        particles = self.scene.tool.particles
        if particles is None:
            return
        self.batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_POS)
        tool_pos, tool_q = self._xpos[ids, self._names.tool], self._xquat[ids, self._names.tool]
        pos = tool_pos[:, None] + transforms.rotate(tool_q[:, None], particles.start)
        self._qpos[ids[:, None, None], self._names.particle_qpos] = pos

    def command_robot(self, action: Array) -> None:
        """Set the arm's speed for the coming steps: action (N, J) in −1..1 of each joint's speed limit."""
        if self._brakes is not None:
            self._brakes.release()
        self.amend_robot(action, np.ones(self.num_worlds, dtype=bool))

    def amend_robot(self, action: Array, which: NDArray[np.bool_]) -> None:
        """Set it anew in some worlds (N,), whose robots have been commanded before."""
        rows, names = np.nonzero(which)[0][:, None], self._names
        self._act[rows, names.arm_act] = self.arm_targets_rad()[which]
        self._ctrl[rows, names.arm_ctrl] = np.clip(action[which], -1.0, 1.0) * self._speed_limit

    def halt_robot(self) -> None:
        """Brake the arms: they stop at once and hold where they came to rest. Each servo aims at where its joint is."""
        names = self._names
        if self._brakes is not None:
            self._brakes.put_on()
        self._act[:, names.arm_act] = self._qpos[:, names.arm_qpos]
        self._ctrl[:, names.arm_ctrl] = 0.0

    def command_person(self, joint_targets_rad: Array) -> None:
        """Set the targets (N, 20) of a moving person's servos, to be had at once or, gliding, a control step later."""
        names = self._names
        if self._gliding:
            way = joint_targets_rad - self._act[:, names.person_act]
            self._ctrl[:, names.person_ctrl] = way / CONTROL_STEP_S
        else:
            self._ctrl[:, names.person_ctrl] = joint_targets_rad

    def step(self, substeps: int = SUBSTEPS) -> None:
        """Advance all worlds by physics steps; forces are of the last one, positions of its end."""
        self.batch.step(nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)
        self._sensordata = self._measured

    def park(self, gone: NDArray[np.bool_]) -> None:
        """Take particles (N, K) out of play."""
        particles = self.scene.tool.particles
        if particles is None:
            return
        world, particle = np.nonzero(gone)
        columns = self._names.particle_qpos[particle]
        spots = PARKING_W + np.stack([0.02 * particle, 0.0 * particle, 0.0 * particle], axis=-1)
        self._qpos[world[:, None], columns] = spots
        dof = self._names.particle_dof[particle]
        self._qvel[world[:, None], dof] = 0.0
        self._qfrc_applied[world, dof[:, 2]] = -self.model.opt.gravity[2] * particles.mass_kg

    def state(self) -> State:
        """The state of all worlds, in arrays of its own."""
        names = self._names
        sensors = self._sensordata
        by_tool = sensors[:, names.tool_contacts].copy().reshape(self.num_worlds, TOOL_CONTACTS, 9)
        by_robot = sensors[:, names.robot_contacts].reshape(self.num_worlds, ROBOT_CONTACTS, 3)
        tool_contact_force_n, total_force_n = norm(by_tool[..., :3]), _added_up(norm(by_robot))
        return State(
            robot_pos_w=self._xpos[:, names.robot_torso].copy(),
            arm_angles_rad=self.arm_angles_rad(),
            effector_velocity_w=sensors[:, names.effector_velocity].copy(),
            tool_velocity_w=sensors[:, names.tool_velocity].copy(),
            tool_pos_w=self._xpos[:, names.tool].copy(),
            tool_q_w=self._xquat[:, names.tool].copy(),
            pad_pos_w=self._xpos[:, names.pad].copy(),
            pad_q_w=self._xquat[:, names.pad].copy(),
            head_pos_w=self._site_xpos[:, names.head_centre].copy(),
            head_q_w=self._xquat[:, names.head].copy(),
            mouth_pos_w=self._site_xpos[:, names.mouth].copy(),
            **vars(self.right_arm()),
            placed_pos_w={name: self._xpos[:, body].copy() for name, body in names.placed.items()},
            particle_pos_w=self._qpos[:, names.particle_qpos],
            particle_velocity_w=self._qvel[:, names.particle_dof],
            person_segment_w=self._person_segments() if self.moving else self._segment_w.copy(),
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
        return RightArm(self._xpos[:, self._names.right_arm], self._xquat[:, self._names.right_arm])

    def robot_base(self) -> tuple[Array, Array]:
        """Where the robots' bases stand: positions (N, 3), quaternions (N, 4), world frame."""
        body = self._names.robot_base
        return self._body_pos[:, body].copy(), self._body_quat[:, body].copy()

    def placed_pos_w(self) -> dict[str, Array]:
        """Where the furniture stands that every episode places, (N, 3) by body, world frame."""
        return {name: self._body_pos[:, body].copy() for name, body in self._names.placed.items()}

    def arm_angles_rad(self) -> Array:
        """Where the arm's joints are, (N, J)."""
        return self._qpos[:, self._names.arm_qpos]

    def arm_targets_rad(self) -> Array:
        """Where the arm's servos aim, (N, J): no farther ahead of the joints than a command leaves them."""
        angles = self.arm_angles_rad()
        return np.clip(self._act[:, self._names.arm_act], angles - MAX_LEAD_RAD, angles + MAX_LEAD_RAD)

    def controls(self) -> Array:
        """What all servos are told, (N, nu)."""
        return self._ctrl.copy()

    def integration_state(self, world: int = 0) -> Array:
        """Everything that the next step depends on, as MuJoCo's ``mjSTATE_INTEGRATION`` vector."""
        return self.batch.state[world].copy()

    def restore(self, state: Array, world: int = 0) -> None:
        """Put one world into a state that ``integration_state`` gave."""
        self.batch.state[world] = state
        self.batch.forward(np.array([world]), stage=mujoco.mjtStage.mjSTAGE_VEL)

    def saved(self) -> dict[str, dict[str, NDArray[Any]]]:
        """All that the next steps of all worlds depend on, and what they show now."""
        return {
            "fields": {name: array.copy() for name, array in self._expanded().items()},
            "worlds": {
                "state": self.batch.state.copy(),
                "segment_w": self._segment_w.copy(),
                "sensordata": self._sensordata.copy(),
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
        self._sensordata = saved["worlds"]["sensordata"].copy()  # forces are of a step that is not made again

    def _expanded(self) -> dict[str, NDArray[Any]]:
        """The model's fields of which every world has its own, by name."""
        names = [name for name in dir(self.model) if isinstance(getattr(self.model, name, None), np.ndarray)]
        names += [f"opt.{name}" for name in dir(self.model.opt) if not name.startswith("_")]
        return {name: self.batch.expand(name) for name in names if _is_expanded(self.batch, name)}

    def qpos(self, world: int) -> Array:
        """The joint coordinates (nq,) of one world."""
        return self._qpos[world].copy()

    def body_poses(self, world: int) -> Array:
        """Poses (B, 7) of one world's ``bodies``: x, y, z, then w, x, y, z; world frame."""
        poses = np.empty((len(self.bodies), 7))
        poses[:, :3], poses[:, 3:] = self._xpos[world, 1:], self._xquat[world, 1:]
        return poses

    def person_angles_rad(self) -> Array:
        """The joint angles (N, 20) of the moving person."""
        return self._qpos[:, self._names.person_qpos]

    def _person_segments(self, ids: Ids | slice = slice(None)) -> Array:
        geoms = self._names.person_geoms
        axis = self._geom_xmat[ids][:, geoms, 2::3]
        centre = self._geom_xpos[ids][:, geoms]
        reach = axis * self._person.geom_size[ids][:, geoms, 1:2]
        return np.stack([centre - reach, centre + reach], axis=2)


def _is_expanded(batch: Batch, name: str) -> bool:
    try:
        return batch.expanded(name) is not None
    except (AttributeError, KeyError, TypeError, ValueError):  # none that a batch knows
        return False


class _Names:
    """Addresses of everything that is read or written, found once by name."""

    def __init__(self, model: mujoco.MjModel, scene: SceneConfig) -> None:
        arm = [robot.PREFIX + joint for joint in scene.arm.joints]
        self.arm_qpos = _qpos(model, arm)
        self.arm_ctrl = _actuators(model, arm)
        self.arm_act = np.array([model.actuator(name).actadr[0] for name in arm])
        self.robot_base = model.body(robot.PREFIX + scene.robot.base).id
        self.robot_torso = model.body(robot.PREFIX + scene.robot.torso).id
        self.tool = model.body(TOOL).id
        self.pad = model.body(robot.PREFIX + scene.tool.pad).id
        self.head = model.body(human.PREFIX + "head").id
        self.right_arm = np.array([model.body(human.PREFIX + name).id for name in human.RIGHT_ARM])
        self.placed = {name: model.body(name).id for name in scene.movable}
        self.head_centre = model.site(human.PREFIX + "head_centre").id
        self.mouth = model.site(human.PREFIX + "mouth").id
        self.person_geoms = np.array([model.geom(human.PREFIX + name).id for name in human.GEOMS])
        driven = [human.PREFIX + name for name in human.JOINTS if model.nu > len(arm)]
        self.person_qpos, self.person_ctrl = _qpos(model, driven), _actuators(model, driven)
        self.person_act = np.array([model.actuator(name).actadr[0] for name in driven], dtype=np.intp)
        particles = scene.tool.particles.bodies if scene.tool.particles else ()
        self.particle_qpos = np.array(
            [[model.joint(f"{body}_{axis}").qposadr[0] for axis in "xyz"] for body in particles],
            dtype=np.intp,
        ).reshape(-1, 3)
        self.particle_dof = np.array(
            [[model.joint(f"{body}_{axis}").dofadr[0] for axis in "xyz"] for body in particles], dtype=np.intp
        ).reshape(-1, 3)
        self.robot_force = _sensor(model, ROBOT_FORCE_SENSOR)
        self.tool_force = _sensor(model, TOOL_FORCE_SENSOR)
        self.robot_contacts = _sensor(model, ROBOT_CONTACT_SENSOR)
        self.tool_contacts = _sensor(model, TOOL_CONTACT_SENSOR)
        self.effector_velocity = _sensor(model, EFFECTOR_VELOCITY_SENSOR)
        self.tool_velocity = _sensor(model, TOOL_VELOCITY_SENSOR)


class _PersonFields:
    """Per-world model fields of the people."""

    def __init__(self, batch: Batch, scene: SceneConfig, moving: bool, *, gives_way: bool) -> None:
        model = batch.get_model(0)
        self._posture, self._moving, self._gives_way = scene.posture, moving, gives_way
        self._bodies = {name: model.body(human.PREFIX + name).id for name in human.BODIES}
        self._geoms = {name: model.geom(human.PREFIX + name).id for name in human.GEOMS}
        self._sites = {name: model.site(human.PREFIX + name).id for name in human.SITE_BODY}
        self._body_pos, self._body_quat = batch.expand("body_pos"), batch.expand("body_quat")
        self._geom_pos, self.geom_size = batch.expand("geom_pos"), batch.expand("geom_size")
        self._site_pos = batch.expand("site_pos")
        self._ids = np.array([*self._bodies.values()])
        self._inverse_mass = batch.expand("body_invweight0")
        self._mass_share = human.mass_shares()
        self._mass = batch.expand("body_mass")
        if moving:
            self._inertia = {name: batch.expand(name) for name in INERTIAL_FIELDS}
            self._actuators = _actuators(model, [human.PREFIX + name for name in human.JOINTS])
            self._force_range = batch.expand("actuator_forcerange")

    def write(self, ids: Ids, people: People) -> None:
        layout = human.layout(people.is_woman, people.torso_height_m, self._posture)
        for name, body in self._bodies.items():
            self._body_pos[ids, body] = layout.body_pos[name]
        for name, geom in self._geoms.items():
            self._geom_pos[ids, geom] = layout.geom_pos[name]
            self.geom_size[ids, geom] = layout.geom_size[name]
        for name, site in self._sites.items():
            self._site_pos[ids, site] = layout.site_pos[name]
        if self._moving:
            self._write_dynamics(ids, people)
        else:
            rotations = human.body_rotations(people.joint_angles_rad, self._posture)
            for name, body in self._bodies.items():
                self._body_quat[ids, body] = rotations[name]
            self._mass[np.ix_(ids, self._ids)] = (
                np.where(people.is_woman, human.WOMAN.mass, human.MAN.mass)[:, None] * self._mass_share
            )

    def give_way(self, ids: Ids) -> None:
        """Soften the contacts of people whose constants were just computed anew, unless they are as in version 1."""
        if self._gives_way:
            self._inverse_mass[ids[:, None], self._ids, 0] += yielding.INVERSE_MASS_PER_KG

    def _write_dynamics(self, ids: Ids, people: People) -> None:
        for row, world in enumerate(ids):
            inertia = _inertia(human.SEXES[int(people.is_woman[row])], float(people.torso_height_m[row]))
            for name, field in self._inertia.items():
                field[world, self._ids] = inertia[name]
        torque = people.strength_share[:, None] * human.TORQUE_N_M
        if self._gives_way:
            torque = yielding.muscle_torque_n_m(torque, people.tremor_rad)
        self._force_range[ids[:, None], self._actuators] = np.stack([-torque, torque], axis=-1)


INERTIAL_FIELDS = ("body_mass", "body_inertia", "body_ipos", "body_iquat")


@lru_cache(maxsize=1024)
def _inertia(sex: human.Sex, torso_height_m: float) -> dict[str, Array]:
    """The inertial model fields of a person's bodies, in the order of ``human.BODIES``."""
    model = human.person_model(Person(sex, torso_height_m), moving=True)
    bodies = [model.body(human.PREFIX + name).id for name in human.BODIES]
    return {name: getattr(model, name)[bodies] for name in INERTIAL_FIELDS}


def _qpos(model: mujoco.MjModel, joints: Sequence[str]) -> Ids:
    return np.array([model.joint(name).qposadr[0] for name in joints], dtype=np.intp)


def _actuators(model: mujoco.MjModel, names: Sequence[str]) -> Ids:
    return np.array([model.actuator(name).id for name in names], dtype=np.intp)


def _sensor(model: mujoco.MjModel, name: str) -> slice:
    sensor = model.sensor(name)
    return slice(int(sensor.adr[0]), int(sensor.adr[0] + sensor.dim[0]))


def _added_up(strongest_first: Array) -> Array:
    """The sums (N,) of forces (N, C), one after the other, so that empty slots at the end change no bit."""
    return strongest_first.cumsum(axis=-1)[:, -1]
