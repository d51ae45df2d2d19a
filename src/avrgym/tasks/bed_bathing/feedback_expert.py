"""Feedback expert for bed bathing: wipes along the top of the arm to the hand, and back along the outer side.

The angle of the cloth around the arm determines the direction of motion. The expert therefore needs no memory.
Positions along the arm are 0 to 1 on the upper arm and 2 to 3 on the forearm. Across the elbow they are 1 to 2.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.bed_bathing import expert
from avrgym.tasks.bed_bathing.expert import (
    CARRY_SPEED_M_S,
    FOREARM,
    LIMB_END_MARGIN_M,
    MAX_FORCE_N,
    UPPER_ARM,
    WIPE_SPEED_M_S,
    compute_cloth_pose,
    compute_limb_frame,
)
from avrgym.tasks.experts.feedback import ToolTarget, compute_funnel_standoff_m
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import TaskState

TOP_PASS_ANGLE_RAD = np.radians(12.0)
"""Angle of the cloth around the arm during the motion towards the hand; 0 at the arm's top, positive outwards."""
SIDE_PASS_ANGLE_RAD = np.radians(75.0)
"""Angle of the cloth around the arm during the motion back to the shoulder; 0 at the arm's top, positive outwards."""
PASS_BORDER_ANGLE_RAD = np.radians(43.0)
"""Angle around the arm between both motions. Below it the cloth moves towards the hand, above it back."""
ELBOW_BORDER_ANGLE_RAD = np.radians(22.0)
"""Replaces ``PASS_BORDER_ANGLE_RAD`` at the elbow, where the cloth is tilted."""
PASS_TRANSITION_WIDTH_RAD = 0.1
"""Width of the transition between these two motions, as an angle around the arm."""
TURN_BACK_ARM_POSITION = 2.9
"""Position along the arm, near the wrist, at which the cloth turns back."""
TURN_BACK_TRANSITION_WIDTH = 0.08
"""Width of the transition at ``TURN_BACK_ARM_POSITION``, in positions along the arm."""
LOOKAHEAD_DISTANCE = 0.3
"""Distance from the cloth to its target, in positions along the arm."""
MAX_LOOKAHEAD_ANGLE_RAD = 0.8
"""Largest angle around the arm from the cloth to its target."""
APPROACH_HEIGHT_M = 0.045
"""Minimum height above the skin of a cloth that approaches the arm."""
APPROACH_END_HEIGHT_M = 0.02
"""Height of the cloth above the skin at which the approach ends."""
ELBOW_LIFT_HEIGHT_M = 0.03
"""Height of the cloth above the skin at the elbow."""
MAX_ADVANCE_HEIGHT_M = 0.01
"""Maximum height above the skin at which the cloth moves along the arm."""
MIN_SPEED_FRACTION = 0.05
"""Minimum speed of the cloth along the arm, divided by the full speed."""
DEPTH_GAIN_M_PER_N = 0.0003
"""Change of the target's depth in one control step, per newton of force error."""
MIN_DEPTH_STEP_M, MAX_DEPTH_STEP_M = -0.002, 0.001
"""Minimum and maximum change of the target's depth in one control step."""
NO_CONTACT_DEPTH_STEP_M = 0.006
"""Change of the target's depth in one control step without contact."""
TARGET_HEIGHT_RANGE_M = (-0.03, 0.01)
"""Range of the height of the cloth's target above the skin; negative heights are below the skin."""


def compute_wiping_target(state: State, task_state: TaskState, planner: MotionPlanner) -> ToolTarget:
    """Returns the next tool target: to the wrist on top of the arm, back to the shoulder on the outer side."""
    along, angle, above_m = _on_arm(state)
    away = above_m > APPROACH_HEIGHT_M
    elbow = elementary.sin(np.pi * np.clip(along - 1.0, 0.0, 1.0))
    border = PASS_BORDER_ANGLE_RAD + (ELBOW_BORDER_ANGLE_RAD - PASS_BORDER_ANGLE_RAD) * np.sqrt(elbow)
    back = _gradual((angle - border) / PASS_TRANSITION_WIDTH_RAD)
    side = np.maximum(back, _gradual((along - TURN_BACK_ARM_POSITION) / TURN_BACK_TRANSITION_WIDTH))
    turn: FloatArray = np.clip(
        TOP_PASS_ANGLE_RAD + side * (SIDE_PASS_ANGLE_RAD - TOP_PASS_ANGLE_RAD) - angle,
        -MAX_LOOKAHEAD_ANGLE_RAD,
        MAX_LOOKAHEAD_ANGLE_RAD,
    )
    advance = np.maximum(
        np.clip(1.0 - above_m / MAX_ADVANCE_HEIGHT_M, MIN_SPEED_FRACTION, 1.0), np.minimum(1.0, 3.0 * elbow)
    )
    next_along = np.clip(along + (1.0 - 2.0 * back) * LOOKAHEAD_DISTANCE * advance, 0.0, 3.0)
    skin_w, q_w, out = _arm_pose(
        state, np.where(away, 0.0, next_along), np.where(away, float(TOP_PASS_ANGLE_RAD), angle + turn)
    )
    deeper = np.clip(
        DEPTH_GAIN_M_PER_N * (expert.TARGET_FORCE_N - state.tool_force_n), MIN_DEPTH_STEP_M, MAX_DEPTH_STEP_M
    )
    deeper = np.where(state.tool_force_n > 0.0, deeper, NO_CONTACT_DEPTH_STEP_M)
    height = np.clip(((planner.tool_pos_w - skin_w) * out).sum(axis=-1) - deeper, *TARGET_HEIGHT_RANGE_M)
    height = np.maximum(
        height, TARGET_HEIGHT_RANGE_M[0] + elbow * (ELBOW_LIFT_HEIGHT_M - TARGET_HEIGHT_RANGE_M[0])
    )
    before = APPROACH_END_HEIGHT_M + compute_funnel_standoff_m(
        skin_w - state.tool_pos_w, out, APPROACH_END_HEIGHT_M, 4.0 * APPROACH_END_HEIGHT_M
    )
    speed = WIPE_SPEED_M_S * np.clip(2.0 - state.tool_force_n / MAX_FORCE_N, 0.2, 1.0)
    pos_w = skin_w + np.where(away, before, height)[:, None] * out
    return pos_w, q_w, np.where(away, CARRY_SPEED_M_S, speed)


def _gradual(offset: FloatArray) -> FloatArray:
    """Returns the values of a smooth step function, 0 to 1, at ``offset``. The value at offset 0 is 0.5."""
    return 0.5 + 0.5 * elementary.tanh(offset)


def _on_arm(state: State) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns the cloth's position along the arm, its angle around the arm, and its height above the skin, (N,) each.

    The angle is 0 at the arm's top and positive outwards.
    """
    worlds = len(state.tool_pos_w)
    upper, lower = (compute_limb_frame(state, np.full(worlds, limb)) for limb in (UPPER_ARM, FOREARM))
    from_elbow = state.tool_pos_w - lower.shoulder_end_pos_w
    limb = ((from_elbow * (upper.limb_direction_w + lower.limb_direction_w)).sum(axis=-1) > 0.0).astype(
        np.intp
    )
    at = compute_limb_frame(state, limb)
    offset, length = state.tool_pos_w - at.shoulder_end_pos_w, at.length_m
    far: FloatArray = (offset * at.limb_direction_w).sum(axis=-1)
    angle = elementary.arctan2(
        (offset * at.outward_direction_w).sum(axis=-1), (offset * at.up_direction_w).sum(axis=-1)
    )
    share = np.clip((far - LIMB_END_MARGIN_M) / (length - 2.0 * LIMB_END_MARGIN_M), 0.0, 1.0)
    to_elbow = np.where(limb == 0, length - far, far)
    past_end = np.clip(1.0 - to_elbow / LIMB_END_MARGIN_M, 0.0, 1.0)
    along = share + 2.0 * limb + 0.5 * past_end * (1.0 - 2.0 * limb)
    return along, angle, norm(offset - far[:, None] * at.limb_direction_w) - at.radius_m


def _arm_pose(
    state: State, along: FloatArray, angle_rad: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns cloth position (N, 3), rotation (N, 4) and skin normal (N, 3) at a position along the arm."""
    skin = np.zeros(len(along))
    (upper_w, upper_q_w), (lower_w, lower_q_w) = (
        compute_cloth_pose(
            state, np.full(len(along), limb), angle_rad, np.clip(along - 2.0 * limb, 0.0, 1.0), skin
        )
        for limb in range(2)
    )
    part = np.clip(along - 1.0, 0.0, 1.0)[:, None]
    same = np.sign((upper_q_w * lower_q_w).sum(axis=-1, keepdims=True))
    q_w = transforms.normalize((1.0 - part) * upper_q_w + part * same * lower_q_w)
    return (1.0 - part) * upper_w + part * lower_w, q_w, -transforms.rotate(q_w, (1.0, 0.0, 0.0))
