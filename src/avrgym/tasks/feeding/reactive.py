"""The rule by which the reactive expert feeds."""

import numpy as np

from avrgym.geometry import elementary, transforms
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.guide import Guide
from avrgym.tasks.experts.head import heading
from avrgym.tasks.experts.reactive import Aim, funnel_m, speed_m_s
from avrgym.tasks.feeding import expert
from avrgym.tasks.task import TaskState


def feed(state: State, task_state: TaskState, guide: Guide) -> Aim:
    """The level spoon, tip first, through a funnel before the face into the mouth."""
    into = heading(state)
    q_w = transforms.from_axis_angle(expert.UP, elementary.arctan2(into[:, 1], into[:, 0]))
    clearance_m = np.full(len(into), expert.CLEARANCE_M)
    goal_w = expert.at_mouth(state, q_w, 0.0, clearance_m)
    back_m = funnel_m(goal_w - guide.pos_w, into, 0.005, expert.AWAY_M)
    speed = speed_m_s(goal_w - guide.pos_w, expert.ENTER_M_S)
    return goal_w - back_m[:, None] * into, q_w, speed
