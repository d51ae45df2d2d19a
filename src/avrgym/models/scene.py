"""One MuJoCo model for a scene: person, furniture, robot, tool and what the tool carries."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.models import contacts, human, robots
from avrgym.models.furniture import FURNITURE
from avrgym.models.human import Person
from avrgym.models.parts import add_collision
from avrgym.models.robots import Robot
from avrgym.models.tools import BODY as TOOL_BODY
from avrgym.models.tools import Tool, add_particles

PHYSICS_STEP_S = 0.01
CONTROL_STEP_S = 0.1
SUBSTEPS = round(CONTROL_STEP_S / PHYSICS_STEP_S)


@dataclass(frozen=True, eq=False)
class Stage:
    """What stands in a scene besides the person: names of ``FURNITURE``, a robot, its place and its tool."""

    furniture: Sequence[str]
    robot: Robot
    robot_pos_w: tuple[float, float, float]
    robot_yaw_rad: float
    tool: Tool

    @property
    def robot_q_w(self) -> NDArray[np.float64]:
        """The rotation (4,) of the robot's base."""
        return transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(self.robot_yaw_rad))


def build_spec(stage: Stage, person: Person, *, moving: bool, appearance: bool) -> mujoco.MjSpec:
    """Assemble the scene.

    Args:
        stage: the furniture, the robot and the tool.
        person: whose body it is; a static person keeps this pose.
        moving: whether the person has driven joints.
        appearance: whether to add what only pictures need.
    """
    spec = mujoco.MjSpec()
    _set_options(spec)
    add_collision(
        spec.worldbody, "floor", mujoco.mjtGeom.mjGEOM_PLANE, contacts.FURNITURE, size=[5.0, 5.0, 0.1]
    )
    human.add_person(spec, person, moving=moving, appearance=appearance)
    for name in stage.furniture:
        FURNITURE[name](spec, appearance)
    _add_robot(spec, stage, appearance)
    if stage.tool.particles is not None:
        add_particles(spec, stage.tool.particles, appearance)
    _add_sensors(spec, stage.robot)
    return spec


def _set_options(spec: mujoco.MjSpec) -> None:
    spec.option.timestep = PHYSICS_STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.compiler.degree = False


def _add_robot(spec: mujoco.MjSpec, stage: Stage, appearance: bool) -> None:
    frame = spec.worldbody.add_frame(pos=stage.robot_pos_w, quat=stage.robot_q_w)
    spec.attach(robot_with_tool(stage, appearance=appearance), prefix=robots.PREFIX, frame=frame)


def robot_with_tool(stage: Stage, *, appearance: bool) -> mujoco.MjSpec:
    """The stage's robot alone, with its tool in its hand."""
    robot = robots.robot_spec(stage.robot, appearance=appearance)
    hand_q = stage.robot.hand_q
    tool = robot.body(stage.robot.end_effector).add_body(
        name=TOOL_BODY,
        pos=transforms.rotate(hand_q, [stage.tool.reach_m, 0.0, 0.0]),
        quat=hand_q,
        gravcomp=1.0,
    )
    stage.tool.build(robot, tool, appearance)
    return robot


TOOL = robots.PREFIX + TOOL_BODY
ROBOT_FORCE_SENSOR = "robot_force_on_person"
TOOL_FORCE_SENSOR = "tool_force_on_person"
EFFECTOR_VELOCITY_SENSOR = "end_effector_velocity"


def _add_sensors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """The net force on the person by robot and tool and by the tool alone, and the end effector's velocity.

    All in the world's frame.
    """
    for name, first in ((ROBOT_FORCE_SENSOR, robots.PREFIX + robot.base), (TOOL_FORCE_SENSOR, TOOL)):
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=first,
            reftype=mujoco.mjtObj.mjOBJ_XBODY,
            refname=human.PREFIX + "hips",
            intprm=[_FORCE_ONLY, _NET_FORCE, 1],
        )
    spec.add_sensor(
        name=EFFECTOR_VELOCITY_SENSOR,
        type=mujoco.mjtSensor.mjSENS_FRAMELINVEL,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=robots.PREFIX + robot.end_effector,
    )


_FORCE_ONLY = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
_NET_FORCE = 3
