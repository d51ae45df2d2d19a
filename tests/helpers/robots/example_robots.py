"""Robot models: packaged robots, robots of the example package, and meshes of the Panda."""

import sys
from collections.abc import Iterator
from functools import cache

import mujoco

from avrgym.models.human import Person
from avrgym.models.robot import Robot, UnsuitableError, robot_spec
from avrgym.models.scene import build_spec
from avrgym.models.urdf import add_mesh, colour_of, read_mesh
from avrgym.robots.registry import ROBOTS
from avrgym.robots.rtb_data import rtb_data_path
from avrgym.tasks.registry import TASKS
from helpers.system.paths import ROOT

sys.path.append(str(ROOT / "examples" / "extension" / "src"))

from avrgym_example.gen3 import GEN3
from avrgym_example.ur5 import UR5

ALL_ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (*ROBOTS.values(), GEN3, UR5)}
PANDA_LINKS = ("link0", "link1", "link2", "link3", "link4", "link5", "link6", "link7", "hand", "finger")
PERSON = Person("woman", 0.55)


def panda() -> mujoco.MjModel:
    """Return the meshes of Franka's Panda (.dae) in a row. Their triangles share no vertices."""
    spec = mujoco.MjSpec()
    for number, link in enumerate(PANDA_LINKS):
        row, column = divmod(number, 4)
        body = spec.worldbody.add_body(name=link, pos=[0.3 * column, 0.0, 0.4 * row])
        parts = read_mesh(rtb_data_path("franka_description/meshes/visual") / f"{link}.dae")
        for index, part in enumerate(parts):
            add_mesh(spec, body, f"{link}_{index}", part, rgb=colour_of(part))
    return spec.compile()


@cache
def robot_model(name: str) -> mujoco.MjModel:
    """Return the model of a robot with its appearance."""
    if name == "Panda":
        return panda()
    robot = ALL_ROBOTS[name]
    return robot_spec(robot, next(iter(robot.arms.values())), appearance=True).compile()


def scene_of(name: str, task: str) -> mujoco.MjModel | None:
    """Return the scene of a task with a robot and a person, or ``None`` if the robot does not support the task."""
    try:
        scene = TASKS[task].scene(ALL_ROBOTS[name])
    except UnsuitableError:
        return None
    return build_spec(scene, PERSON, moving=True, appearance=True).compile()


def scenes_of(name: str) -> Iterator[mujoco.MjModel]:
    """Yield the scenes of all tasks that a robot supports."""
    return (scene for scene in (scene_of(name, task) for task in TASKS) if scene is not None)
