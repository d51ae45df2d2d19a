"""Reward of scratching: gentle strokes at the itch, and the preferences of the person."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like, find_indices_to_compute, get_namespace, make_row_indices
from avrgym.geometry.transforms import norm
from avrgym.models import human
from avrgym.models.human import People
from avrgym.simulation.worlds import RightArmPoses, State
from avrgym.tasks.person import COMFORT_FORCE_LIMIT_N, RIGHT_ARM_LIMBS, zero_comfortable_forces
from avrgym.tasks.task import StepResult

ITCH_RADIUS_M = 0.025
MIN_STROKE_M = 0.01
NUM_SUCCESS_SCRATCHES = 25
ITCH_POSITION_RANGE = (0.2, 0.85)
"""Range of the itch along a limb, as shares of the limb's length.

The range excludes the ends of the limb, which are inside shoulder and elbow.
"""
ITCH_ANGLE_RANGE_RAD = np.array([np.radians(120.0), np.pi])
"""Maximum angle of the itch around upper arm and forearm, measured from the limb's outer side in both directions.

The range excludes the third of the upper arm that faces the torso. A robot hand does not fit there.
"""
REWARD_WEIGHTS: Mapping[str, float] = {
    "distance_m": -1.0,
    "action_squared": -0.01,
    "force_at_itch_n": 0.01,
    "scratch_force_n": 2.0,
    "tool_speed_m_s": -0.25,
    "force_elsewhere_n": -0.01,
    "strong_force_at_itch_n": -0.05,
}
"""Weights of the reward terms: first of the task, then of the person's preferences (paper, section IV, and its
code).
"""


@dataclass(frozen=True)
class ScratchItchState:
    """Task state of N worlds: the itch, and the scratches of the episode.

    Attributes:
        limb: index in ``RIGHT_ARM_LIMBS`` (N,).
        itch, last_scratch: positions of the itch and of the latest scratch in the frame of the limb (N, 3), metres.
        scratches: number of scratches in the episode (N,).
    """

    limb: IntArray
    itch: FloatArray
    last_scratch: FloatArray
    scratches: IntArray


def make_initial_task_state(people: People, uniforms: FloatArray) -> ScratchItchState:
    """Returns the initial task state of N worlds: an itch on the upper arm or forearm (equally likely).

    The position of the itch along and around the limb is uniformly distributed.
    """
    xp = get_namespace(uniforms)
    limb = xp.astype(uniforms[:, 3] < 0.5, xp.int64)
    layout = human.compute_people_layout(people)
    sizes = xp.stack([layout.geom_size[name] for name in RIGHT_ARM_LIMBS], axis=1)[
        make_row_indices(limb), limb
    ]
    radius, length = sizes[:, 0], 2.0 * sizes[:, 1]
    along = length * (
        ITCH_POSITION_RANGE[0] + (ITCH_POSITION_RANGE[1] - ITCH_POSITION_RANGE[0]) * uniforms[:, 4]
    )
    around = constant_like(ITCH_ANGLE_RANGE_RAD, uniforms)[limb] * (2.0 * uniforms[:, 5] - 1.0)
    sine, cosine = elementary.sine_and_cosine(around)
    itch = xp.stack([-radius * cosine, radius * sine, -along], axis=-1)
    return ScratchItchState(limb, itch, xp.zeros_like(itch), xp.zeros_like(limb))


def evaluate_step(state: State, action: FloatArray, task_state: ScratchItchState) -> StepResult:
    """Returns the result of a step, with at most one new scratch.

    A scratch is a tool contact within 2.5 cm of the itch with less than 10 N. The position of a scratch is the
    force-weighted mean of the contacts. It must be more than 1 cm from the previous scratch in the limb's frame.
    """
    xp, itch_w = get_namespace(state.tool_pos_w), compute_itch_pos_w(state, task_state)
    force_n, place = _touch(state, task_state, itch_w)
    moved = norm(place - task_state.last_scratch) > MIN_STROKE_M
    scratch = (force_n > 0.0) & (force_n < COMFORT_FORCE_LIMIT_N) & (moved | (task_state.scratches == 0))
    after = ScratchItchState(
        task_state.limb,
        task_state.itch,
        xp.where(scratch[:, None], place, task_state.last_scratch),
        task_state.scratches + scratch,
    )
    distance = norm(state.tool_pos_w - itch_w)
    terms = {
        "distance_m": distance,
        "action_squared": (action * action).sum(axis=-1),
        "force_at_itch_n": force_n,
        "scratch_force_n": xp.where(scratch, force_n, 0.0),
        "tool_speed_m_s": norm(state.tool_velocity_w),
        "force_elsewhere_n": xp.maximum(state.total_force_n - force_n, 0.0),
        "strong_force_at_itch_n": zero_comfortable_forces(force_n),
    }
    success = after.scratches >= NUM_SUCCESS_SCRATCHES
    nothing = xp.zeros((len(distance), 0), dtype=xp.bool, device=distance.device)
    return StepResult(
        after, terms, distance, state.total_force_n, success, xp.astype(scratch, xp.int64), nothing
    )


def compute_itch_pos_w(state: State, task_state: ScratchItchState) -> FloatArray:
    """Returns the position (N, 3) of the itch in the world frame."""
    limb_pos_w, limb_q_w = compute_itch_limb_frame(state, task_state)
    return limb_pos_w + transforms.rotate(limb_q_w, task_state.itch)


def compute_itch_limb_frame(
    arm: RightArmPoses, task_state: ScratchItchState
) -> tuple[FloatArray, FloatArray]:
    """Returns position (N, 3) and rotation (N, 4) of the limb with the itch, in the world frame."""
    worlds = make_row_indices(task_state.limb)
    return arm.right_arm_pos_w[worlds, task_state.limb], arm.right_arm_quat_w[worlds, task_state.limb]


def _touch(state: State, task_state: ScratchItchState, itch_w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns the contact force (N,) at the itch in newtons, and the mean contact position (N, 3) in the limb's frame.

    The mean is weighted by force. Worlds without a contact have zeros.
    """
    xp = get_namespace(itch_w)
    force_n, place = xp.zeros_like(itch_w[:, 0]), xp.zeros_like(itch_w)
    (rows,) = find_indices_to_compute((state.tool_contact_force_n > 0.0).any(axis=-1))
    if not len(rows):
        return force_n, place
    contact_w = state.tool_contact_pos_w[rows]
    near = norm(contact_w - itch_w[rows, None]) < ITCH_RADIUS_M
    forces = xp.where(near, state.tool_contact_force_n[rows], 0.0)
    force_n[rows] = forces.sum(axis=-1)
    place_w = (forces[..., None] * contact_w).sum(axis=1) / xp.maximum(force_n[rows], 1e-9)[:, None]
    limb_pos_w, limb_q_w = (each[rows] for each in compute_itch_limb_frame(state, task_state))
    place[rows] = transforms.rotate(transforms.conjugate(limb_q_w), place_w - limb_pos_w)
    return force_n, place
