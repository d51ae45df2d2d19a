"""Reward of lifting, and the position of the forearm."""

from dataclasses import dataclass

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.models.human import People
from avrgym.simulation.worlds import RightArm, State
from avrgym.tasks.task import StepResult

ELBOW, WRIST = 1, 2
ALONG = 0.75
"""Position of the hook between elbow and wrist, as a share."""
UNDER = (0.0, 1.0, 0.0)
"""What of the forearm faces down once it is lifted, forearm's frame."""
ARMREST_X_M, ABOVE_M, BESIDE_M = -0.265, 0.83, 0.06
"""The armrest's middle, how high the forearm is above it, and how far off its middle it may be."""
HELD_STEPS = 10
STRONG_FORCE_N = 30.0


@dataclass(frozen=True)
class ArmState:
    """Consecutive control steps with the forearm above the armrest, and success (N,)."""

    steps: IntArray
    done: BoolArray


def init_state(people: People, uniforms: FloatArray) -> ArmState:
    """Not lifted yet."""
    return ArmState(np.zeros(len(uniforms), np.intp), np.zeros(len(uniforms), bool))


def taken_w(arm: RightArm) -> FloatArray:
    """Position of the hook on the forearm's axis (N, 3); world frame."""
    elbow_w, wrist_w = arm.right_arm_pos_w[:, ELBOW], arm.right_arm_pos_w[:, WRIST]
    return elbow_w + ALONG * (wrist_w - elbow_w)


def under_w(arm: RightArm) -> FloatArray:
    """Outward direction of the forearm's lower side (N, 3); world frame."""
    return transforms.rotate(arm.right_arm_q_w[:, ELBOW], UNDER)


def to_armrest(arm: RightArm) -> FloatArray:
    """Remaining distance of the forearm to the person's left and up (N, 2)."""
    x, _, z = taken_w(arm).T
    return np.stack([ARMREST_X_M - x, np.maximum(ABOVE_M - z, 0.0)], axis=-1)


WEIGHTS = {
    "distance_m": -1.0, "to_armrest_m": -4.0, "action_squared": -0.01, "lifted": 1.0, "strong_force_n": -0.02
}  # fmt: skip


def evaluate_step(state: State, action: FloatArray, task_state: ArmState) -> StepResult:
    """Success: the forearm was above the armrest for one second."""
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
        events=(done & ~task_state.done).astype(np.intp),
        gone=np.zeros((len(distance), 0), dtype=bool),
    )
