"""Laws of every task record, and rejections by the registry."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from avrgym.models.robot import Robot, UnsuitableRobotError
from avrgym.models.scene import SceneConfig
from avrgym.robots.registry import ROBOTS
from avrgym.tasks import constants
from avrgym.tasks.observation import ObservationSpec, make_position_entry
from avrgym.tasks.registry import ENVIRONMENTS, TASKS, TaskRegistry
from avrgym.tasks.task import StepResult, Task
from avrgym.tasks.task_check import check_task

FEEDING = TASKS["Feeding"]


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow)
        if name in ("Feeding", "Drinking", "ArmManipulation")
        else name
        for name in TASKS
    ],
)
def test_every_task_passes_its_check(name):
    check_task(name)


def test_every_packaged_task_is_done_by_every_robot_of_the_paper():
    assert set(product(constants.PACKAGED_TASKS, ("Jaco", "PR2"))) <= set(ENVIRONMENTS.values())


@pytest.mark.parametrize(("task", "robot"), ENVIRONMENTS.values())
def test_a_task_s_scene_with_a_robot_is_one_object(task, robot):
    """Whatever is remembered by scene would otherwise grow with every world that is made."""
    assert TASKS[task].make_scene(ROBOTS[robot]) is TASKS[task].make_scene(ROBOTS[robot])


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"name": "Feeding people"}, ValueError, "the task name is 'Feeding people'; allowed: an identifier"),
        ({"name": "Fütterung"}, ValueError, "allowed: an identifier of ASCII letters"),
        ({"name": None}, TypeError, "task None: the field `name` is None; allowed: a value of type str"),
        ({"goal_description": " "}, ValueError, "task Feeding: the field `goal_description` is empty"),
        (
            {"offered_body_part": "foot"},
            ValueError,
            "task Feeding: the field `offered_body_part` is 'foot'; allowed: 'mouth', 'arm', 'left_arm', 'nothing'",
        ),
        (
            {"expert": None},
            TypeError,
            "task Feeding: the field `expert` is None; allowed: a value of type function",
        ),
        (
            {"camera_views": None},
            TypeError,
            "task Feeding: the field `camera_views` is None; allowed: a value of type CameraViews",
        ),
        ({"reward_weights": {}}, ValueError, "task Feeding: the field `reward_weights` is empty"),
        ({"hyperparameters": {"detour_weight_per_m": 1.0}}, ValueError, "but no function compute_detour_m"),
    ],
)
def test_a_record_with_an_invalid_field_is_rejected(changes: Mapping[str, Any], error, said: str):
    with pytest.raises(error, match=said):
        replace(FEEDING, **changes)


@pytest.mark.parametrize(
    "part",
    ["make_scene", "make_observation_spec", "evaluate_step", "expert", "feedback_expert", "camera_views"],
)
def test_a_missing_field_is_named(part):
    parts = {name: value for name, value in vars(FEEDING).items() if name != part}
    with pytest.raises(TypeError, match=part):
        Task(**parts)


def test_observations_have_parts_of_different_names():
    part = make_position_entry("tool_m", lambda state, _: state.tool_pos_w)
    for entries in ((), (part, part)):
        with pytest.raises(ValueError, match="allowed: one or more entries with different names"):
            ObservationSpec(entries)


def test_terms_are_those_that_have_weights():
    with pytest.raises(
        ValueError,
        match=r"Feeding returned the reward terms distance_m; allowed: the names of its weights, distance_m,",
    ):
        FEEDING.compute_reward({"distance_m": np.zeros(1)})


def test_a_name_is_registered_once():
    registry = TaskRegistry(ROBOTS)
    registry.register_task(FEEDING)
    before = dict(registry.environments)
    with pytest.raises(ValueError, match="a task with the name Feeding is already registered"):
        registry.register_task(FEEDING)
    assert (list(registry.tasks), registry.environments) == (["Feeding"], before)


def test_ids_that_coincide_are_refused():
    jaco = ROBOTS["Jaco"]
    registry = TaskRegistry({"Jaco": jaco, "BigJaco": replace(jaco, name="BigJaco")})
    registry.register_task(FEEDING)
    with pytest.raises(ValueError, match="the environment id avrgym/FeedingBigJaco-v1 is already in use"):
        registry.register_task(replace(FEEDING, name="FeedingBig"))
    assert list(registry.tasks) == ["Feeding"]


def test_a_task_is_done_by_the_robots_that_suit_it():
    def by_jaco(robot: Robot) -> SceneConfig:
        if robot.name != "Jaco":
            raise UnsuitableRobotError(f"{robot.name} is too large")
        return FEEDING.make_scene(robot)

    def by_none(robot: Robot) -> SceneConfig:
        raise UnsuitableRobotError(f"{robot.name} has no hook")

    registry = TaskRegistry(ROBOTS)
    registry.register_task(replace(FEEDING, name="Small", make_scene=by_jaco))
    assert registry.environments == {"avrgym/SmallJaco-v1": ("Small", "Jaco")}
    with pytest.raises(ValueError, match="task Hooked: no robot has the required arm, mount and grip"):
        registry.register_task(replace(FEEDING, name="Hooked", make_scene=by_none))
    assert registry.skipped_plugins == []


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ({"distance_m": np.full(3, np.nan)}, "distance_m is"),
        ({"num_events": np.zeros(3)}, "num_events is"),
        ({"success": np.zeros(2, dtype=bool)}, "success is"),
    ],
)
def test_an_invalid_step_result_is_named(monkeypatch, broken, said):
    def evaluate_step(*given: Any) -> StepResult:
        return replace(FEEDING.evaluate_step(*given), **broken)

    monkeypatch.setitem(TASKS, "Feeding", replace(FEEDING, evaluate_step=evaluate_step))
    with pytest.raises(ValueError, match=f"^expert in avrgym/FeedingJaco-v1: {said}"):
        check_task("Feeding")
