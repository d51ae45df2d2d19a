"""The tasks, in one table."""

from collections.abc import Mapping

from avrgym.robots.registry import ROBOTS, find_robot
from avrgym.simulation.world_version import WORLD_VERSIONS
from avrgym.tasks import of_world_1
from avrgym.tasks.base import Task
from avrgym.tasks.bed_bathing import BED_BATHING
from avrgym.tasks.drinking import DRINKING
from avrgym.tasks.feeding import FEEDING
from avrgym.tasks.scratch_itch import SCRATCH_ITCH

TASKS: Mapping[str, Task] = {task.name: task for task in (FEEDING, DRINKING, SCRATCH_ITCH, BED_BATHING)}

ENVIRONMENTS: Mapping[str, tuple[str, str]] = {
    f"avrgym/{task.name}{robot.name}-v1": (task.name, robot.name)
    for task in TASKS.values()
    for robot in ROBOTS.values()
    if task.suits(robot)
}
"""Environment id to the names of task and robot: every task with every robot that can do it."""


def find_environment(environment_id: str) -> tuple[str, str]:
    """The names of task and robot of an environment id.

    Raises:
        ValueError: naming the ids there are.
    """
    if environment_id not in ENVIRONMENTS:
        raise ValueError(
            f"unknown environment {environment_id!r}; the environments are {', '.join(ENVIRONMENTS)}"
        )
    return ENVIRONMENTS[environment_id]


def sizes(environment_id: str) -> tuple[int, int]:
    """How many numbers an observation and an action have.

    Raises:
        ValueError: for an unknown environment, naming the ids there are.
    """
    name, robot = find_environment(environment_id)
    task = TASKS[name]
    joints = len(task.scene(find_robot(robot)).arm.joints)
    return task.observation_size(joints), joints


def find_task(name: str, world_version: int) -> Task:
    """The task of that name as it was in a version of the world."""
    return _TASKS_OF_WORLD[world_version][name]


def terms_ever(name: str) -> set[str]:
    """The reward terms of that task in all versions of the world: what its recordings may hold."""
    return {term for version in WORLD_VERSIONS for term in find_task(name, version).weights}


_TASKS_OF_WORLD: Mapping[int, Mapping[str, Task]] = {1: of_world_1.TASKS, 2: TASKS}
