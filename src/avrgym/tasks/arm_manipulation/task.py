"""Arm manipulation: scene, initial states, observation and task."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.models import human
from avrgym.models.furniture.wheelchair import ARMREST_TOP_HEIGHT_M
from avrgym.models.human import JOINTS, People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.scooper import SCOOPER
from avrgym.people.distributions import PoseDistribution
from avrgym.simulation.worlds import InitialState, RightArmPoses
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.arm_manipulation.expert import (
    CONTACT_OFFSET_M,
    MAX_STANDOFF_M,
    compute_handle_direction_w,
    compute_scooper_quat_w,
    make_lifting_expert,
)
from avrgym.tasks.arm_manipulation.reward import (
    RESTING_FOREARM_HEIGHT_M,
    RESTING_FOREARM_X_M,
    REWARD_WEIGHTS,
    compute_forearm_up_direction_w,
    compute_lifted_point_w,
    evaluate_step,
    make_initial_task_state,
)
from avrgym.tasks.observation import ObservationSpec, make_goal_offset_entry, make_position_entry
from avrgym.tasks.person import MAX_ARM_OFFSET_RAD
from avrgym.tasks.task import CameraView, CameraViews, Task

INITIAL_POSE = PoseDistribution(
    rest_angles_rad=human.make_seated_joint_angles(right_shoulder_y=52.0, right_elbow_x=-55.0),
    max_offset_rad=0.5 * MAX_ARM_OFFSET_RAD,
)
"""Initial pose: seated, the upper arm outside the armrest, the forearm hanging down. Each joint of the arm is within
±5°.

With less abduction, the arms of short people overlap the armrest, and the hand is close to a mounted robot.
"""
LIMP_ARM_STRENGTH_FRACTIONS = {
    **{joint: 0.03 for joint in JOINTS if joint.startswith("right_")},
    "right_shoulder_y": 0.005,
    "right_elbow_x": 0.015,
}
"""Share of people's strength in the joints of the limp arm (assumption).

The model compensates gravity. Instead of the arm's weight, these joint torques resist the lift: 0.75 N m at the elbow.
The shoulder resists a swing of the upper arm with 1.8 N m, and its adduction with 0.3 N m.
"""
MAX_INITIAL_SCOOPER_OFFSET_M, MAX_INITIAL_SCOOPER_X_M = 0.03, -0.44
"""Maximum random offset of the scooper at the start, and largest x coordinate before this offset is added.

At this coordinate, the scooper does not touch the wheel of the wheelchair.
"""


def make_scene(robot: Robot) -> SceneConfig:
    """Returns the scene: a wheelchair; the robot's left arm holds the scooper.

    Raises:
        UnsuitableRobotError: if the robot has no suitable arm, mount or grip.
    """
    return placement.make_wheelchair_scene(robot, "left", SCOOPER, (0.0, 0.0))


def sample_initial_states(scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
    """Returns initial states with the scooper within ±3 cm of a point below the forearm.

    The base search has two goals: tool poses on the path of the forearm to the armrest.
    """
    xp = get_namespace(uniforms)
    pos_w, q_w = human.compute_body_frames(people, scene.posture, human.RIGHT_ARM_BODIES)
    arm = RightArmPoses(
        *(xp.stack([part[name] for name in human.RIGHT_ARM_BODIES], axis=1) for part in (pos_w, q_w))
    )
    lifted_w, up_w = compute_lifted_point_w(arm), compute_forearm_up_direction_w(arm)
    height = xp.full_like(lifted_w[:, 0], ARMREST_TOP_HEIGHT_M + RESTING_FOREARM_HEIGHT_M - CONTACT_OFFSET_M)
    spread_m = MAX_INITIAL_SCOOPER_OFFSET_M * (2.0 * uniforms[:, :3] - 1.0)
    tool_w, tool_q_w = (
        lifted_w - (CONTACT_OFFSET_M + MAX_STANDOFF_M) * up_w,
        compute_scooper_quat_w(arm, compute_handle_direction_w(scene)),
    )
    tool_w = spread_m + xp.stack(
        [xp.minimum(tool_w[:, 0], 0.0 * height + MAX_INITIAL_SCOOPER_X_M), tool_w[:, 1], tool_w[:, 2]],
        axis=-1,
    )
    over_armrest = xp.full_like(height, RESTING_FOREARM_X_M)
    goals_w = xp.stack(
        [xp.stack([x, lifted_w[:, 1], height], axis=-1) for x in (lifted_w[:, 0], over_armrest)], axis=1
    )
    level = constant_like(np.array([1.0, 0.0, 0.0, 0.0]), goals_w)
    goals_q_w = xp.tile(level, (*goals_w.shape[:2], 1))
    return placement.find_initial_state(
        scene, people, {}, tool_w, tool_q_w, goals_w, goals_q_w, uniforms[:, 3:]
    )


def make_observation_spec(scene: SceneConfig) -> ObservationSpec:
    """Returns the observation: tool, forearm, joints of the robot's arm, the person's arm, and tool force."""
    return ObservationSpec(
        (
            seen.TOOL_FROM_ROBOT,
            seen.TOOL_ROTATION,
            make_goal_offset_entry(
                "tool_from_forearm_m", lambda state, _: state.tool_pos_w - compute_lifted_point_w(state)
            ),
            make_position_entry("across_forearm", lambda state, _: compute_forearm_up_direction_w(state)),
            seen.make_arm_joint_positions_entry(scene),
            *seen.RIGHT_ARM_FROM_ROBOT,
            seen.TOOL_FORCE,
        )
    )


ARM_MANIPULATION = Task(
    name="ArmManipulation",
    goal_description="Get your right arm lifted back onto the armrest.",
    pose_distribution=INITIAL_POSE,
    offered_body_part="arm",
    strength_share=LIMP_ARM_STRENGTH_FRACTIONS,
    make_scene=make_scene,
    num_random_numbers=3 + placement.NUM_RANDOM_NUMBERS,
    sample_initial_states=sample_initial_states,
    make_initial_task_state=make_initial_task_state,
    make_observation_spec=make_observation_spec,
    reward_weights=REWARD_WEIGHTS,
    evaluate_step=evaluate_step,
    expert=make_lifting_expert,
    feedback_expert=make_lifting_expert,
    camera_views=CameraViews(
        mounted_robot_view=CameraView((-0.30, -0.15, 0.75), 1.75, 62.0, -20.0),
        floor_robot_view=CameraView((-0.35, -0.20, 0.80), 2.1, 100.0, -20.0),
    ),
    tracked_body_parts=("head", "right"),
)
