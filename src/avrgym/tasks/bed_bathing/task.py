"""Bed bathing: scene, initial states, observation and task."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, namespace
from avrgym.models import human
from avrgym.models.human import RECLINED, People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.washcloth import WASHCLOTH
from avrgym.people.distributions import Pose
from avrgym.simulation.worlds import InitialState, RightArmPoses
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.bed_bathing.expert import BedBathingExpert
from avrgym.tasks.bed_bathing.feedback_expert import wiping_target
from avrgym.tasks.bed_bathing.reward import (
    MARKERS_PER_LIMB,
    WEIGHTS,
    BedBathingState,
    evaluate_step,
    init_state,
)
from avrgym.tasks.experts.feedback import FeedbackExpert
from avrgym.tasks.observation import Observation
from avrgym.tasks.person import ARM_SPREAD_RAD, move_above_sleeve
from avrgym.tasks.task import Marks, Task, View, Views

HAND_START_POS_W = np.array([-0.5, -0.1, 1.0])
CLOTH_START_Q_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.radians(45.0))
"""Initial rotation of the cloth. The long side is along the arm. The wiping face is towards the person and
downwards.
"""

INITIAL_POSE = Pose(
    rest_rad=human.seated_joint_angles(
        right_shoulder_y=20.0,
        right_shoulder_x=-20.0,
        right_elbow_x=-45.0,
        left_shoulder_y=-14.0,
        left_elbow_x=-45.0,
    ),
    spread_rad=ARM_SPREAD_RAD,
)
"""Initial pose: reclined, the right arm away from the body (paper, section V, and its code). The left hand is next to
the thigh.

In the pose of the paper's code, the fingers of short people would overlap the thigh.
"""


def scene(robot: Robot) -> SceneConfig:
    """Returns the scene: a hospital bed; the robot's left arm holds the washcloth."""
    return placement.bed_scene(robot, "left", WASHCLOTH)


def start(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Returns initial states with the robot's hand above the person's right arm and to its right.

    The goals of the base search are shoulder, elbow and wrist.
    """
    xp, count = namespace(uniforms), len(uniforms)
    hand, turned = constant_like(HAND_START_POS_W, uniforms), constant_like(CLOTH_START_Q_W, uniforms)
    goals, goal_q = placement.right_arm_joints_w(people, RECLINED), xp.tile(turned, (count, 3, 1))
    tool, tool_q = placement.tool_pose_in_hand(scene, xp.tile(hand, (count, 1)), CLOTH_START_Q_W)
    return placement.find_start(scene, people, {}, tool, tool_q, goals, goal_q, uniforms)


def observation(scene: SceneConfig) -> Observation:
    """Returns the observation: pose of the cloth, joints of the robot's arm, the person's arm, and tool force."""
    return Observation(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            seen.joint_positions(scene),
            *seen.RIGHT_ARM_FROM_ROBOT,
            seen.TOOL_FORCE,
        )
    )


def marker_positions_w(arm: RightArmPoses, task_state: BedBathingState) -> FloatArray:
    """Returns the positions (N, 2 × ``MARKERS_PER_LIMB``, 3) of the markers in the world frame.

    Wiped and unused markers are below the floor.
    """
    drawn = move_above_sleeve(task_state.marker_pos)
    limb_pos_w, limb_q_w = arm.right_arm_pos_w[:, :2, None], arm.right_arm_q_w[:, :2, None]
    pos_w = limb_pos_w + transforms.rotate(limb_q_w, drawn)
    shown = task_state.exists & ~task_state.wiped
    hidden = constant_like(HIDDEN_MARKER_POS_W, pos_w)
    return namespace(pos_w).where(shown[..., None], pos_w, hidden).reshape(len(pos_w), -1, 3)


HIDDEN_MARKER_POS_W = np.array([0.0, 0.0, -1.0])

BED_BATHING = Task(
    name="BedBathing",
    goal="Get your right arm washed.",
    pose=INITIAL_POSE,
    offered="arm",
    scene=scene,
    num_uniforms=placement.NUM_UNIFORMS,
    start=start,
    init_state=init_state,
    observation=observation,
    weights=WEIGHTS,
    evaluate_step=evaluate_step,
    expert=BedBathingExpert,
    feedback_expert=partial(FeedbackExpert, target=wiping_target),
    views=Views(
        mounted=View((-0.25, -0.02, 0.92), 1.85, 70.0, -28.0),
        on_floor=View((-0.35, -0.05, 0.85), 2.6, 112.0, -28.0),
    ),
    marks=Marks(
        count=2 * MARKERS_PER_LIMB, radius_m=0.006, rgb=(0.85, 0.25, 0.30), places=marker_positions_w
    ),
    tracked=("head", "right"),
)
