"""Feedback experts: their actions depend only on the current state."""

from collections.abc import Callable

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import RunningEpisodes, TaskState

ToolTarget = tuple[FloatArray, FloatArray, FloatArray]
"""Target of a tool: position (N, 3), rotation (N, 4), world frame, and speed (N,) in m/s."""

MAX_SPEED_M_S, TURN_SPEED_RAD_S = 0.35, 0.8
SPEED_GAIN_PER_S = 2.0
"""Approach speed of the tool in m/s, per metre of distance from the goal."""
STANDOFF_PER_OFFSET = 2.0
"""Standoff from the goal, per metre of lateral offset that exceeds the free offset."""
AVOIDED_JOINT_RANGE_FRACTION = 0.35
"""Share of a joint's range at each end that the preferred posture avoids."""


class FeedbackPlanner(MotionPlanner):
    """A motion planner that continues from the measured joint positions instead of the servo targets.

    A policy observes only the measured positions. The preferred posture is the current posture, moved away from the
    joint limits.
    """

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Start with the current joint positions of the robots."""
        super().__init__(episodes)
        lower, upper = self._chain.lower_limit, self._chain.upper_limit
        ends = AVOIDED_JOINT_RANGE_FRACTION * (upper - lower)
        self._middle = lower + ends, upper - ends

    def reset_preferred_posture(self) -> None:
        """Set the preferred posture to the current positions, clipped to the middle of the joint ranges."""
        self._update()
        self.preferred_posture = np.clip(self.joint_positions, *self._middle)

    def _update(self) -> None:
        self._continue_from(self._simulation.get_joint_positions())


class FeedbackExpert:
    """Moves the tools to targets. A function computes the targets from the state."""

    def __init__(
        self, episodes: RunningEpisodes, target: Callable[[State, TaskState, MotionPlanner], ToolTarget]
    ) -> None:
        """Start with the current joint positions. ``target`` computes the tool target in each control step."""
        self._episodes, self._target = episodes, target
        self._planner = FeedbackPlanner(episodes)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) of the next control step."""
        self._planner.reset_preferred_posture()
        state, task_state = self._episodes.get_state(), self._episodes.task_state
        pos_w, q_w, speed = self._target(state, task_state, self._planner)
        return self._planner.compute_action_to_pose(pos_w, q_w, speed, TURN_SPEED_RAD_S)


def compute_funnel_standoff_m(
    offset: FloatArray, axis: FloatArray, free_m: float, max_m: float
) -> FloatArray:
    """Returns the standoff (N,) from the goal along ``axis`` (N, 3), in metres; see ``compute_standoff_m``.

    ``offset`` (N, 3) is the vector from tool to goal. The lateral offset is the part of it that is perpendicular to
    ``axis``.
    """
    return compute_standoff_m(norm(offset - (offset * axis).sum(axis=-1)[:, None] * axis), free_m, max_m)


def compute_standoff_m(lateral_offset_m: FloatArray, free_m: float, max_m: float) -> FloatArray:
    """Returns the standoff (N,) from the goal in metres, for lateral offsets (N,) in metres.

    The standoff is 0 for offsets up to ``free_m``. For larger offsets it increases linearly, to at most ``max_m``.
    """
    return np.clip(STANDOFF_PER_OFFSET * (lateral_offset_m - free_m), 0.0, max_m)


def compute_tool_speed_m_s(offset: FloatArray, slowest_m_s: float) -> FloatArray:
    """Returns the tool speed (N,) for vectors (N, 3) from the tool to the goal."""
    return np.clip(SPEED_GAIN_PER_S * norm(offset), slowest_m_s, MAX_SPEED_M_S)
