"""Feeding: scene, initial states and task."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like, namespace
from avrgym.models.furniture import BOWL_BODY, BOWL_INITIAL_POS_M, PositionOffset, add_table
from avrgym.models.human import People
from avrgym.models.robot import FurnitureBuilder, Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.spoon import SPOON, make_spoon
from avrgym.models.tools import Tool
from avrgym.simulation.worlds import InitialState
from avrgym.tasks import placement
from avrgym.tasks.experts.feedback import FeedbackExpert
from avrgym.tasks.feeding.expert import FeedingExpert, initial_food_positions
from avrgym.tasks.feeding.feedback_expert import feeding_target
from avrgym.tasks.feeding.memory_expert import FeedingMemoryExpert
from avrgym.tasks.feeding.reward import WEIGHTS, evaluate_step, init_state
from avrgym.tasks.observation import make_mouth_task_observation
from avrgym.tasks.person import TURNED_HEAD_POSE
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.task import WHEELCHAIR_SIDE_VIEW, Task, View, Views

MAX_BOWL_OFFSET_M = 0.05
MAX_START_HAND_OFFSET_M = 0.05
BOWL_TO_HAND_OFFSET_M = np.array([0.0, -0.1, 0.4])
SPOON_YAWS_RAD = np.array([0.0, -0.5 * np.pi])
"""Yaw angles of the spoon relative to the face: tip first, or left side first."""
SPOON_START_Q_W = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(0.5 * np.pi))
"""Initial rotation of the spoon: level, pointing towards the person."""


def scene(robot: Robot, tool: Tool = SPOON, add_furniture: FurnitureBuilder = add_table) -> SceneConfig:
    """Returns the scene: a wheelchair and a table with a bowl; the robot's right arm holds the spoon."""
    return placement.wheelchair_scene(robot, "right", tool, (0.1, 0.2), (add_furniture,), (BOWL_BODY,))


def start(
    scene: SceneConfig, people: People, uniforms: FloatArray, offset_m: PositionOffset = (0.0, 0.0, 0.0)
) -> InitialState:
    """Returns initial states with the bowl within ±5 cm of its mean position.

    The robot's hand is within ±5 cm of a point above the bowl. The spoon is level.
    """
    bowl = constant_like(np.add(BOWL_INITIAL_POS_M, offset_m), uniforms) + MAX_BOWL_OFFSET_M * (
        2.0 * uniforms[:, 0:3] - 1.0
    )
    hand = (
        bowl
        + constant_like(BOWL_TO_HAND_OFFSET_M, uniforms)
        + MAX_START_HAND_OFFSET_M * (2.0 * uniforms[:, 3:6] - 1.0)
    )
    tool, level = placement.tool_pose_in_hand(scene, hand, SPOON_START_Q_W)
    placed = {BOWL_BODY: bowl}
    return placement.find_start(scene, people, placed, tool, level, *_goals(people), uniforms[:, 6:])


def _goals(people: People) -> tuple[FloatArray, FloatArray]:
    """Returns spoon positions (n, 2, 3) and rotations (n, 2, 4) at the mouth.

    The spoon is level, with its tip first or its left side first.
    """
    mouth, head_q = placement.mouth_poses(people)
    into = transforms.rotate(head_q, [0.0, 1.0, 0.0])
    yaw = elementary.arctan2(into[:, 1], into[:, 0])[:, None] + constant_like(SPOON_YAWS_RAD, into)
    return namespace(mouth).stack([mouth, mouth], axis=1), transforms.from_axis_angle([0.0, 0.0, 1.0], yaw)


def make_feeding_task(settings: Settings = DEFAULT_SETTINGS) -> Task:
    """Returns the task with the spoon, food and table of the settings."""
    offset_m = settings.table_offset_m or (0.0, 0.0, 0.0)
    tool = make_spoon(settings.tool or "medium", settings.particles)
    return Task(
        name="Feeding",
        goal="Eat the food from the spoon.",
        pose=TURNED_HEAD_POSE,
        offered="mouth",
        scene=partial(scene, tool=tool, add_furniture=partial(add_table, offset_m=offset_m)),
        num_uniforms=6 + placement.NUM_UNIFORMS,
        start=partial(start, offset_m=offset_m),
        init_state=partial(init_state, particles=len(initial_food_positions(tool))),
        observation=make_mouth_task_observation,
        weights=WEIGHTS,
        evaluate_step=partial(evaluate_step, table_offset_m=offset_m),
        expert=FeedingExpert,
        feedback_expert=partial(FeedbackExpert, target=feeding_target),
        memory_expert=FeedingMemoryExpert,
        views=Views(
            mounted=View((-0.08, -0.30, 0.97), 1.55, 138.0, -28.0),
            on_floor=WHEELCHAIR_SIDE_VIEW,
        ),
        withdraws_after_success=True,
        variant=make_feeding_task,
    )


FEEDING = make_feeding_task()
