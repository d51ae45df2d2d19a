"""Bed bathing: scene, initial states, observation and task."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.models import human
from avrgym.models.human import RECLINED_POSTURE, People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.washcloth import WASHCLOTH
from avrgym.people.distributions import PoseDistribution
from avrgym.simulation.worlds import InitialState, RightArmPoses
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.bed_bathing.expert import BedBathingExpert
from avrgym.tasks.bed_bathing.feedback_expert import compute_wiping_target
from avrgym.tasks.bed_bathing.reward import (
    MARKERS_PER_LIMB,
    REWARD_WEIGHTS,
    BedBathingState,
    evaluate_step,
    make_initial_task_state,
)
from avrgym.tasks.experts.feedback import FeedbackExpert
from avrgym.tasks.observation import ObservationSpec
from avrgym.tasks.person import MAX_ARM_OFFSET_RAD, move_above_sleeve
from avrgym.tasks.task import CameraView, CameraViews, Markers, Task

INITIAL_HAND_POS_W = np.array([-0.5, -0.1, 1.0])
INITIAL_CLOTH_QUAT_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.radians(45.0))
"""Initial rotation of the cloth. The long side is along the arm. The wiping face is towards the person and
downwards.
"""

INITIAL_POSE = PoseDistribution(
    rest_angles_rad=human.make_seated_joint_angles(
        right_shoulder_y=20.0,
        right_shoulder_x=-20.0,
        right_elbow_x=-45.0,
        left_shoulder_y=-14.0,
        left_elbow_x=-45.0,
    ),
    max_offset_rad=MAX_ARM_OFFSET_RAD,
)
"""Initial pose: reclined, the right arm away from the body (paper, section V, and its code). The left hand is next to
the thigh.

In the pose of the paper's code, the fingers of short people would overlap the thigh.
"""


def make_scene(robot: Robot) -> SceneConfig:
    """Returns the scene: a hospital bed; the robot's left arm holds the washcloth."""
    return placement.make_bed_scene(robot, "left", WASHCLOTH)


def sample_initial_states(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Returns initial states with the robot's hand above the person's right arm and to its right.

    The goals of the base search are shoulder, elbow and wrist.
    """
    xp, count = get_namespace(uniforms), len(uniforms)
    hand, turned = constant_like(INITIAL_HAND_POS_W, uniforms), constant_like(INITIAL_CLOTH_QUAT_W, uniforms)
    goals, goal_q = (
        placement.compute_right_arm_joint_pos_w(people, RECLINED_POSTURE),
        xp.tile(turned, (count, 3, 1)),
    )
    tool, tool_q = placement.compute_tool_pose_in_hand(scene, xp.tile(hand, (count, 1)), INITIAL_CLOTH_QUAT_W)
    return placement.find_initial_state(scene, people, {}, tool, tool_q, goals, goal_q, uniforms)


def make_observation_spec(scene: SceneConfig) -> ObservationSpec:
    """Returns the observation: pose of the cloth, joints of the robot's arm, the person's arm, and tool force."""
    return ObservationSpec(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            seen.make_arm_joint_positions_entry(scene),
            *seen.RIGHT_ARM_FROM_ROBOT,
            seen.TOOL_FORCE,
        )
    )


def compute_marker_positions_w(arm: RightArmPoses, task_state: BedBathingState) -> FloatArray:
    """Returns the positions (N, 2 × ``MARKERS_PER_LIMB``, 3) of the markers in the world frame.

    Wiped and unused markers are below the floor.
    """
    drawn = move_above_sleeve(task_state.marker_pos)
    limb_pos_w, limb_q_w = arm.right_arm_pos_w[:, :2, None], arm.right_arm_quat_w[:, :2, None]
    pos_w = limb_pos_w + transforms.rotate(limb_q_w, drawn)
    shown = task_state.exists & ~task_state.wiped
    hidden = constant_like(HIDDEN_MARKER_POS_W, pos_w)
    return get_namespace(pos_w).where(shown[..., None], pos_w, hidden).reshape(len(pos_w), -1, 3)


HIDDEN_MARKER_POS_W = np.array([0.0, 0.0, -1.0])

BED_BATHING = Task(
    name="BedBathing",
    goal_description="Get your right arm washed.",
    pose_distribution=INITIAL_POSE,
    offered_body_part="arm",
    make_scene=make_scene,
    num_random_numbers=placement.NUM_RANDOM_NUMBERS,
    sample_initial_states=sample_initial_states,
    make_initial_task_state=make_initial_task_state,
    make_observation_spec=make_observation_spec,
    reward_weights=REWARD_WEIGHTS,
    evaluate_step=evaluate_step,
    expert=BedBathingExpert,
    feedback_expert=partial(FeedbackExpert, target=compute_wiping_target),
    camera_views=CameraViews(
        mounted_robot_view=CameraView((-0.25, -0.02, 0.92), 1.85, 70.0, -28.0),
        floor_robot_view=CameraView((-0.35, -0.05, 0.85), 2.6, 112.0, -28.0),
    ),
    markers=Markers(
        num_markers=2 * MARKERS_PER_LIMB,
        radius_m=0.006,
        rgb=(0.85, 0.25, 0.30),
        compute_positions_w=compute_marker_positions_w,
    ),
    tracked_body_parts=("head", "right"),
)
