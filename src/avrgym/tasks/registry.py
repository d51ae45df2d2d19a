"""Registry of tasks and environments. An environment is a task with a robot that can hold the task's tool.

Plug-ins register tasks in the entry-point group ``avrgym.tasks``.
"""

from collections.abc import Collection, Iterable, Mapping
from functools import lru_cache

import msgspec

from avrgym.models.body_names import Side
from avrgym.models.robot import Robot, UnsuitableRobotError
from avrgym.models.scene import SceneConfig
from avrgym.robots.registry import ROBOTS, find_robot
from avrgym.system import plugins
from avrgym.system.optional_robots import format_install_hint
from avrgym.system.used_plugins import UsedPlugin, make_plugin_from_entry_point
from avrgym.tasks.arm_manipulation.task import ARM_MANIPULATION
from avrgym.tasks.bed_bathing.task import BED_BATHING
from avrgym.tasks.constants import make_environment_id
from avrgym.tasks.dressing.task import DRESSING
from avrgym.tasks.drinking.task import DRINKING
from avrgym.tasks.feeding.task import FEEDING
from avrgym.tasks.scene_settings import apply_scene_settings, has_furniture
from avrgym.tasks.scratch_itch.task import SCRATCH_ITCH
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.task import Task
from avrgym.tasks.task_transform import exchange_arm_in_goal, transform_task


class TaskRegistry:
    """Tasks by name, environments by id, and error messages of skipped plug-ins."""

    def __init__(self, robots: Mapping[str, Robot]) -> None:
        self.robots = robots
        self.tasks: dict[str, Task] = {}
        self.environments: dict[str, tuple[str, str]] = {}
        self.skipped_plugins: list[plugins.SkippedPlugin] = []

    def register_task(self, task: Task) -> None:
        """Register a task with all suitable robots. A robot is skipped if the task's scene or observation fails.

        Raises:
            ValueError: if the name or an environment id is in use, or if no robot is suitable. Nothing is added.
        """
        if task.name in self.tasks:
            raise ValueError(f"a task with the name {task.name} is already registered; choose another name")
        suited = [robot.name for robot in self.robots.values() if self._is_suited(robot, task)]
        if not suited:
            raise ValueError(
                f"task {task.name}: no robot has the required arm, mount and grip; add them to one of these robots: "
                f"{', '.join(self.robots)}"
            )
        made = {make_environment_id(task.name, robot): (task.name, robot) for robot in suited}
        taken = ", ".join(made.keys() & self.environments)
        if taken:
            raise ValueError(f"the environment id {taken} is already in use; choose another task name")
        self.tasks[task.name] = task
        self.environments |= made

    def _is_suited(self, robot: Robot, task: Task) -> bool:
        try:
            task.make_observation_spec(task.make_scene(robot))
        except UnsuitableRobotError:
            return False
        except (Exception, SystemExit) as error:  # plug-ins may raise any exception
            self.skipped_plugins.append(
                plugins.log_skipped_plugin(make_environment_id(task.name, robot.name), error)
            )
            return False
        return True


def _build_registry() -> TaskRegistry:
    registry = TaskRegistry(ROBOTS)
    for task in (FEEDING, DRINKING, SCRATCH_ITCH, BED_BATHING, DRESSING, ARM_MANIPULATION):
        registry.register_task(task)
    registry.skipped_plugins += plugins.load_plugins(
        plugins.TASK_ENTRY_POINT_GROUP, Task, registry.register_task
    )
    return registry


_REGISTRY = _build_registry()
TASKS: Mapping[str, Task] = _REGISTRY.tasks
ENVIRONMENTS: Mapping[str, tuple[str, str]] = _REGISTRY.environments
"""Names of the task and the robot of each environment, by environment id."""
SKIPPED_PLUGINS: tuple[plugins.SkippedPlugin, ...] = tuple(_REGISTRY.skipped_plugins)
"""Error messages of skipped plug-ins: of tasks, and of single environments."""


def find_environment(environment_id: str) -> tuple[str, str]:
    """Returns the names of task and robot of an environment.

    Raises:
        ValueError: for an unknown id. The message lists the ids.
    """
    if environment_id not in ENVIRONMENTS:
        raise ValueError(
            f"unknown environment {environment_id!r}; allowed: "
            f"{', '.join(ENVIRONMENTS)}{format_install_hint(environment_id)}"
        )
    return ENVIRONMENTS[environment_id]


def find_plugins(environment_id: str) -> tuple[UsedPlugin, ...]:
    """Returns the plug-ins that register the task or robot of an environment.

    Raises:
        ValueError: for an unknown id. The message lists the ids.
    """
    task, robot = find_environment(environment_id)
    of_task, of_robot = (
        plugins.find_entry_point(plugins.TASK_ENTRY_POINT_GROUP, task),
        plugins.find_entry_point(plugins.ROBOT_ENTRY_POINT_GROUP, robot),
    )
    found = () if of_task is None else (make_plugin_from_entry_point("task", task, of_task),)
    return found if of_robot is None else (*found, make_plugin_from_entry_point("robot", robot, of_robot))


def find_task_and_scene(
    environment_id: str, settings: Settings = DEFAULT_SETTINGS
) -> tuple[Task, SceneConfig]:
    """Returns the task and the scene of an environment, with settings applied.

    Raises:
        ValueError: for an unknown id (the message lists the ids), and for settings that this environment does not have.
    """
    name, robot = find_environment(environment_id)
    if settings == DEFAULT_SETTINGS:
        return TASKS[name], TASKS[name].make_scene(find_robot(robot))
    return _with_settings(name, robot, settings)


@lru_cache(maxsize=64)
def _with_settings(name: str, robot: str, settings: Settings) -> tuple[Task, SceneConfig]:
    """Returns the task with the name ``name`` and its scene with a robot, with settings applied.

    The same settings return the same objects, because models are cached by scene.
    """
    task = TASKS[name].apply_settings(settings)
    if settings.served_arm is not None and task.served_arm is None:
        raise ValueError(f"task {name} has no setting served_arm; remove this setting")
    mirrored = settings.served_arm not in (None, task.served_arm)
    scene = apply_scene_settings(task.make_scene(find_robot(robot)), settings, mirrored=mirrored)
    if scene.transformed_scene is None:
        return task, scene
    frame = scene.transformed_scene.task_frame
    if frame.height_offset_m and has_furniture(scene, "table_offset_m"):
        x, y, z = settings.table_offset_m or (0.0, 0.0, 0.0)
        lowered = msgspec.structs.replace(settings, table_offset_m=(x, y, z - frame.height_offset_m))
        task = TASKS[name].apply_settings(lowered)
    return transform_task(task, frame, scene.tool.mirror_axis), scene


def get_goal_description(name: str, settings: Settings) -> str:
    """Returns the goal text of a task, for the person's arm in ``Settings.served_arm``."""
    task = TASKS[name]
    return (
        task.goal_description
        if settings.served_arm in (None, task.served_arm)
        else exchange_arm_in_goal(task.goal_description)
    )


def describe_missing_arm(tasks: Iterable[tuple[str, Settings]], absent_arms: Collection[Side]) -> str:
    """Returns an error message about a task that needs one of the ``absent_arms``; empty if there is no such task.

    ``tasks``: names of tasks with the settings of their scenes.
    """
    for name, settings in tasks:
        arm = TASKS[name].served_arm and (settings.served_arm or TASKS[name].served_arm)
        if arm in absent_arms:
            return (
                f"{name} works on the {arm} arm, which is absent; allowed: tasks that need no absent arm, or "
                "served_arm in [settings] with a policy trained for it"
            )
    return ""


def make_policy_instruction(environment_id: str, settings: Settings = DEFAULT_SETTINGS) -> str:
    """Returns the task of an environment as an instruction for policies that take language.

    Raises:
        ValueError: for an unknown id. The message lists the ids.
    """
    goal = get_goal_description(find_environment(environment_id)[0], settings)
    return f"Help the person: {goal[0].lower()}{goal[1:]}".replace(" your ", " their ")


def get_observation_and_action_size(environment_id: str) -> tuple[int, int]:
    """Returns the lengths O and A of observations and actions in an environment.

    Raises:
        ValueError: for an unknown id. The message lists the ids.
    """
    task, scene = find_task_and_scene(environment_id)
    return task.make_observation_spec(scene).size, len(scene.action_names)
