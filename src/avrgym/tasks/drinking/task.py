"""Drinking: scene, initial states and task."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like
from avrgym.models.cup import CUP, CUP_SHAPES, WATER, make_cup
from avrgym.models.human import People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.tools import Tool
from avrgym.simulation.worlds import InitialState
from avrgym.tasks import placement
from avrgym.tasks.drinking.expert import DrinkingExpert
from avrgym.tasks.drinking.feedback_expert import compute_drinking_target
from avrgym.tasks.drinking.memory_expert import DrinkingMemoryExpert
from avrgym.tasks.drinking.reward import REWARD_WEIGHTS, evaluate_step, make_initial_task_state
from avrgym.tasks.experts.feedback import FeedbackExpert
from avrgym.tasks.observation import make_mouth_task_observation_spec
from avrgym.tasks.person import TURNED_HEAD_POSE
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.task import WHEELCHAIR_SIDE_CAMERA_VIEW, CameraView, CameraViews, Task

INITIAL_HAND_POS_W = (-0.2, -0.5, 1.0)
MAX_INITIAL_HAND_OFFSET_M = 0.05
INITIAL_CUP_QUAT_W = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(0.5 * np.pi))
"""Initial rotation of the cup: upright, the pouring edge towards the person."""


def make_scene(robot: Robot, tool: Tool = CUP) -> SceneConfig:
    """Returns the scene: a wheelchair; the robot's right arm holds the cup."""
    return placement.make_wheelchair_scene(robot, "right", tool, (0.2, 0.2))


def sample_initial_states(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Returns initial states with the robot's hand within ±5 cm of a point in front of the person.

    The cup is upright.
    """
    hand = constant_like(np.array(INITIAL_HAND_POS_W), uniforms) + MAX_INITIAL_HAND_OFFSET_M * (
        2.0 * uniforms[:, 0:3] - 1.0
    )
    tool, upright = placement.compute_tool_pose_in_hand(scene, hand, INITIAL_CUP_QUAT_W)
    mouth, _ = placement.compute_mouth_poses(people)
    return placement.find_initial_state(
        scene, people, {}, tool, upright, mouth[:, None], upright[:, None], uniforms[:, 3:]
    )


def make_drinking_task(settings: Settings = DEFAULT_SETTINGS) -> Task:
    """Returns the task with the cup and the water of the settings."""
    name, particles = settings.tool or "cup", settings.particles or len(WATER.initial_pos)
    tool = make_cup(name, particles)
    shape = CUP_SHAPES[name]
    return Task(
        name="Drinking",
        goal_description="Drink the water from the cup.",
        pose_distribution=TURNED_HEAD_POSE,
        offered_body_part="mouth",
        make_scene=partial(make_scene, tool=tool),
        num_random_numbers=3 + placement.NUM_RANDOM_NUMBERS,
        sample_initial_states=sample_initial_states,
        make_initial_task_state=partial(make_initial_task_state, particles=particles),
        make_observation_spec=make_mouth_task_observation_spec,
        reward_weights=REWARD_WEIGHTS,
        evaluate_step=partial(evaluate_step, cup=shape),
        expert=partial(DrinkingExpert, cup=shape),
        feedback_expert=partial(FeedbackExpert, target=partial(compute_drinking_target, cup=shape)),
        memory_expert=partial(DrinkingMemoryExpert, cup=shape),
        camera_views=CameraViews(
            mounted_robot_view=CameraView((-0.10, -0.25, 0.88), 1.75, 135.0, -22.0),
            floor_robot_view=WHEELCHAIR_SIDE_CAMERA_VIEW,
        ),
        withdraws_tool_after_success=True,
        make_variant=make_drinking_task,
    )


DRINKING = make_drinking_task()
