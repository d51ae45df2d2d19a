"""Moving a tool by a rule that knows the present only."""

from collections.abc import Callable

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import RunningEpisodes, TaskState

ToolTarget = tuple[FloatArray, FloatArray, FloatArray]
"""Where a tool should go: position (N, 3) and rotation (N, 4), world frame, and its speed (N,), m/s."""

FASTEST_M_S, TURN_RAD_S = 0.35, 0.8
SPEED_PER_M = 2.0
"""The tool slows down on its way, in 1/s."""
FUNNEL = 2.0
"""How far before the goal the tool stays for each metre that it is beside it."""
END_SHARE = 0.35
"""What share of a joint's range, at each end of it, the arm is drawn out of wherever the tool leaves it free to."""


class FeedbackPlanner(MotionPlanner):
    """Goes on from where the arms are, which a policy sees, and not from where their servos aim, which it does not.

    The arms go along as they come, drawn nowhere but away from the ends of their joints' ranges.
    """

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Begin where the arms are."""
        super().__init__(episodes)
        lower_rad, upper_rad = self._chain.lower_rad, self._chain.upper_rad
        ends_rad = END_SHARE * (upper_rad - lower_rad)
        self._middle_rad = lower_rad + ends_rad, upper_rad - ends_rad

    def relax(self) -> None:
        """Draw the arms to where they are, or as far as to the middle of their joints' ranges."""
        self._see()
        self.posture_rad = np.clip(self.angles_rad, *self._middle_rad)

    def _see(self) -> None:
        self._put(self._simulation.arm_angles_rad())


class FeedbackExpert:
    """Moves the tools to where a rule aims them."""

    def __init__(
        self, episodes: RunningEpisodes, aim: Callable[[State, TaskState, MotionPlanner], ToolTarget]
    ) -> None:
        """Begin where the arms are."""
        self._episodes, self._aim = episodes, aim
        self._guide = FeedbackPlanner(episodes)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Actions (N, J)."""
        self._guide.relax()
        state, task_state = self._episodes.state(), self._episodes.task_state
        pos_w, q_w, speed = self._aim(state, task_state, self._guide)
        return self._guide.toward(pos_w, q_w, speed, TURN_RAD_S)


def funnel_standoff_m(offset: FloatArray, axis: FloatArray, free_m: float, most_m: float) -> FloatArray:
    """How far before its goal a tool should stay, (N,), that is beside the goal's axis by more than ``free_m``."""
    return standoff_m(norm(offset - (offset * axis).sum(axis=-1)[:, None] * axis), free_m, most_m)


def standoff_m(beside_m: FloatArray, free_m: float, most_m: float) -> FloatArray:
    """How far before its goal a tool should stay, (N,), that is beside it by (N,), more than ``free_m``."""
    return np.clip(FUNNEL * (beside_m - free_m), 0.0, most_m)


def speed_m_s(offset: FloatArray, slowest_m_s: float) -> FloatArray:
    """How fast a tool should go (N,) that is away from its goal by offsets (N, 3)."""
    return np.clip(SPEED_PER_M * norm(offset), slowest_m_s, FASTEST_M_S)
