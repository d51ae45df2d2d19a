"""Feedback expert for drinking. Its actions depend only on the current state."""

import numpy as np

from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.models.cup import DEFAULT_CUP_SHAPE, CupShape
from avrgym.simulation.worlds import State
from avrgym.tasks.drinking import expert
from avrgym.tasks.experts.feedback import (
    TURN_SPEED_RAD_S,
    ToolTarget,
    compute_funnel_standoff_m,
    compute_tool_speed_m_s,
)
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import TaskState

MAX_TILTING_DISTANCE_M = 0.015
"""Maximum distance to the lips at which the cup is tilted further.

It contains a margin for the person's motion and the arm's lag.
"""
TILT_SPEED_RAD_S = 0.12
"""Angular speed of the cup's tilt while it pours."""


def compute_drinking_target(
    state: State, task_state: TaskState, planner: MotionPlanner, cup: CupShape = DEFAULT_CUP_SHAPE
) -> ToolTarget:
    """Returns the next tool target: move the cup straight to the lips, then increase its current tilt."""
    approach = expert.Approach(*np.zeros((2, len(planner.tool_pos_w))))
    tilt = expert.compute_clipped_cup_tilt_rad(planner.tool_quat_w)
    into = transforms.rotate(expert.compute_approach_heading_quat_w(state, approach), expert.FORWARD)
    offset = expert.compute_cup_pose_at_mouth(state, approach, tilt, cup)[0] - planner.tool_pos_w
    near = norm(offset) < MAX_TILTING_DISTANCE_M
    rate = np.where(tilt < expert.POUR_START_TILT_RAD, TURN_SPEED_RAD_S, TILT_SPEED_RAD_S)
    far = norm(offset) > expert.STANDOFF_M
    tilt = np.where(
        near, tilt + planner.scene.control_step_s * rate, np.where(far, expert.CARRY_TILT_RAD, tilt)
    )
    goal_w, q_w = expert.compute_cup_pose_at_mouth(
        state, approach, np.minimum(tilt, expert.EMPTY_CUP_TILT_RAD), cup
    )
    back_m = compute_funnel_standoff_m(offset, into, 0.01, expert.STANDOFF_M)
    return goal_w - back_m[:, None] * into, q_w, compute_tool_speed_m_s(offset, expert.APPROACH_SPEED_M_S)
