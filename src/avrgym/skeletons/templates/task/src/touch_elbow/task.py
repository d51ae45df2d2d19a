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
from avrgym.people.distributions import Pose
from avrgym.simulation.worlds import InitialState, RightArmPoses, State
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.experts.feedback import FeedbackExpert, ToolTarget, speed_m_s
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.observation import Observation, goal_offset_entry
from avrgym.tasks.person import ARM_SPREAD_RAD, force_above_limit
from avrgym.tasks.task import Marks, StepResult, Task, View, Views

ELBOW = 1
REACHED_M, TOUCHES = 0.08, 5
POSE = Pose(rest_rad=human.seated_joint_angles(right_shoulder_y=30.0), spread_rad=ARM_SPREAD_RAD)
ROBOT_HAND_POS_W = (-0.55, 0.0, 0.8)
TOOL_Q_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(-0.25 * np.pi))


@dataclass(frozen=True)
class TouchState:
    """State of the task in N worlds.

    ``touches``: number (N,) of control steps with contact at the elbow.
    """

    touches: IntArray


def scene(robot: Robot) -> SceneConfig:
    """A wheelchair without its right armrest; the robot's left arm holds the scratcher."""
    return placement.wheelchair_scene(
        robot, "left", SCRATCHER, (0.1, 0.0), chair=add_wheelchair_without_right_armrest
    )


def start(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Initial states: the robot's hand is within ±5 cm of a point next to the elbow. The goal of the base search is the
    elbow."""
    hand_w = np.array(ROBOT_HAND_POS_W) + 0.05 * (2.0 * uniforms[:, :3] - 1.0)
    tool_w, tool_q_w = placement.tool_pose_in_hand(scene, hand_w, TOOL_Q_W)
    elbow_w = placement.right_arm_joints_w(people, scene.posture)[:, ELBOW]
    return placement.find_start(
        scene, people, {}, tool_w, tool_q_w, elbow_w[:, None], tool_q_w[:, None], uniforms[:, 3:]
    )


def init_state(people: People, uniforms: FloatArray) -> TouchState:
    """Initial task state: no contact yet."""
    return TouchState(np.zeros(len(uniforms), dtype=np.intp))


def elbow_w(arm: RightArmPoses) -> FloatArray:
    """Position of the right elbow (N, 3); world frame."""
    return arm.right_arm_pos_w[:, ELBOW]


def observation(scene: SceneConfig) -> Observation:
    """The observation: tool, elbow, joints of the robot's arm, positions of the person's arm, and tool force."""
    return Observation(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            goal_offset_entry("tool_from_elbow_m", lambda state, _: state.tool_pos_w - elbow_w(state)),
            seen.joint_positions(scene),
            *seen.RIGHT_ARM_FROM_ROBOT,
            seen.TOOL_FORCE,
        )
    )


WEIGHTS = {"distance_m": -1.0, "action_squared": -0.01, "touched": 1.0, "strong_force_n": -0.05}


def evaluate_step(state: State, action: FloatArray, task_state: TouchState) -> StepResult:
    """Evaluate a control step. A touch is a tool contact within 8 cm of the elbow's centre. Five control steps with a
    touch are a success.
    """
    near = norm(state.tool_contact_pos_w - elbow_w(state)[:, None]) < REACHED_M
    touched = (near & (state.tool_contact_force_n > 0.0)).any(axis=-1)
    after = TouchState(task_state.touches + touched)
    distance = norm(state.tool_pos_w - elbow_w(state))
    return StepResult(
        task_state=after,
        terms={
            "distance_m": distance,
            "action_squared": (action * action).sum(axis=-1),
            "touched": touched.astype(float),
            "strong_force_n": force_above_limit(state.tool_contact_force_n.sum(axis=-1)),
        },
        distance_m=distance,
        force_on_person_n=state.total_force_n,
        success=after.touches >= TOUCHES,
        events=(after.touches == TOUCHES) & touched,
        gone=np.zeros((len(distance), 0), dtype=bool),
    )


def tool_target(state: State, task_state: TouchState, planner: MotionPlanner) -> ToolTarget:
    """Move the tool straight to the elbow with decreasing speed; stop it at contact."""
    goal_w = np.where(state.tool_force_n[:, None] > 0.0, planner.pos_w, elbow_w(state))
    return goal_w, np.tile(TOOL_Q_W, (len(goal_w), 1)), speed_m_s(goal_w - planner.pos_w, 0.03)


TASK = Task(
    name="TouchElbow",
    goal="Let the robot touch your right elbow.",
    pose=POSE,
    offered="arm",
    scene=scene,
    num_uniforms=3 + placement.NUM_UNIFORMS,
    start=start,
    init_state=init_state,
    observation=observation,
    weights=WEIGHTS,
    evaluate_step=evaluate_step,
    expert=partial(FeedbackExpert, target=tool_target),
    feedback_expert=partial(FeedbackExpert, target=tool_target),
    views=Views(
        mounted=View((-0.20, -0.18, 0.88), 1.75, 62.0, -28.0),
        on_floor=View((-0.35, -0.20, 0.95), 2.1, 100.0, -26.0),
    ),
    hyperparameters={"num_envs": 2, "batch_size": 100, "n_epochs": 1, "imitation_rounds": 1},
    marks=Marks(count=1, radius_m=0.01, rgb=(0.85, 0.10, 0.12), places=lambda arm, _: elbow_w(arm)[:, None]),
    tracked=("head", "right"),
)
