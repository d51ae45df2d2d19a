"""Feeding: scene, initial states and task."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.models.furniture import BOWL_BODY, BOWL_INITIAL_POS_M, PositionOffset, add_table
from avrgym.models.human import People
from avrgym.models.robot import FurnitureBuilder, Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.spoon import SPOON, make_spoon
from avrgym.models.tools import Tool
from avrgym.simulation.worlds import InitialState
from avrgym.tasks import placement
from avrgym.tasks.experts.feedback import FeedbackExpert
from avrgym.tasks.feeding.expert import FeedingExpert, compute_initial_food_positions
from avrgym.tasks.feeding.feedback_expert import compute_feeding_target
from avrgym.tasks.feeding.memory_expert import FeedingMemoryExpert
from avrgym.tasks.feeding.reward import REWARD_WEIGHTS, evaluate_step, make_initial_task_state
from avrgym.tasks.observation import make_mouth_task_observation_spec
from avrgym.tasks.person import TURNED_HEAD_POSE
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.task import WHEELCHAIR_SIDE_CAMERA_VIEW, CameraView, CameraViews, Task

MAX_BOWL_OFFSET_M = 0.05
MAX_INITIAL_HAND_OFFSET_M = 0.05
BOWL_TO_HAND_OFFSET_M = np.array([0.0, -0.1, 0.4])
SPOON_YAWS_RAD = np.array([0.0, -0.5 * np.pi])
"""Yaw angles of the spoon relative to the face: tip first, or left side first."""
INITIAL_SPOON_QUAT_W = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(0.5 * np.pi))
"""Initial rotation of the spoon: level, pointing towards the person."""


def make_scene(robot: Robot, tool: Tool = SPOON, add_furniture: FurnitureBuilder = add_table) -> SceneConfig:
    """Returns the scene: a wheelchair and a table with a bowl; the robot's right arm holds the spoon."""
    return placement.make_wheelchair_scene(robot, "right", tool, (0.1, 0.2), (add_furniture,), (BOWL_BODY,))


def sample_initial_states(
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
        + MAX_INITIAL_HAND_OFFSET_M * (2.0 * uniforms[:, 3:6] - 1.0)
    )
    tool, level = placement.compute_tool_pose_in_hand(scene, hand, INITIAL_SPOON_QUAT_W)
    placed = {BOWL_BODY: bowl}
    return placement.find_initial_state(scene, people, placed, tool, level, *_goals(people), uniforms[:, 6:])


def _goals(people: People) -> tuple[FloatArray, FloatArray]:
    """Returns spoon positions (n, 2, 3) and rotations (n, 2, 4) at the mouth.

    The spoon is level, with its tip first or its left side first.
    """
    mouth, head_q = placement.compute_mouth_poses(people)
    into = transforms.rotate(head_q, [0.0, 1.0, 0.0])
    yaw = elementary.arctan2(into[:, 1], into[:, 0])[:, None] + constant_like(SPOON_YAWS_RAD, into)
    return get_namespace(mouth).stack([mouth, mouth], axis=1), transforms.from_axis_angle(
        [0.0, 0.0, 1.0], yaw
    )


def make_feeding_task(settings: Settings = DEFAULT_SETTINGS) -> Task:
    """Returns the task with the spoon, food and table of the settings."""
    offset_m = settings.table_offset_m or (0.0, 0.0, 0.0)
    tool = make_spoon(settings.tool or "medium", settings.particles)
    return Task(
        name="Feeding",
        goal_description="Eat the food from the spoon.",
        pose_distribution=TURNED_HEAD_POSE,
        offered_body_part="mouth",
        make_scene=partial(make_scene, tool=tool, add_furniture=partial(add_table, offset_m=offset_m)),
        num_random_numbers=6 + placement.NUM_RANDOM_NUMBERS,
        sample_initial_states=partial(sample_initial_states, offset_m=offset_m),
        make_initial_task_state=partial(
            make_initial_task_state, particles=len(compute_initial_food_positions(tool))
        ),
        make_observation_spec=make_mouth_task_observation_spec,
        reward_weights=REWARD_WEIGHTS,
        evaluate_step=partial(evaluate_step, table_offset_m=offset_m),
        expert=FeedingExpert,
        feedback_expert=partial(FeedbackExpert, target=compute_feeding_target),
        memory_expert=FeedingMemoryExpert,
        camera_views=CameraViews(
            mounted_robot_view=CameraView((-0.08, -0.30, 0.97), 1.55, 138.0, -28.0),
            floor_robot_view=WHEELCHAIR_SIDE_CAMERA_VIEW,
        ),
        withdraws_tool_after_success=True,
        make_variant=make_feeding_task,
    )


FEEDING = make_feeding_task()
