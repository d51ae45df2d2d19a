"""The rule by which the reactive expert wipes an arm: down on its top, back on its outer side.

Where around the arm the cloth is says which way it goes, so that nothing need be remembered. Places on the arm are
counted along both limbs: 0 to 1 on the upper arm, 1 to 2 across the elbow, 2 to 3 on the forearm.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.bed_bathing import expert
from avrgym.tasks.bed_bathing.expert import (
    CARRY_M_S,
    FOREARM,
    FROM_ENDS_M,
    STRONG_N,
    UPPER_ARM,
    WIPE_M_S,
    cloth_pose,
    limb_frame,
)
from avrgym.tasks.experts.feedback import ToolTarget, funnel_standoff_m
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import TaskState

TOP_RAD, SIDE_RAD = np.radians([12.0, 75.0])
"""Where around the arm the cloth goes down and back, from its top outwards."""
BORDER_RAD, ELBOW_BORDER_RAD, SOFT_RAD = np.radians(43.0), np.radians(22.0), 0.1
"""Between the two, how far up it moves at the elbow, where the cloth lies askew, and how gradual it is."""
HAND_END, SOFT_END = 2.9, 0.08
"""Where along the arm the cloth goes around it, to come back, and how gradually."""
AHEAD, AHEAD_RAD = 0.3, 0.8
"""How far along and at most around the arm the cloth aims from where it is."""
AWAY_M, HOVER_M = 0.045, 0.02
"""From how far above the skin on the cloth is on its way there, and how far above it begins."""
LIFT_M, ADVANCING_M, SLOWEST = 0.03, 0.01, 0.05
"""How high it is lifted across the elbow; how near the skin it goes on, and how slowly where it is not."""
YIELD_M_N, SOFTER_M, FIRMER_M, LOST_M = 0.0003, -0.002, 0.001, 0.006
"""How much deeper it aims for each newton too few, and at most; and where it does not touch."""
HEIGHT_M = (-0.03, 0.01)


def wiping_target(state: State, task_state: TaskState, planner: MotionPlanner) -> ToolTarget:
    """The cloth from the shoulder to the wrist on top of the arm, and back on its outer side."""
    along, angle, above_m = _on_arm(state)
    away = above_m > AWAY_M
    elbow = elementary.sin(np.pi * np.clip(along - 1.0, 0.0, 1.0))
    border = BORDER_RAD + (ELBOW_BORDER_RAD - BORDER_RAD) * np.sqrt(elbow)
    back = _gradual((angle - border) / SOFT_RAD)
    side = np.maximum(back, _gradual((along - HAND_END) / SOFT_END))
    turn: FloatArray = np.clip(TOP_RAD + side * (SIDE_RAD - TOP_RAD) - angle, -AHEAD_RAD, AHEAD_RAD)
    advance = np.maximum(np.clip(1.0 - above_m / ADVANCING_M, SLOWEST, 1.0), np.minimum(1.0, 3.0 * elbow))
    next_along = np.clip(along + (1.0 - 2.0 * back) * AHEAD * advance, 0.0, 3.0)
    skin_w, q_w, out = _arm_pose(
        state, np.where(away, 0.0, next_along), np.where(away, float(TOP_RAD), angle + turn)
    )
    deeper = np.clip(YIELD_M_N * (expert.FORCE_N - state.tool_force_n), SOFTER_M, FIRMER_M)
    deeper = np.where(state.tool_force_n > 0.0, deeper, LOST_M)
    height = np.clip(((planner.pos_w - skin_w) * out).sum(axis=-1) - deeper, *HEIGHT_M)
    height = np.maximum(height, HEIGHT_M[0] + elbow * (LIFT_M - HEIGHT_M[0]))
    before = HOVER_M + funnel_standoff_m(skin_w - state.tool_pos_w, out, HOVER_M, 4.0 * HOVER_M)
    speed = WIPE_M_S * np.clip(2.0 - state.tool_force_n / STRONG_N, 0.2, 1.0)
    pos_w = skin_w + np.where(away, before, height)[:, None] * out
    return pos_w, q_w, np.where(away, CARRY_M_S, speed)


def _gradual(offset: FloatArray) -> FloatArray:
    """From 0 to 1, half at 0."""
    return 0.5 + 0.5 * elementary.tanh(offset)


def _on_arm(state: State) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where the cloths are: along the arm, around it in radians from its top outwards, metres above the skin, (N,)."""
    worlds = len(state.tool_pos_w)
    upper, lower = (limb_frame(state, np.full(worlds, limb)) for limb in (UPPER_ARM, FOREARM))
    from_elbow = state.tool_pos_w - lower.start_w
    limb = ((from_elbow * (upper.along_w + lower.along_w)).sum(axis=-1) > 0.0).astype(np.intp)
    at = limb_frame(state, limb)
    offset, length = state.tool_pos_w - at.start_w, at.length_m
    far: FloatArray = (offset * at.along_w).sum(axis=-1)
    angle = elementary.arctan2((offset * at.outwards_w).sum(axis=-1), (offset * at.top_w).sum(axis=-1))
    share = np.clip((far - FROM_ENDS_M) / (length - 2.0 * FROM_ENDS_M), 0.0, 1.0)
    to_elbow = np.where(limb == 0, length - far, far)
    past_end = np.clip(1.0 - to_elbow / FROM_ENDS_M, 0.0, 1.0)
    along = share + 2.0 * limb + 0.5 * past_end * (1.0 - 2.0 * limb)
    return along, angle, norm(offset - far[:, None] * at.along_w) - at.radius_m


def _arm_pose(
    state: State, along: FloatArray, angle_rad: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A place on the arm's skin: the cloth's face (N, 3) and rotation (N, 4) there, and out of the skin (N, 3)."""
    skin = np.zeros(len(along))
    (upper_w, upper_q_w), (lower_w, lower_q_w) = (
        cloth_pose(state, np.full(len(along), limb), angle_rad, np.clip(along - 2.0 * limb, 0.0, 1.0), skin)
        for limb in range(2)
    )
    part = np.clip(along - 1.0, 0.0, 1.0)[:, None]
    same = np.sign((upper_q_w * lower_q_w).sum(axis=-1, keepdims=True))
    q_w = transforms.normalize((1.0 - part) * upper_q_w + part * same * lower_q_w)
    return (1.0 - part) * upper_w + part * lower_w, q_w, -transforms.rotate(q_w, (1.0, 0.0, 0.0))
