"""The rules by which teachers feed and give drink."""

import numpy as np

from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.oracles import drinking, feeding
from avrgym.oracles.guide import Guide
from avrgym.oracles.head import heading
from avrgym.simulation.worlds import State
from avrgym.tasks.base import TaskState
from avrgym.teachers.reactive import TURN_RAD_S, Aim, funnel_m, speed_m_s

TILT_RAD_S = 0.12
"""How fast a cup is tilted that pours."""


def feed(state: State, task_state: TaskState, guide: Guide) -> Aim:
    """The level spoon, tip first, through a funnel before the face into the mouth."""
    into = heading(state)
    q_w = transforms.from_axis_angle(drinking.UP, elementary.arctan2(into[:, 1], into[:, 0]))
    clearance_m = np.full(len(into), feeding.CLEARANCE_M)
    goal_w = feeding.at_mouth(state, q_w, 0.0, clearance_m)
    back_m = funnel_m(goal_w - guide.pos_w, into, 0.005, feeding.AWAY_M)
    speed = speed_m_s(goal_w - guide.pos_w, feeding.ENTER_M_S)
    return goal_w - back_m[:, None] * into, q_w, speed


def give_drink(state: State, task_state: TaskState, guide: Guide) -> Aim:
    """The cup to the lips, straight on; where it is there, tilted on from how it is tilted."""
    way = drinking.Way(*np.zeros((2, len(guide.pos_w))))
    z_w = transforms.rotate(guide.q_w, drinking.UP)[:, 2]
    tilt = np.maximum(elementary.arccos(np.clip(z_w, -1.0, 1.0)), drinking.TIPPED_RAD)
    into = transforms.rotate(drinking.yaw_q_w(state, way), drinking.FORWARD)
    offset = drinking.at_mouth(state, way, tilt)[0] - guide.pos_w
    near = norm(offset) < drinking.NEAR_M
    rate = np.where(tilt < drinking.FULL_RAD, TURN_RAD_S, TILT_RAD_S)
    far = norm(offset) > drinking.AWAY_M
    tilt = np.where(near, tilt + CONTROL_STEP_S * rate, np.where(far, drinking.TIPPED_RAD, tilt))
    goal_w, q_w = drinking.at_mouth(state, way, np.minimum(tilt, drinking.EMPTY_RAD))
    back_m = funnel_m(offset, into, 0.01, drinking.AWAY_M)
    return goal_w - back_m[:, None] * into, q_w, speed_m_s(offset, drinking.ENTER_M_S)
