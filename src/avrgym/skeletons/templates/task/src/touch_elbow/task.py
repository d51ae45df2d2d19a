"""Touching the elbow: move the tip of a scratcher gently to the person's right elbow."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.models import human
from avrgym.models.furniture import add_wheelchair_without_right_armrest
from avrgym.models.human import People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.scratcher import SCRATCHER
from avrgym.people.distributions import PoseDistribution
from avrgym.simulation.worlds import InitialState, RightArmPoses, State
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.experts.feedback import FeedbackExpert, ToolTarget, compute_tool_speed_m_s
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.observation import ObservationSpec, make_goal_offset_entry
from avrgym.tasks.person import MAX_ARM_OFFSET_RAD, zero_comfortable_forces
from avrgym.tasks.task import CameraView, CameraViews, Markers, StepResult, Task

ELBOW_INDEX = 1
MAX_TOUCH_DISTANCE_M, NUM_SUCCESS_TOUCHES = 0.08, 5
POSE = PoseDistribution(
    rest_angles_rad=human.make_seated_joint_angles(right_shoulder_y=30.0), max_offset_rad=MAX_ARM_OFFSET_RAD
)
ROBOT_HAND_POS_W = (-0.55, 0.0, 0.8)
INITIAL_TOOL_QUAT_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(-0.25 * np.pi))


@dataclass(frozen=True)
class TouchState:
    """State of the task in N worlds.

    ``num_touches``: number (N,) of control steps with contact at the elbow.
    """

    num_touches: IntArray


def make_scene(robot: Robot) -> SceneConfig:
    """A wheelchair without its right armrest; the robot's left arm holds the scratcher."""
    return placement.make_wheelchair_scene(
        robot, "left", SCRATCHER, (0.1, 0.0), chair=add_wheelchair_without_right_armrest
    )


def sample_initial_states(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Initial states: the robot's hand is within ±5 cm of a point next to the elbow. The goal of the base search is the
    elbow."""
    hand_w = np.array(ROBOT_HAND_POS_W) + 0.05 * (2.0 * uniforms[:, :3] - 1.0)
    tool_w, tool_q_w = placement.compute_tool_pose_in_hand(scene, hand_w, INITIAL_TOOL_QUAT_W)
    elbow_w = placement.compute_right_arm_joint_pos_w(people, scene.posture)[:, ELBOW_INDEX]
    return placement.find_initial_state(
        scene, people, {}, tool_w, tool_q_w, elbow_w[:, None], tool_q_w[:, None], uniforms[:, 3:]
    )


def make_initial_task_state(people: People, uniforms: FloatArray) -> TouchState:
    """Initial task state: no contact yet."""
    return TouchState(np.zeros(len(uniforms), dtype=np.intp))


def compute_elbow_pos_w(arm: RightArmPoses) -> FloatArray:
    """Position of the right elbow (N, 3); world frame."""
    return arm.right_arm_pos_w[:, ELBOW_INDEX]


def make_observation_spec(scene: SceneConfig) -> ObservationSpec:
    """The observation: tool, elbow, joints of the robot's arm, positions of the person's arm, and tool force."""
    return ObservationSpec(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            make_goal_offset_entry(
                "tool_from_elbow_m", lambda state, _: state.tool_pos_w - compute_elbow_pos_w(state)
            ),
            seen.make_arm_joint_positions_entry(scene),
            *seen.RIGHT_ARM_FROM_ROBOT,
            seen.TOOL_FORCE,
        )
    )


REWARD_WEIGHTS = {"distance_m": -1.0, "action_squared": -0.01, "touched": 1.0, "strong_force_n": -0.05}


def evaluate_step(state: State, action: FloatArray, task_state: TouchState) -> StepResult:
    """Evaluate a control step. A touch is a tool contact within 8 cm of the elbow's centre. Five control steps with a
    touch are a success.
    """
    near = norm(state.tool_contact_pos_w - compute_elbow_pos_w(state)[:, None]) < MAX_TOUCH_DISTANCE_M
    touched = (near & (state.tool_contact_force_n > 0.0)).any(axis=-1)
    after = TouchState(task_state.num_touches + touched)
    distance = norm(state.tool_pos_w - compute_elbow_pos_w(state))
    return StepResult(
        task_state=after,
        reward_terms={
            "distance_m": distance,
            "action_squared": (action * action).sum(axis=-1),
            "touched": touched.astype(float),
            "strong_force_n": zero_comfortable_forces(state.tool_contact_force_n.sum(axis=-1)),
        },
        distance_m=distance,
        force_on_person_n=state.total_force_n,
        success=after.num_touches >= NUM_SUCCESS_TOUCHES,
        num_events=(after.num_touches == NUM_SUCCESS_TOUCHES) & touched,
        removed_particles_mask=np.zeros((len(distance), 0), dtype=bool),
    )


def compute_tool_target(state: State, task_state: TouchState, planner: MotionPlanner) -> ToolTarget:
    """Move the tool straight to the elbow with decreasing speed; stop it at contact."""
    goal_w = np.where(state.tool_force_n[:, None] > 0.0, planner.tool_pos_w, compute_elbow_pos_w(state))
    return (
        goal_w,
        np.tile(INITIAL_TOOL_QUAT_W, (len(goal_w), 1)),
        compute_tool_speed_m_s(goal_w - planner.tool_pos_w, 0.03),
    )


TASK = Task(
    name="TouchElbow",
    goal_description="Let the robot touch your right elbow.",
    pose_distribution=POSE,
    offered_body_part="arm",
    make_scene=make_scene,
    num_random_numbers=3 + placement.NUM_RANDOM_NUMBERS,
    sample_initial_states=sample_initial_states,
    make_initial_task_state=make_initial_task_state,
    make_observation_spec=make_observation_spec,
    reward_weights=REWARD_WEIGHTS,
    evaluate_step=evaluate_step,
    expert=partial(FeedbackExpert, target=compute_tool_target),
    feedback_expert=partial(FeedbackExpert, target=compute_tool_target),
    camera_views=CameraViews(
        mounted_robot_view=CameraView((-0.20, -0.18, 0.88), 1.75, 62.0, -28.0),
        floor_robot_view=CameraView((-0.35, -0.20, 0.95), 2.1, 100.0, -26.0),
    ),
    hyperparameters={"num_envs": 2, "batch_size": 100, "n_epochs": 1, "imitation_rounds": 1},
    markers=Markers(
        num_markers=1,
        radius_m=0.01,
        rgb=(0.85, 0.10, 0.12),
        compute_positions_w=lambda arm, _: compute_elbow_pos_w(arm)[:, None],
    ),
    tracked_body_parts=("head", "right"),
)
