"""Dressing: scene, initial states, observation and task."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import get_namespace
from avrgym.models import human
from avrgym.models.human import JOINTS, People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.sleeve import SLEEVE
from avrgym.people.distributions import PoseDistribution
from avrgym.simulation.worlds import InitialState
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.dressing.expert import DressingExpert, compute_pulling_target, compute_sleeve_opening_quat_w
from avrgym.tasks.dressing.reward import (
    DRESSED_SHOULDER_DISTANCE_M,
    FOREARM_GEOM_INDEX,
    REWARD_WEIGHTS,
    UPPER_ARM_GEOM_INDEX,
    evaluate_step,
    make_initial_task_state,
)
from avrgym.tasks.experts.feedback import FeedbackExpert
from avrgym.tasks.observation import EntryFunction, ObservationSpec, make_position_entry
from avrgym.tasks.task import CameraView, CameraViews, Task

LEFT_ARM = ("left_upper_arm", "left_forearm", "left_hand")
INITIAL_POSE = PoseDistribution(
    rest_angles_rad=human.make_seated_joint_angles(
        left_shoulder_y=-30.0, left_shoulder_x=-70.0, left_elbow_x=-15.0
    ),
    max_offset_rad=np.radians([5.0 if joint.body in LEFT_ARM[:2] else 0.0 for joint in JOINTS.values()]),
)
"""Initial pose: seated, the left arm stretched to the front and side. Each joint of shoulder and elbow is within ±5°.
"""
INITIAL_HAND_DISTANCE_M, MAX_INITIAL_SLEEVE_OFFSET_M = 0.14, 0.03
"""Initial distance of the opening's centre from the hand's centre, and maximum random offset on each axis."""


def make_scene(robot: Robot) -> SceneConfig:
    """Returns the scene: a wheelchair; the robot is on the person's left and holds the sleeve."""
    return placement.make_wheelchair_scene(robot, "right", SLEEVE, (0.1, 0.0), on_left=True)


def sample_initial_states(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Returns initial states with the opening within ±3 cm of a point in front of the hand.

    The base search has three goals, in this order: opening poses at wrist, elbow and shoulder.
    """
    xp = get_namespace(uniforms)
    shoulder_w, elbow_w, wrist_w = (_left_arm_w(people, name) for name in LEFT_ARM)
    forearm_w, upper_arm_w = (
        transforms.normalize(end - begin) for begin, end in ((wrist_w, elbow_w), (elbow_w, shoulder_w))
    )
    hand_w = wrist_w - human.compute_people_layout(people).geom_size["left_hand"][:, :1] * forearm_w
    offset = MAX_INITIAL_SLEEVE_OFFSET_M * (2.0 * uniforms[:, 0:3] - 1.0)
    forearm_q, upper_arm_q = (
        compute_sleeve_opening_quat_w(scene, forearm_w),
        compute_sleeve_opening_quat_w(scene, upper_arm_w),
    )
    goals = xp.stack([wrist_w, elbow_w, shoulder_w - DRESSED_SHOULDER_DISTANCE_M * upper_arm_w], axis=1)
    goals_q = xp.stack([forearm_q, upper_arm_q, upper_arm_q], axis=1)
    tool_w = hand_w - INITIAL_HAND_DISTANCE_M * forearm_w + offset
    return placement.find_initial_state(
        scene, people, {}, tool_w, forearm_q, goals, goals_q, uniforms[:, 3:], along_goals=True
    )


def _left_arm_w(people: People, body: str) -> FloatArray:
    """Returns the origin (n, 3) of a body of the left arm of seated people; world frame."""
    return human.compute_body_frames(people, bodies=(body,))[0][body]


def _left_arm_from_torso(geom: int, end: int) -> EntryFunction:
    return lambda state, _: state.person_capsule_ends_w[:, geom, end] - state.robot_torso_pos_w


def make_observation_spec(scene: SceneConfig) -> ObservationSpec:
    """Returns the observation: tool, joints of the robot's arm, the person's left arm, and tool force."""
    return ObservationSpec(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            seen.make_arm_joint_positions_entry(scene),
            make_position_entry("shoulder_from_torso_m", _left_arm_from_torso(UPPER_ARM_GEOM_INDEX, 1)),
            make_position_entry("elbow_from_torso_m", _left_arm_from_torso(UPPER_ARM_GEOM_INDEX, 0)),
            make_position_entry("wrist_from_torso_m", _left_arm_from_torso(FOREARM_GEOM_INDEX, 0)),
            seen.TOOL_FORCE,
        )
    )


DRESSING = Task(
    name="Dressing",
    goal_description="Get your left arm dressed.",
    pose_distribution=INITIAL_POSE,
    offered_body_part="left_arm",
    make_scene=make_scene,
    num_random_numbers=3 + placement.NUM_RANDOM_NUMBERS,
    sample_initial_states=sample_initial_states,
    make_initial_task_state=make_initial_task_state,
    make_observation_spec=make_observation_spec,
    reward_weights=REWARD_WEIGHTS,
    evaluate_step=evaluate_step,
    expert=DressingExpert,
    feedback_expert=partial(FeedbackExpert, target=compute_pulling_target),
    camera_views=CameraViews(
        mounted_robot_view=CameraView((0.22, -0.25, 0.92), 1.75, 125.0, -24.0),
        floor_robot_view=CameraView((0.35, -0.25, 0.90), 2.3, 105.0, -26.0),
    ),
    tracked_body_parts=("head", "left"),
)
