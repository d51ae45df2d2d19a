"""The rule by which the reactive expert gives drink."""

import numpy as np

from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.simulation.worlds import State
from avrgym.tasks.drinking import expert
from avrgym.tasks.experts.feedback import TURN_RAD_S, ToolTarget, funnel_standoff_m, speed_m_s
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import TaskState

NEAR_M = 0.015
"""How near the lips a cup is tilted on: people move, and the arm lags behind where it is sent."""
TILT_RAD_S = 0.12
"""How fast a cup is tilted that pours."""


def drinking_target(state: State, task_state: TaskState, planner: MotionPlanner) -> ToolTarget:
    """The cup to the lips, straight on; where it is there, tilted on from how it is tilted."""
    way = expert.Way(*np.zeros((2, len(planner.pos_w))))
    tilt = expert.carried_tilt_rad(planner.q_w)
    into = transforms.rotate(expert.yaw_q_w(state, way), expert.FORWARD)
    offset = expert.at_mouth(state, way, tilt)[0] - planner.pos_w
    near = norm(offset) < NEAR_M
    rate = np.where(tilt < expert.FULL_RAD, TURN_RAD_S, TILT_RAD_S)
    far = norm(offset) > expert.AWAY_M
    tilt = np.where(near, tilt + CONTROL_STEP_S * rate, np.where(far, expert.TIPPED_RAD, tilt))
    goal_w, q_w = expert.at_mouth(state, way, np.minimum(tilt, expert.EMPTY_RAD))
    back_m = funnel_standoff_m(offset, into, 0.01, expert.AWAY_M)
    return goal_w - back_m[:, None] * into, q_w, speed_m_s(offset, expert.ENTER_M_S)
