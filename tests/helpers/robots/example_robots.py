"""Models of the packaged robots and of the example package's robot."""

import sys
from collections.abc import Iterator
from functools import cache

import mujoco

from avrgym.models.human import Person
from avrgym.models.robot import Robot, UnsuitableRobotError, build_robot_spec
from avrgym.models.scene import build_scene_spec
from avrgym.robots.registry import ROBOTS
from avrgym.tasks.registry import TASKS
from helpers.system.paths import ROOT

sys.path.append(str(ROOT / "examples" / "extension" / "src"))

from avrgym_example.fetch import FETCH

ALL_ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (*ROBOTS.values(), FETCH)}
PERSON = Person("woman", 0.55)


@cache
def robot_model(name: str) -> mujoco.MjModel:
    """Return the model of a robot with its appearance."""
    robot = ALL_ROBOTS[name]
    return build_robot_spec(robot, next(iter(robot.arms.values())), appearance=True).compile()


def scene_of(name: str, task: str) -> mujoco.MjModel | None:
    """Return the scene of a task with a robot and a person, or ``None`` if the robot does not support the task."""
    try:
        scene = TASKS[task].make_scene(ALL_ROBOTS[name])
    except UnsuitableRobotError:
        return None
    return build_scene_spec(scene, PERSON, moving=True, appearance=True).compile()


def scenes_of(name: str) -> Iterator[mujoco.MjModel]:
    """Yield the scenes of all tasks that a robot supports."""
    return (scene for scene in (scene_of(name, task) for task in TASKS) if scene is not None)
