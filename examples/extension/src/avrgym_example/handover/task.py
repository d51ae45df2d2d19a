"""Handover: scene, initial states, observation, expert and the task record."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.furniture import add_wheelchair_without_right_armrest
from avrgym.models.human import People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.people.distributions import PoseDistribution
from avrgym.simulation.worlds import InitialState, State
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.experts.feedback import FeedbackExpert, ToolTarget, compute_tool_speed_m_s
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.observation import ObservationSpec, make_goal_offset_entry
from avrgym.tasks.person import MAX_ARM_OFFSET_RAD
from avrgym.tasks.task import CameraView, CameraViews, Task
from avrgym_example.handover.remote import REMOTE
from avrgym_example.handover.reward import HAND, WEIGHTS, HandoverState, evaluate_step, init_state, palm_w

POSE = PoseDistribution(
    rest_angles_rad=human.make_seated_joint_angles(right_shoulder_y=30.0), max_offset_rad=MAX_ARM_OFFSET_RAD
)
HAND_START_W, START_SPREAD_M = (-0.55, -0.05, 0.8), 0.05
TOOL_Q_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(-0.25 * np.pi))
"""Pointing 45° upwards to the person's left."""
GAP_M, SLOWEST_M_S = 0.065, 0.03
"""Distance of the remote control's end from the hand's centre, and the lowest speed there."""


def scene(robot: Robot) -> SceneConfig:
    """A wheelchair without its right armrest; the robot's left arm holds the remote control."""
    return placement.make_wheelchair_scene(
        robot, "left", REMOTE, (0.1, 0.0), chair=add_wheelchair_without_right_armrest
    )


def start(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Hand within ±5 cm of a point next to the forearm; the base reaches the person's hand."""
    hand_w = np.array(HAND_START_W) + START_SPREAD_M * (2.0 * uniforms[:, :3] - 1.0)
    tool_w, tool_q_w = placement.compute_tool_pose_in_hand(scene, hand_w, TOOL_Q_W)
    goal_w = placement.compute_right_arm_joint_pos_w(people, scene.posture)[:, HAND:]
    return placement.find_initial_state(
        scene, people, {}, tool_w, tool_q_w, goal_w, tool_q_w[:, None], uniforms[:, 3:]
    )


def observation(scene: SceneConfig) -> ObservationSpec:
    """Remote control, hand and both arms."""
    return ObservationSpec(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            make_goal_offset_entry("tool_from_hand_m", lambda state, _: state.tool_pos_w - palm_w(state)),
            seen.make_arm_joint_positions_entry(scene),
            *seen.RIGHT_ARM_FROM_ROBOT,
            seen.TOOL_FORCE,
        )
    )


def tool_target(state: State, task_state: HandoverState, planner: MotionPlanner) -> ToolTarget:
    """Straight to the hand, on the side of the robot, and stop before the skin."""
    goal_w = palm_w(state) - GAP_M * transforms.rotate(TOOL_Q_W, (1.0, 0.0, 0.0))
    speed = compute_tool_speed_m_s(goal_w - planner.tool_pos_w, SLOWEST_M_S)
    return goal_w, np.tile(TOOL_Q_W, (len(goal_w), 1)), speed


HANDOVER = Task(
    name="Handover",
    goal_description="Get the remote control held within reach of your right hand.",
    pose_distribution=POSE,
    offered_body_part="arm",
    make_scene=scene,
    num_random_numbers=3 + placement.NUM_RANDOM_NUMBERS,
    sample_initial_states=start,
    make_initial_task_state=init_state,
    make_observation_spec=observation,
    reward_weights=WEIGHTS,
    evaluate_step=evaluate_step,
    expert=partial(FeedbackExpert, target=tool_target),
    feedback_expert=partial(FeedbackExpert, target=tool_target),
    camera_views=CameraViews(
        mounted_robot_view=CameraView((-0.20, -0.18, 0.88), 1.75, 62.0, -28.0),
        floor_robot_view=CameraView((-0.35, -0.20, 0.95), 2.1, 100.0, -26.0),
    ),
    tracked_body_parts=("head", "right"),
)
