"""The MuJoCo model of a scene: person, furniture, robot, tool, and particles or cloth."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits, human, robot
from avrgym.models.cloth import add_cloth
from avrgym.models.geoms import add_collision_geom
from avrgym.models.human import Person, Posture
from avrgym.models.robot import Arm, FurnitureBuilder, Mount, Robot
from avrgym.models.self_collision import add_self_collision
from avrgym.models.task_frame import WORLD_FRAME, TaskFrame
from avrgym.models.tools import TOOL_BODY as TOOL_BODY
from avrgym.models.tools import Tool, add_particles

PHYSICS_STEP_S = 0.01
"""Duration of a physics step in seconds."""
CONTROL_STEP_S = 0.1
"""Default duration of a control step in seconds. Simulated people choose their actions with the same period."""
DEFAULT_SUBSTEPS = round(CONTROL_STEP_S / PHYSICS_STEP_S)
"""Number of physics steps in a default control step."""
FLUID_SOLVER_TOLERANCE = 1e-3
"""Solver tolerance for 64 water particles, with conjugate gradients and without islands and geom trees. For water,
conjugate gradients are faster than Newton's method. For food and without particles, Newton's method is faster.
"""


@dataclass(frozen=True, eq=False)
class SceneConfig:
    """Configuration of a scene: furniture, the person's posture, and a robot on its mount with a tool.

    Attributes:
        furniture: functions that add furniture, including the carrier of the mount.
        movable_bodies: furniture bodies with a different position in each episode.
        posture: posture of the person.
        robot, arm, tool, mount: the robot, its moving arm, the tool in the arm's hand, and the pose of the robot's
            base.
        control_step_s: duration of a control step.
        checks_reach: whether initial states are resampled if they are out of the arm's reach.
        body_mass_kg: mass of every person; ``None``: the mass of the person's body model.
        self_collision: whether the links of the robot collide with each other.
        task_frame: frame of mount and posture. Furniture is always in the world frame.
        transformed_scene: the same scene in the task's frame, if this frame differs from the world frame.
    """

    furniture: Sequence[FurnitureBuilder]
    movable_bodies: Sequence[str]
    posture: Posture
    robot: Robot
    arm: Arm
    tool: Tool
    mount: Mount
    control_step_s: float = CONTROL_STEP_S
    checks_reach: bool = False
    body_mass_kg: float | None = None
    self_collision: bool = False
    task_frame: TaskFrame = WORLD_FRAME
    transformed_scene: "SceneConfig | None" = None

    @property
    def scene_in_task_frame(self) -> "SceneConfig":
        """Returns the scene in the task's frame. The functions of the task need the scene in this frame."""
        return self.transformed_scene or self

    @property
    def substeps(self) -> int:
        """Returns the number of physics steps in a control step."""
        return round(self.control_step_s / PHYSICS_STEP_S)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Returns the names of the A components of an action; see ``Robot.action_names``."""
        return self.robot.list_action_names(self.arm)

    @property
    def speed_limit(self) -> FloatArray:
        """Returns the speeds (A,) for actions of 1: rad/s for hinges and turning, m/s for slides and driving."""
        drive = () if self.robot.drive is None else self.robot.drive.speed_limit
        return np.concatenate([self.arm.speed_limit, drive])


def build_scene_spec(scene: SceneConfig, person: Person, *, moving: bool, appearance: bool) -> mujoco.MjSpec:
    """Returns the model of a scene.

    Args:
        scene: furniture, robot and tool.
        person: the person; a static person has the joint angles of this record.
        moving: whether the person has actuated joints; otherwise the person is rigid.
        appearance: whether to add visual geoms.
    """
    spec = mujoco.MjSpec()
    _set_options(spec, scene.tool)
    add_collision_geom(
        spec.worldbody, "floor", mujoco.mjtGeom.mjGEOM_PLANE, collision_bits.FURNITURE, size=[5.0, 5.0, 0.1]
    )
    human.add_person(spec, person, scene.posture, moving=moving)
    if appearance:
        from avrgym.models.human_shape import add_person_skins  # imports the image library

        add_person_skins(spec, person, scene.posture, open_mouth=scene.tool.particles is not None)
    for add in scene.furniture:
        add(spec, appearance)
    _add_robot(spec, scene, appearance)
    if scene.tool.particles is not None:
        add_particles(spec, scene.tool.particles, appearance)
    if scene.tool.cloth is not None:
        add_cloth(spec, scene.tool.cloth, robot.ROBOT_NAME_PREFIX, appearance)
    _add_sensors(spec, scene)
    return spec


def _set_options(spec: mujoco.MjSpec, tool: Tool) -> None:
    spec.option.timestep = PHYSICS_STEP_S
    spec.option.integrator = (
        mujoco.mjtIntegrator.mjINT_IMPLICITFAST if tool.cloth is None else mujoco.mjtIntegrator.mjINT_DISCRETE
    )
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.compiler.degree = False
    # Islands and geom trees are slower here: nearly all contacts are in one island, and few bodies have many geoms.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND | mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    if tool.particles is not None and tool.particles.is_fluid:
        spec.option.solver = mujoco.mjtSolver.mjSOL_CG
        spec.option.tolerance = FLUID_SOLVER_TOLERANCE


def _add_robot(spec: mujoco.MjSpec, scene: SceneConfig, appearance: bool) -> None:
    turn = transforms.from_axis_angle([0.0, 0.0, 1.0], scene.mount.yaw_rad)
    frame = spec.worldbody.add_frame(pos=scene.mount.pos_w, quat=turn)
    spec.attach(
        build_robot_with_tool_spec(scene, appearance=appearance), prefix=robot.ROBOT_NAME_PREFIX, frame=frame
    )
    if scene.self_collision:
        add_self_collision(spec, scene.robot, scene.arm, robot.ROBOT_NAME_PREFIX)


def build_robot_with_tool_spec(scene: SceneConfig, *, appearance: bool) -> mujoco.MjSpec:
    """Returns the model of the scene's robot with the tool in its hand, without person and furniture."""
    return robot.build_robot_spec_with_tool(
        scene.robot, scene.arm, scene.tool, TOOL_BODY, appearance=appearance
    )


SCENE_TOOL_BODY = robot.ROBOT_NAME_PREFIX + TOOL_BODY
"""Name of the tool's body in a scene, with the robot's prefix."""

ROBOT_FORCE_SENSOR = "robot_force_on_person"
TOOL_FORCE_SENSOR = "tool_force_on_person"
ROBOT_CONTACT_SENSOR = "robot_contacts_with_person"
MAX_ROBOT_CONTACTS = 16
"""Number of contacts between robot and person that the sensor reports, the strongest first."""
TOOL_CONTACT_SENSOR = "tool_contacts_with_person"
PERSON_FORCE_SENSOR = "force_on_person"
PERSON_CONTACT_SENSOR = "contacts_with_person"
MAX_PERSON_CONTACTS = 96
"""Number of contacts between the person and all other bodies that the sensor reports, in scenes with cloth."""
MAX_TOOL_CONTACTS = 6
"""Number of contacts between tool and person that the sensor reports. Tools have at most 4 contacts with packaged
policies.
"""
END_EFFECTOR_VELOCITY_SENSOR = "end_effector_velocity"
TOOL_VELOCITY_SENSOR = "tool_velocity"


def _add_sensors(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Add sensors of contact forces on the person, contacts, and velocities of end effector and tool.

    Net forces and velocities are in the world frame. The sensors measure the strongest contacts. A contact of the tool
    has a force, a position, and a normal from the tool to the person. The force is in the contact frame; only its
    magnitude is used. A MuJoCo sensor cannot measure a flex alone. With cloth, further sensors therefore measure all
    contacts of the person.
    """
    base = robot.ROBOT_NAME_PREFIX + scene.robot.base
    _add_contact_sensor(spec, ROBOT_FORCE_SENSOR, base, _FORCE, _NET_FORCE, slots=1)
    _add_contact_sensor(spec, TOOL_FORCE_SENSOR, SCENE_TOOL_BODY, _FORCE, _NET_FORCE, slots=1)
    _add_contact_sensor(spec, ROBOT_CONTACT_SENSOR, base, _FORCE, _STRONGEST, slots=MAX_ROBOT_CONTACTS)
    whole = _FORCE | _POS | _NORMAL
    _add_contact_sensor(
        spec, TOOL_CONTACT_SENSOR, SCENE_TOOL_BODY, whole, _STRONGEST, slots=MAX_TOOL_CONTACTS
    )
    _add_velocity_sensor(spec, END_EFFECTOR_VELOCITY_SENSOR, robot.ROBOT_NAME_PREFIX + scene.arm.end_effector)
    _add_velocity_sensor(spec, TOOL_VELOCITY_SENSOR, SCENE_TOOL_BODY)
    if scene.tool.cloth is not None:
        _add_contact_sensor(spec, PERSON_FORCE_SENSOR, None, _FORCE, _NET_FORCE, slots=1)
        _add_contact_sensor(spec, PERSON_CONTACT_SENSOR, None, _FORCE, _STRONGEST, slots=MAX_PERSON_CONTACTS)


_FORCE = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
_POS = 1 << int(mujoco.mjtConDataField.mjCONDATA_POS)
_NORMAL = 1 << int(mujoco.mjtConDataField.mjCONDATA_NORMAL)
_STRONGEST, _NET_FORCE = 2, 3


def _add_velocity_sensor(spec: mujoco.MjSpec, name: str, body: str) -> None:
    spec.add_sensor(
        name=name,
        type=mujoco.mjtSensor.mjSENS_FRAMELINVEL,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=body,
    )


def add_geom_force_sensor(spec: mujoco.MjSpec, scene: SceneConfig, name: str, geom: str, slots: int) -> None:
    """Add a sensor of the strongest contact forces from robot and cloth on one of the geoms ``human.GEOMS``."""
    base = robot.ROBOT_NAME_PREFIX + scene.robot.base if scene.tool.cloth is None else None
    _add_contact_sensor(spec, name, base, _FORCE, _STRONGEST, slots, human.PERSON_NAME_PREFIX + geom)


def _add_contact_sensor(
    spec: mujoco.MjSpec, name: str, of: str | None, fields: int, reduction: int, slots: int, geom: str = ""
) -> None:
    """Add a sensor of contacts with the person, or with the ``geom`` only. ``of`` is the other body; ``None``: any
    body."""
    spec.add_sensor(
        name=name,
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_UNKNOWN if of is None else mujoco.mjtObj.mjOBJ_XBODY,
        objname=of or "",
        reftype=mujoco.mjtObj.mjOBJ_GEOM if geom else mujoco.mjtObj.mjOBJ_XBODY,
        refname=geom or human.PERSON_NAME_PREFIX + "hips",
        intprm=[fields, reduction, slots],
    )
