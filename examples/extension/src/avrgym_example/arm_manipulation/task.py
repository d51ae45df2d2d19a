"""Arm manipulation: scene, initial states, observation and the task record."""

from dataclasses import replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.compliance import effort_limit
from avrgym.models.human import People
from avrgym.models.robot import Robot, UnsuitableError
from avrgym.models.scene import SceneConfig
from avrgym.people.distributions import Pose
from avrgym.simulation.worlds import MAX_LEAD_RAD, RightArm, Start
from avrgym.tasks import observation as seen
from avrgym.tasks import placement
from avrgym.tasks.observation import Observation, from_goal, position
from avrgym.tasks.person import ARM_SPREAD_RAD
from avrgym.tasks.task import Task, View, Views
from avrgym_example.arm_manipulation.expert import BEFORE_M, HEADING_W, TOUCHING_M, cradling_q_w, lifting
from avrgym_example.arm_manipulation.hook import HOOK
from avrgym_example.arm_manipulation.reward import (
    ABOVE_M,
    ARMREST_X_M,
    WEIGHTS,
    evaluate_step,
    init_state,
    taken_w,
    under_w,
)

POSE = Pose(
    rest_rad=human.joint_angles(right_shoulder_y=38.0, right_shoulder_x=25.0, right_elbow_x=-55.0),
    spread_rad=0.5 * ARM_SPREAD_RAD,
)
"""The upper arm spread beside the armrest, the forearm hanging."""
START_SPREAD_M = 0.03
WEAKEST_N_M = 3.0
"""Least torque of an arm's weakest motor that can lift the forearm."""


def scene(robot: Robot) -> SceneConfig:
    """The wheelchair; the robot's left arm holds the hook by a handle like the scratcher's."""
    if "scratcher" not in robot.grips:
        raise UnsuitableError(f"{robot.name} has no grip 'scratcher', which holds the hook too")
    grips = {"hook": robot.grips["scratcher"], **robot.grips}
    found = placement.wheelchair_scene(replace(robot, grips=grips), "left", HOOK, (0.0, 0.0))
    weakest_n_m = effort_limit(found.arm, MAX_LEAD_RAD).min()
    if weakest_n_m < WEAKEST_N_M:
        raise UnsuitableError(
            f"a motor of {robot.name} presses with {weakest_n_m:.1f} N m; allowed: {WEAKEST_N_M} or more"
        )
    return found


def start(scene: SceneConfig, people: People, uniforms: FloatArray) -> Start:
    """The hook within ±3 cm of a point below the forearm; the base from where the armrest is within reach too."""
    pos_w, q_w = human.body_frames(people, scene.posture)
    arm = RightArm(*(np.stack([part[name] for name in human.RIGHT_ARM], axis=1) for part in (pos_w, q_w)))
    tool_w = (
        taken_w(arm) + (TOUCHING_M + BEFORE_M) * under_w(arm) + START_SPREAD_M * (2.0 * uniforms[:, :3] - 1.0)
    )
    heading_w = HEADING_W[scene.mount.on_floor]
    raised_w, rested_w = (taken_w(arm) for _ in range(2))
    raised_w[:, 2] = rested_w[:, 2] = ABOVE_M - TOUCHING_M
    rested_w[:, 0] = ARMREST_X_M
    goals_w = np.stack([raised_w, rested_w], axis=1)
    goals_q_w = np.tile(transforms.IDENTITY_QUATERNION, (*goals_w.shape[:2], 1))
    tool_q_w = cradling_q_w(arm, heading_w)
    return placement.placed_start(scene, people, {}, tool_w, tool_q_w, goals_w, goals_q_w, uniforms[:, 3:])


def observation(scene: SceneConfig) -> Observation:
    """Hook, forearm and both arms."""
    return Observation(
        (
            seen.TOOL_FROM_TORSO,
            seen.TOOL_ROTATION,
            from_goal("tool_from_forearm_m", lambda state, _: state.tool_pos_w - taken_w(state)),
            position("under_forearm", lambda state, _: under_w(state)),
            seen.joint_positions(scene),
            *seen.RIGHT_ARM_FROM_TORSO,
            seen.TOOL_FORCE,
        )
    )


ARM_MANIPULATION = Task(
    name="ArmManipulation",
    goal="Get your right arm lifted back onto the armrest.",
    pose=POSE,
    offered="nothing",
    strength_share=0.03,
    scene=scene,
    num_uniforms=3 + placement.NUM_UNIFORMS,
    start=start,
    init_state=init_state,
    observation=observation,
    weights=WEIGHTS,
    evaluate_step=evaluate_step,
    expert=lifting,
    feedback_expert=lifting,
    views=Views(
        mounted=View((-0.30, -0.15, 0.75), 1.75, 62.0, -20.0),
        on_floor=View((-0.35, -0.20, 0.80), 2.1, 100.0, -20.0),
    ),
    tracked=("head", "right"),
)
