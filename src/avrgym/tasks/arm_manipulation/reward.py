"""Reward of arm manipulation: scooper at the forearm, forearm back on the armrest, and preferences of the person.

Assistive Gym (Erickson et al., 2020) rewards two small distances, for a person in bed. One is between the tool and the
arm, the other between the torso and elbow and wrist. Here the person sits in a wheelchair, and the goal of the arm is
the armrest.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.geometry.transforms import norm
from avrgym.models.furniture.wheelchair import (
    ARMREST_FRONT_Y_M,
    ARMREST_HALF_WIDTH_M,
    ARMREST_TOP_HEIGHT_M,
    ARMREST_X_M,
)
from avrgym.models.human import People
from avrgym.simulation.worlds import RightArmPoses, State
from avrgym.tasks.person import zero_comfortable_forces
from avrgym.tasks.task import StepResult

ELBOW_INDEX, WRIST_INDEX = 1, 2
UP = np.array([0.0, 0.0, 1.0])
LIFTED_POINT_FOREARM_FRACTION = 0.8
"""Point at which the scooper lifts the forearm, from the elbow (0) to the wrist (1).

It is near the centre of mass of forearm and hand.
"""
UPPER_SIDE_DIRECTION, UPPER_SIDE_WEIGHT = np.array([0.0, -1.0, 0.0]), 0.3
"""Direction that points up on a resting forearm, in the forearm's frame. The second value is its weight relative to the
vertical direction.

See ``compute_forearm_up_direction_w``.
"""
RESTING_FOREARM_X_M = -ARMREST_X_M
RESTING_FOREARM_HEIGHT_M = 0.03
"""Height of a resting forearm's axis above the armrest: the mean of the forearms' radii."""
FOREARM_SAMPLE_POSITIONS = (np.arange(10) + 0.5) / 10.0
"""Sampled points of the forearm, from the elbow (0) to the wrist (1)."""
SUCCESS_FOREARM_FRACTION, SUCCESS_STEPS = 0.5, 10
"""Condition of success: minimum share of the forearm above the armrest, and number of consecutive control steps (1
s)."""

REWARD_WEIGHTS: Mapping[str, float] = {
    "distance_m": -1.0,
    "arm_to_armrest_m": -1.0,
    "forearm_share_above_armrest": 1.0,
    "action_squared": -0.01,
    "tool_speed_m_s": -0.25,
    "force_elsewhere_n": -0.01,
    "strong_force_at_arm_n": -0.05,
}
"""Weights of the reward terms: first of the task, then of the person's preferences.

As in Assistive Gym, the two distances have equal weights. The other weights are the same as in the other tasks.
"""


@dataclass(frozen=True)
class ArmManipulationState:
    """Task state: number of consecutive control steps with the forearm above the armrest (N,), and whether the task has
    succeeded (N,).
    """

    steps_above: IntArray
    succeeded: BoolArray


def make_initial_task_state(people: People, uniforms: FloatArray) -> ArmManipulationState:
    """Returns the initial task state of N worlds: the forearm is not above the armrest."""
    xp = get_namespace(uniforms)
    steps = xp.zeros_like(uniforms[:, 0], dtype=xp.int64)
    return ArmManipulationState(steps, steps > 0)


def evaluate_step(state: State, action: FloatArray, task_state: ArmManipulationState) -> StepResult:
    """Returns the result of a step. For success, half of the forearm must be above the armrest for one second."""
    xp = get_namespace(state.tool_pos_w)
    share = compute_forearm_fraction_above_armrest(state)
    steps = xp.where(share >= SUCCESS_FOREARM_FRACTION, task_state.steps_above + 1, 0)
    succeeded = task_state.succeeded | (steps >= SUCCESS_STEPS)
    distance = norm(state.tool_pos_w - compute_lifted_point_w(state))
    force_at_arm = state.tool_contact_force_n.sum(axis=-1)
    terms = {
        "distance_m": distance,
        "arm_to_armrest_m": norm(compute_distance_to_armrest_m(state)),
        "forearm_share_above_armrest": share,
        "action_squared": (action * action).sum(axis=-1),
        "tool_speed_m_s": norm(state.tool_velocity_w),
        "force_elsewhere_n": state.links_force_n,
        "strong_force_at_arm_n": zero_comfortable_forces(force_at_arm),
    }
    return StepResult(
        task_state=ArmManipulationState(steps, succeeded),
        reward_terms=terms,
        distance_m=distance,
        force_on_person_n=state.total_force_n,
        success=succeeded,
        num_events=xp.astype(succeeded & ~task_state.succeeded, xp.int64),
        removed_particles_mask=xp.zeros((len(distance), 0), dtype=xp.bool, device=distance.device),
    )


def compute_forearm_point_w(arm: RightArmPoses, share: FloatArray | float) -> FloatArray:
    """Returns points on the forearm's axis, from the elbow (0) to the wrist (1); ``share`` broadcasts with (N, 3)."""
    elbow_w, wrist_w = arm.right_arm_pos_w[:, ELBOW_INDEX], arm.right_arm_pos_w[:, WRIST_INDEX]
    return elbow_w + share * (wrist_w - elbow_w)


def compute_lifted_point_w(arm: RightArmPoses) -> FloatArray:
    """Returns the point (N, 3) of the forearm's axis that the scooper lifts; world frame."""
    return compute_forearm_point_w(arm, LIFTED_POINT_FOREARM_FRACTION)


def compute_forearm_up_direction_w(arm: RightArmPoses) -> FloatArray:
    """Returns unit vectors (N, 3) that point up and are perpendicular to the forearms; world frame.

    They are defined for vertical forearms as well.
    """
    q_w = arm.right_arm_quat_w[:, ELBOW_INDEX]
    up_w = constant_like(UP, q_w) + UPPER_SIDE_WEIGHT * transforms.rotate(
        q_w, constant_like(UPPER_SIDE_DIRECTION, q_w)
    )
    along_w = transforms.rotate(q_w, constant_like(UP, q_w))
    return transforms.normalize(up_w - along_w * (up_w * along_w).sum(axis=-1)[:, None])


def compute_distance_to_armrest_m(arm: RightArmPoses) -> FloatArray:
    """Returns the distances (N, 2) of the lifted point from its rest position: to the person's left, and up.

    A distance is 0 if the point has passed the rest position in this direction.
    """
    pos_w = compute_lifted_point_w(arm)
    xp = get_namespace(pos_w)
    way = xp.stack(
        [RESTING_FOREARM_X_M - pos_w[:, 0], ARMREST_TOP_HEIGHT_M + RESTING_FOREARM_HEIGHT_M - pos_w[:, 2]],
        axis=-1,
    )
    return xp.maximum(way, xp.zeros_like(way))


def compute_forearm_fraction_above_armrest(arm: RightArmPoses) -> FloatArray:
    """Returns the share (N,) of the forearm's length that is above the armrest, or above the seat next to it."""
    xp = get_namespace(arm.right_arm_pos_w)
    above = [_is_above(compute_forearm_point_w(arm, float(share))) for share in FOREARM_SAMPLE_POSITIONS]
    return xp.stack(above, axis=-1).sum(axis=-1) / float(len(FOREARM_SAMPLE_POSITIONS))


def _is_above(pos_w: FloatArray) -> BoolArray:
    """Returns a boolean mask (N,) of points (N, 3) that are higher than the armrest.

    Points on its outer side or in front of it are excluded.
    """
    beside = pos_w[:, 0] < RESTING_FOREARM_X_M - ARMREST_HALF_WIDTH_M
    return ~beside & (pos_w[:, 1] > ARMREST_FRONT_Y_M) & (pos_w[:, 2] > ARMREST_TOP_HEIGHT_M)
