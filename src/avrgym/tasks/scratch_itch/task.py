"""Itch scratching: scene, initial states, observation and task."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.models import human
from avrgym.models.furniture import add_wheelchair_without_right_armrest
from avrgym.models.human import People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.scratcher import SCRATCHER
from avrgym.people.distributions import PoseDistribution
from avrgym.simulation.worlds import InitialState, RightArmPoses
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.experts.feedback import FeedbackExpert
from avrgym.tasks.observation import ObservationSpec, make_goal_offset_entry, make_position_entry
from avrgym.tasks.person import MAX_ARM_OFFSET_RAD, move_above_sleeve
from avrgym.tasks.scratch_itch.detour import compute_tool_and_hand_detour_m
from avrgym.tasks.scratch_itch.expert import ScratchItchExpert
from avrgym.tasks.scratch_itch.feedback_expert import compute_scratching_target
from avrgym.tasks.scratch_itch.memory_expert import make_memory_expert
from avrgym.tasks.scratch_itch.reward import (
    REWARD_WEIGHTS,
    ScratchItchState,
    compute_itch_limb_frame,
    compute_itch_pos_w,
    evaluate_step,
    make_initial_task_state,
)
from avrgym.tasks.task import CameraView, CameraViews, Markers, Task

INITIAL_HAND_POS_W, MOBILE_ROBOT_INITIAL_HAND_POS_W = (-0.5, 0.0, 0.8), (-0.55, 0.0, 0.8)
MAX_INITIAL_HAND_OFFSET_M = 0.05
INITIAL_SCRATCHER_QUAT_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(-0.25 * np.pi))
"""Initial rotation of the scratcher. The rod points 45° upwards to the person's shoulder, past the elbow."""

INITIAL_POSE = PoseDistribution(
    rest_angles_rad=human.make_seated_joint_angles(right_shoulder_y=30.0),
    max_offset_rad=MAX_ARM_OFFSET_RAD,
)
"""Initial pose: seated, the right arm abducted by 30°, each joint of this arm within ±10° (paper, section V, and its
code).
"""


def make_scene(robot: Robot) -> SceneConfig:
    """Returns the scene: a wheelchair without its right armrest; the robot's left arm holds the scratcher."""
    return placement.make_wheelchair_scene(
        robot, "left", SCRATCHER, (0.1, 0.0), chair=add_wheelchair_without_right_armrest
    )


def sample_initial_states(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Returns initial states with the robot's hand within ±5 cm of a point next to the elbow.

    The goals of the base search are shoulder, elbow and wrist.
    """
    place = MOBILE_ROBOT_INITIAL_HAND_POS_W if scene.mount.is_on_floor else INITIAL_HAND_POS_W
    hand = constant_like(np.array(place), uniforms) + MAX_INITIAL_HAND_OFFSET_M * (
        2.0 * uniforms[:, 0:3] - 1.0
    )
    tool, tool_q = placement.compute_tool_pose_in_hand(scene, hand, INITIAL_SCRATCHER_QUAT_W)
    goals = placement.compute_right_arm_joint_pos_w(people, scene.posture)
    goals_q = get_namespace(goals).tile(constant_like(INITIAL_SCRATCHER_QUAT_W, goals), (*goals.shape[:2], 1))
    return placement.find_initial_state(scene, people, {}, tool, tool_q, goals, goals_q, uniforms[:, 6:])


def make_observation_spec(scene: SceneConfig) -> ObservationSpec:
    """Returns the observation: scratcher, itch, joints of the robot's arm, the person's arm, and tool force."""
    return ObservationSpec(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            make_goal_offset_entry(
                "tool_from_itch_m", lambda state, itch: state.tool_pos_w - compute_itch_pos_w(state, itch)
            ),
            make_position_entry(
                "itch_from_torso_m",
                lambda state, itch: compute_itch_pos_w(state, itch) - state.robot_torso_pos_w,
            ),
            seen.make_arm_joint_positions_entry(scene),
            *seen.RIGHT_ARM_FROM_ROBOT,
            seen.TOOL_FORCE,
        )
    )


def compute_marker_positions_w(arm: RightArmPoses, task_state: ScratchItchState) -> FloatArray:
    """Returns the position (N, 1, 3) of the itch's marker in the world frame."""
    limb_pos_w, limb_q_w = compute_itch_limb_frame(arm, task_state)
    return (limb_pos_w + transforms.rotate(limb_q_w, move_above_sleeve(task_state.itch)))[:, None]


ITCH_MARKER = Markers(
    num_markers=1,
    radius_m=0.008,
    rgb=(0.85, 0.10, 0.12),
    compute_positions_w=compute_marker_positions_w,
)

SCRATCH_ITCH = Task(
    name="ScratchItch",
    goal_description="Get the itch on your right arm scratched.",
    pose_distribution=INITIAL_POSE,
    offered_body_part="arm",
    make_scene=make_scene,
    num_random_numbers=6 + placement.NUM_RANDOM_NUMBERS,
    sample_initial_states=sample_initial_states,
    make_initial_task_state=make_initial_task_state,
    make_observation_spec=make_observation_spec,
    reward_weights=REWARD_WEIGHTS,
    evaluate_step=evaluate_step,
    expert=ScratchItchExpert,
    feedback_expert=partial(FeedbackExpert, target=compute_scratching_target),
    camera_views=CameraViews(
        mounted_robot_view=CameraView((-0.20, -0.18, 0.88), 1.75, 62.0, -28.0),
        floor_robot_view=CameraView((-0.35, -0.20, 0.95), 2.1, 100.0, -26.0),
    ),
    memory_expert=make_memory_expert,
    compute_detour_m=compute_tool_and_hand_detour_m,
    markers=ITCH_MARKER,
    tracked_body_parts=("head", "right"),
)
