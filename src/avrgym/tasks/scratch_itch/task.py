"""Itch scratching: scene, initial states, observation and task."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, namespace
from avrgym.models import human
from avrgym.models.furniture import add_wheelchair_without_right_armrest
from avrgym.models.human import People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.scratcher import SCRATCHER
from avrgym.people.distributions import Pose
from avrgym.simulation.worlds import InitialState, RightArmPoses
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.experts.feedback import FeedbackExpert
from avrgym.tasks.observation import Observation, goal_offset_entry, position_entry
from avrgym.tasks.person import ARM_SPREAD_RAD, move_above_sleeve
from avrgym.tasks.scratch_itch.detour import tool_and_hand_detour_m
from avrgym.tasks.scratch_itch.expert import ScratchItchExpert
from avrgym.tasks.scratch_itch.feedback_expert import scratching_target
from avrgym.tasks.scratch_itch.memory_expert import make_memory_expert
from avrgym.tasks.scratch_itch.reward import (
    WEIGHTS,
    ScratchItchState,
    evaluate_step,
    init_state,
    itch_limb_frame,
    itch_pos_w,
)
from avrgym.tasks.task import Marks, Task, View, Views

HAND_START_POS_W, MOBILE_HAND_START_POS_W = (-0.5, 0.0, 0.8), (-0.55, 0.0, 0.8)
MAX_START_HAND_OFFSET_M = 0.05
SCRATCHER_START_Q_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(-0.25 * np.pi))
"""Initial rotation of the scratcher. The rod points 45° upwards to the person's shoulder, past the elbow."""

INITIAL_POSE = Pose(
    rest_rad=human.seated_joint_angles(right_shoulder_y=30.0),
    spread_rad=ARM_SPREAD_RAD,
)
"""Initial pose: seated, the right arm abducted by 30°, each joint of this arm within ±10° (paper, section V, and its
code).
"""


def scene(robot: Robot) -> SceneConfig:
    """Returns the scene: a wheelchair without its right armrest; the robot's left arm holds the scratcher."""
    return placement.wheelchair_scene(
        robot, "left", SCRATCHER, (0.1, 0.0), chair=add_wheelchair_without_right_armrest
    )


def start(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Returns initial states with the robot's hand within ±5 cm of a point next to the elbow.

    The goals of the base search are shoulder, elbow and wrist.
    """
    place = MOBILE_HAND_START_POS_W if scene.mount.on_floor else HAND_START_POS_W
    hand = constant_like(np.array(place), uniforms) + MAX_START_HAND_OFFSET_M * (2.0 * uniforms[:, 0:3] - 1.0)
    tool, tool_q = placement.tool_pose_in_hand(scene, hand, SCRATCHER_START_Q_W)
    goals = placement.right_arm_joints_w(people, scene.posture)
    goals_q = namespace(goals).tile(constant_like(SCRATCHER_START_Q_W, goals), (*goals.shape[:2], 1))
    return placement.find_start(scene, people, {}, tool, tool_q, goals, goals_q, uniforms[:, 6:])


def observation(scene: SceneConfig) -> Observation:
    """Returns the observation: scratcher, itch, joints of the robot's arm, the person's arm, and tool force."""
    return Observation(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            goal_offset_entry(
                "tool_from_itch_m", lambda state, itch: state.tool_pos_w - itch_pos_w(state, itch)
            ),
            position_entry(
                "itch_from_torso_m", lambda state, itch: itch_pos_w(state, itch) - state.robot_pos_w
            ),
            seen.joint_positions(scene),
            *seen.RIGHT_ARM_FROM_ROBOT,
            seen.TOOL_FORCE,
        )
    )


def marker_positions_w(arm: RightArmPoses, task_state: ScratchItchState) -> FloatArray:
    """Returns the position (N, 1, 3) of the itch's marker in the world frame."""
    limb_pos_w, limb_q_w = itch_limb_frame(arm, task_state)
    return (limb_pos_w + transforms.rotate(limb_q_w, move_above_sleeve(task_state.itch)))[:, None]


ITCH_MARKER = Marks(
    count=1,
    radius_m=0.008,
    rgb=(0.85, 0.10, 0.12),
    places=marker_positions_w,
)

SCRATCH_ITCH = Task(
    name="ScratchItch",
    goal="Get the itch on your right arm scratched.",
    pose=INITIAL_POSE,
    offered="arm",
    scene=scene,
    num_uniforms=6 + placement.NUM_UNIFORMS,
    start=start,
    init_state=init_state,
    observation=observation,
    weights=WEIGHTS,
    evaluate_step=evaluate_step,
    expert=ScratchItchExpert,
    feedback_expert=partial(FeedbackExpert, target=scratching_target),
    views=Views(
        mounted=View((-0.20, -0.18, 0.88), 1.75, 62.0, -28.0),
        on_floor=View((-0.35, -0.20, 0.95), 2.1, 100.0, -26.0),
    ),
    memory_expert=make_memory_expert,
    detour_m=tool_and_hand_detour_m,
    marks=ITCH_MARKER,
    tracked=("head", "right"),
)
