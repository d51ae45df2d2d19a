"""Registry of tasks and environments: every task with every robot that can hold the task's tool.

Plug-ins register tasks in the entry-point group ``avrgym.tasks``.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

from avrgym.models.robot import Robot, UnsuitableRobotError, robot_as_furniture
from avrgym.models.scene import SceneConfig
from avrgym.robots.registry import ROBOTS, find_robot
from avrgym.system import plugins
from avrgym.system.optional_robots import how_to_add
from avrgym.system.used_plugins import UsedPlugin, plugin_of_entry_point
from avrgym.tasks.arm_manipulation.task import ARM_MANIPULATION
from avrgym.tasks.bed_bathing.task import BED_BATHING
from avrgym.tasks.constants import environment_id
from avrgym.tasks.dressing.task import DRESSING
from avrgym.tasks.drinking.task import DRINKING
from avrgym.tasks.feeding.task import FEEDING
from avrgym.tasks.scratch_itch.task import SCRATCH_ITCH
from avrgym.tasks.settings import DEFAULTS, Settings
from avrgym.tasks.task import Task


class Registry:
    """Tasks by name, environments by id, and error messages of skipped plug-ins."""

    def __init__(self, robots: Mapping[str, Robot]) -> None:
        self.robots = robots
        self.tasks: dict[str, Task] = {}
        self.environments: dict[str, tuple[str, str]] = {}
        self.broken: list[plugins.SkippedPlugin] = []

    def add(self, task: Task) -> None:
        """Register a task with all suitable robots. Robots for which the task's scene or observation fails are skipped.

        Raises:
            ValueError: if the name or an environment id is in use, or if no robot is suitable. Nothing is added.
        """
        if task.name in self.tasks:
            raise ValueError(f"a task named {task.name} is already registered; allowed: another name")
        suited = [robot.name for robot in self.robots.values() if self._is_suited(robot, task)]
        if not suited:
            raise ValueError(
                f"no robot has the arm, mount and grip for task {task.name}; the robots are {', '.join(self.robots)}"
            )
        made = {environment_id(task.name, robot): (task.name, robot) for robot in suited}
        taken = ", ".join(made.keys() & self.environments)
        if taken:
            raise ValueError(f"the environment id {taken} is already in use; allowed: another task name")
        self.tasks[task.name] = task
        self.environments |= made

    def _is_suited(self, robot: Robot, task: Task) -> bool:
        try:
            task.observation(task.scene(robot))
        except UnsuitableRobotError:
            return False
        except (Exception, SystemExit) as error:  # other people's code may raise anything
            self.broken.append(plugins.log_skipped(environment_id(task.name, robot.name), error))
            return False
        return True


def _build_registry() -> Registry:
    registry = Registry(ROBOTS)
    for task in (FEEDING, DRINKING, SCRATCH_ITCH, BED_BATHING, DRESSING, ARM_MANIPULATION):
        registry.add(task)
    registry.broken += plugins.load_plugins(plugins.TASKS, Task, registry.add)
    return registry


_REGISTRY = _build_registry()
TASKS: Mapping[str, Task] = _REGISTRY.tasks
ENVIRONMENTS: Mapping[str, tuple[str, str]] = _REGISTRY.environments
"""Task and robot names by environment id."""
SKIPPED_PLUGINS: tuple[plugins.SkippedPlugin, ...] = tuple(_REGISTRY.broken)
"""Error messages of skipped plug-ins: of tasks, and of environments of a task with a robot."""


def find_environment(environment_id: str) -> tuple[str, str]:
    """Task and robot names of an environment id.

    Raises:
        ValueError: for an unknown id. The message lists the ids.
    """
    if environment_id not in ENVIRONMENTS:
        raise ValueError(
            f"unknown environment {environment_id!r}; allowed: {', '.join(ENVIRONMENTS)}{how_to_add(environment_id)}"
        )
    return ENVIRONMENTS[environment_id]


def plugins_of(environment_id: str) -> tuple[UsedPlugin, ...]:
    """Plug-ins that register the task or robot of an environment.

    Raises:
        ValueError: for an unknown id. The message lists the ids.
    """
    task, robot = find_environment(environment_id)
    of_task, of_robot = (
        plugins.entry_point_of(plugins.TASKS, task),
        plugins.entry_point_of(plugins.ROBOTS, robot),
    )
    found = () if of_task is None else (plugin_of_entry_point("task", task, of_task),)
    return found if of_robot is None else (*found, plugin_of_entry_point("robot", robot, of_robot))


def task_and_scene(environment_id: str, settings: Settings = DEFAULTS) -> tuple[Task, SceneConfig]:
    """Task and scene of an environment with settings.

    Raises:
        ValueError: for an unknown id, listing the ids, and for settings that are not possible in this environment.
    """
    name, robot = find_environment(environment_id)
    task = TASKS[name].with_settings(settings)
    return task, _scene_with(task.scene(find_robot(robot)), settings)


@lru_cache(maxsize=64)
def _scene_with(scene: SceneConfig, settings: Settings) -> SceneConfig:
    """Returns the scene with the settings. The same settings return the same object, because models are cached by this
    object."""
    if settings == DEFAULTS:
        return scene
    mount, furniture = scene.mount, [*scene.furniture]
    if settings.robot_pose is not None:
        x, y, yaw_deg = settings.robot_pose
        mount = replace(mount, pos_w=(x, y, mount.pos_w[2]), yaw_rad=math.radians(yaw_deg), base_range=None)
    for number, (name, x, y, yaw_deg) in enumerate(settings.standing_by):
        furniture.append(
            robot_as_furniture(find_robot(name), f"standing_by_{number}", (x, y), math.radians(yaw_deg))
        )
    return replace(
        scene,
        furniture=furniture,
        mount=mount,
        control_step_s=settings.control_step_s,
        checks_reach=not (settings.robot_pose is None and settings.table_offset_m is None),
        body_mass_kg=settings.body_mass_kg,
        self_collision=settings.self_collision,
    )


def sizes(environment_id: str) -> tuple[int, int]:
    """Returns the sizes of observation and action in an environment.

    Raises:
        ValueError: for an unknown id. The message lists the ids.
    """
    task, scene = task_and_scene(environment_id)
    return task.observation(scene).size, len(scene.action_names)
