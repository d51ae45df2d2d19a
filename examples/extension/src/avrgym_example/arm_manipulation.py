"""Arm manipulation: lift the person's limp right forearm, which has slid off, back onto the armrest."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from avrgym_example.hook import HOOK, RADIUS_M
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.models import human
from avrgym.models.human import People
from avrgym.models.robot import Robot, UnsuitableError
from avrgym.models.scene import SceneConfig
from avrgym.people.distributions import Pose
from avrgym.simulation.worlds import RightArm, Start, State
from avrgym.tasks import observation as seen
from avrgym.tasks import places
from avrgym.tasks.experts.guide import Guide
from avrgym.tasks.experts.reactive import Aim, Reactive, funnel_m
from avrgym.tasks.observation import Observation, from_goal, position
from avrgym.tasks.person import ARM_SPREAD_RAD
from avrgym.tasks.task import StepResult, Task, View, Views

Array = NDArray[np.float64]

ELBOW, WRIST = 1, 2
POSE = Pose(
    rest_rad=human.joint_angles(right_shoulder_y=38.0, right_elbow_x=-25.0), spread_rad=0.5 * ARM_SPREAD_RAD
)
"""The upper arm spread beside the armrest, the forearm hanging."""
ALONG = 0.75
"""Where on the way from elbow to wrist the hook takes the forearm."""
UNDER = (0.0, 1.0, 0.0)
"""What of the forearm faces down once it is lifted, forearm's frame."""
TOUCHING_M, BEFORE_M, FREE_M = 0.045, 0.08, 0.03
TOOL_Q_W = transforms.IDENTITY_QUATERNION
"""The hook's bar across the forearm, the hand on the person's right."""
ARMREST_X_M, ABOVE_M, BESIDE_M = -0.265, 0.80, 0.08
"""The armrest's middle, how high the wrist is above it, and how far off its middle it may be."""
HELD_STEPS = 10
LIFT_M, LIFT_M_S = 0.05, 0.12
STRONG_FORCE_N = 30.0


@dataclass(frozen=True)
class ArmState:
    """For how many control steps on end the wrist has been above the armrest, and whether for long enough, (N,)."""

    steps: NDArray[np.intp]
    done: NDArray[np.bool_]


def scene(robot: Robot) -> SceneConfig:
    """The wheelchair; the robot's left arm holds the hook by a handle like the scratcher's."""
    if "scratcher" not in robot.grips:
        raise UnsuitableError(f"{robot.name} has no grip 'scratcher', which holds the hook too")
    robot = replace(robot, grips={"hook": robot.grips["scratcher"], **robot.grips})
    return places.wheelchair_scene(robot, "left", HOOK, (0.0, 0.0))


def start(scene: SceneConfig, people: People, uniforms: Array) -> Start:
    """The hook within ±3 cm of a point below the forearm; the base from where the armrest is within reach too."""
    pos_w, q_w = human.body_frames(people, scene.posture)
    arm = RightArm(*(np.stack([part[name] for name in human.RIGHT_ARM], axis=1) for part in (pos_w, q_w)))
    tool_w = taken_w(arm) + (TOUCHING_M + BEFORE_M) * under_w(arm) + 0.03 * (2.0 * uniforms[:, :3] - 1.0)
    goal_w = taken_w(arm).copy()
    goal_w[:, [0, 2]] = ARMREST_X_M, ABOVE_M - TOUCHING_M
    q_w = np.tile(TOOL_Q_W, (len(tool_w), 1))
    return places.start(
        scene, people, {}, tool_w, q_w, goal_w[:, None], q_w[:, None], uniforms[:, 3:]
    )


def init_state(people: People, uniforms: Array) -> ArmState:
    """Not lifted yet."""
    return ArmState(np.zeros(len(uniforms), np.intp), np.zeros(len(uniforms), bool))


def taken_w(arm: RightArm) -> Array:
    """Where the hook takes the forearm, on its axis, (N, 3), world frame."""
    elbow_w, wrist_w = arm.right_arm_pos_w[:, ELBOW], arm.right_arm_pos_w[:, WRIST]
    return elbow_w + ALONG * (wrist_w - elbow_w)


def under_w(arm: RightArm) -> Array:
    """The direction out of the forearm's lower side, (N, 3), world frame."""
    return transforms.rotate(arm.right_arm_q_w[:, ELBOW], UNDER)


def to_armrest(arm: RightArm) -> Array:
    """How far the wrist still has to go to the person's left and up, (N, 2)."""
    wrist_w = arm.right_arm_pos_w[:, WRIST]
    return np.stack([ARMREST_X_M - wrist_w[:, 0], np.maximum(ABOVE_M - wrist_w[:, 2], 0.0)], axis=-1)


def observation(scene: SceneConfig) -> Observation:
    """Hook, forearm and both arms."""
    return Observation(
        (
            seen.TOOL_FROM_TORSO,
            seen.TOOL_ROTATION,
            from_goal("tool_from_forearm_m", lambda state, _: state.tool_pos_w - taken_w(state)),
            position("under_forearm", lambda state, _: under_w(state)),
            seen.arm_angles(scene),
            *seen.RIGHT_ARM_FROM_TORSO,
            seen.TOOL_FORCE,
        )
    )


WEIGHTS = {
    "distance_m": -1.0, "to_armrest_m": -4.0, "action_squared": -0.01, "lifted": 1.0, "strong_force_n": -0.02
}  # fmt: skip


def evaluate_step(state: State, action: Array, task_state: ArmState) -> StepResult:
    """Success is a wrist that was above the armrest for a second on end."""
    way = to_armrest(state)
    lifted = (np.abs(way[:, 0]) < BESIDE_M) & (way[:, 1] == 0.0)
    steps = np.where(lifted, task_state.steps + 1, 0)
    done = task_state.done | (steps >= HELD_STEPS)
    distance = norm(state.tool_pos_w - taken_w(state))
    return StepResult(
        task_state=ArmState(steps, done),
        terms={
            "distance_m": distance,
            "to_armrest_m": norm(way),
            "action_squared": (action * action).sum(axis=-1),
            "lifted": lifted.astype(float),
            "strong_force_n": np.where(state.total_force_n >= STRONG_FORCE_N, state.total_force_n, 0.0),
        },
        distance_m=distance,
        force_on_person_n=state.total_force_n,
        success=done,
        events=done & ~task_state.done,
        gone=np.zeros((len(distance), 0), dtype=bool),
    )


def lift(state: State, task_state: ArmState, guide: Guide) -> Aim:
    """Come below the forearm, then push its lower side up and, once it is high enough, to the person's left."""
    down_w, way = under_w(state), to_armrest(state)
    before = funnel_m(state.tool_pos_w - taken_w(state), down_w, FREE_M, BEFORE_M)
    push = np.where(before > 0.0, 0.0, np.clip(way[:, 1], 0.0, LIFT_M))
    goal_w = taken_w(state) + (TOUCHING_M + before - push)[:, None] * down_w
    goal_w[:, 0] += np.where(way[:, 1] < 0.1, np.clip(way[:, 0], -LIFT_M, LIFT_M), 0.0)
    return goal_w, np.tile(TOOL_Q_W, (len(goal_w), 1)), np.full(len(goal_w), LIFT_M_S)


ARM_MANIPULATION = Task(
    name="ArmManipulation",
    goal="Get your right arm lifted back onto the armrest.",
    pose=POSE,
    offered="nothing",
    strength_share=0.05,
    scene=scene,
    uniforms=3 + places.UNIFORMS,
    start=start,
    init_state=init_state,
    observation=observation,
    weights=WEIGHTS,
    evaluate_step=evaluate_step,
    expert=partial(Reactive, aim=lift),
    reactive_expert=partial(Reactive, aim=lift),
    views=Views(
        mounted=View((-0.30, -0.15, 0.75), 1.75, 62.0, -20.0),
        on_floor=View((-0.35, -0.20, 0.80), 2.1, 100.0, -20.0),
    ),
)
