"""Feeding patiently: an expert who comes to heads that rest, for policies that remember.

A head that moves while the spoon touches it presses against the whole arm. So the spoon keeps off the face as long as
the mouth moves, as when people lean to it or turn, and comes in again once it rests.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.transforms import norm
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.feedback import FeedbackExpert, ToolTarget
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.feeding.feedback_expert import feeding_target
from avrgym.tasks.task import RunningEpisodes, TaskState

RESTING_M_S = 0.04
"""A mouth that is slower rests."""
KEPT_OFF_M = 0.06
"""How far before the mouth the spoon stays while the mouth goes twice as fast, or faster; less so below."""


class MemoryExpert:
    """Feeds each of N people by the reactive rule, but for keeping off while the mouth moves."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Begin where people and arms are."""
        self._mouth_w = episodes.state().mouth_pos_w
        self._follow = FeedbackExpert(episodes, self._aim)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Actions (N, J)."""
        return self._follow(observation)

    def _aim(self, state: State, task_state: TaskState, planner: MotionPlanner) -> ToolTarget:
        speed_m_s = norm(state.mouth_pos_w - self._mouth_w) / CONTROL_STEP_S
        self._mouth_w = state.mouth_pos_w
        return feeding_target(state, task_state, planner, kept_off_m(speed_m_s))


def kept_off_m(mouth_m_s: FloatArray) -> FloatArray:
    """How far before mouths (N,) the spoon stays at least that go at speeds (N,)."""
    return KEPT_OFF_M * np.clip(mouth_m_s / RESTING_M_S - 1.0, 0.0, 1.0)
