"""Reward of the handover, and the place of the hand."""

from dataclasses import dataclass

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.models.human import People
from avrgym.simulation.worlds import RightArmPoses, State
from avrgym.tasks.person import zero_comfortable_forces
from avrgym.tasks.task import StepResult

HAND = 2
"""Index in ``RIGHT_ARM``. The frame of the hand is at the wrist."""
PALM_M = (0.0, 0.0, -0.04)
"""Centre of the hand in its frame."""
WITHIN_REACH_M, HELD_STEPS = 0.08, 10
"""Distance from the hand's centre at which the person can take the remote control, and for how many control steps."""
WEIGHTS = {"distance_m": -1.0, "action_squared": -0.01, "within_reach": 1.0, "strong_force_n": -0.05}


@dataclass(frozen=True)
class HandoverState:
    """Number of control steps within reach (N,)."""

    steps: IntArray


def init_state(people: People, uniforms: FloatArray) -> HandoverState:
    """Not within reach yet."""
    return HandoverState(np.zeros(len(uniforms), dtype=np.intp))


def palm_w(arm: RightArmPoses) -> FloatArray:
    """Centre of the right hand (N, 3); world frame."""
    return arm.right_arm_pos_w[:, HAND] + transforms.rotate(arm.right_arm_quat_w[:, HAND], PALM_M)


def evaluate_step(state: State, action: FloatArray, task_state: HandoverState) -> StepResult:
    """Success: one second within reach of the hand."""
    distance = norm(state.tool_pos_w - palm_w(state))
    within_reach = distance < WITHIN_REACH_M
    after = HandoverState(task_state.steps + within_reach)
    return StepResult(
        task_state=after,
        reward_terms={
            "distance_m": distance,
            "action_squared": (action * action).sum(axis=-1),
            "within_reach": within_reach.astype(float),
            "strong_force_n": zero_comfortable_forces(state.total_force_n),
        },
        distance_m=distance,
        force_on_person_n=state.total_force_n,
        success=after.steps >= HELD_STEPS,
        num_events=(after.steps == HELD_STEPS) & within_reach,
        removed_particles_mask=np.zeros((len(distance), 0), dtype=bool),
    )
