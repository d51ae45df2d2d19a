"""Scratching patiently: an expert who remembers whether the arm has swung in front, for policies that remember.

To the inner side of the forearm a hand comes from in front, over the lap. No short way leads there: the elbow of an arm
that goes straight leans on the person. So the arm first swings, all joints together, to before and above the wrist,
with its elbow up. It is the same way every time, so that it is soon learned.
"""

from typing import NamedTuple

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.tasks.experts.feedback import TURN_RAD_S, FeedbackExpert, FeedbackPlanner
from avrgym.tasks.scratch_itch.expert import SWING_M_S, surface
from avrgym.tasks.scratch_itch.feedback_expert import Range, aim, faces_in, scratching_target
from avrgym.tasks.scratch_itch.reward import limb_frame
from avrgym.tasks.task import Controller, RunningEpisodes


class Swing(NamedTuple):
    """By how much its joints (J,) turn that swing an arm in front, and to which skin it then comes.

    For the last two see ``reactive.faces_in``.
    """

    way_rad: tuple[float, ...]
    inwards: Range
    not_down: Range


SWINGS = {
    "Jaco": Swing((-2.27, -0.57, 0.89, -0.2, -0.1, -0.62, 0.0), inwards=(0.5, 0.8), not_down=(-0.8, -0.6)),
    "PR2": Swing((-0.85, -0.6, -0.9, 0.0, 2.6, 0.75, 0.0), inwards=(0.3, 0.6), not_down=(-0.7, -0.5)),
}
"""By robot. The Jaco goes about the median of the ways by which its hand comes in front reactively; the PR2, whose
forearm turns over, about the mean of the detours that the oracle plans."""
HALF = 0.5
"""From what share of it in front on an arm swings there first."""
SWUNG = 0.85
"""What share of the way is enough."""


def memory_expert(episodes: RunningEpisodes) -> Controller:
    """One whose arm first swings in front, where it is one of ``SWINGS``; others are reactive."""
    swing = SWINGS.get(episodes.scene.robot.name)
    return FeedbackExpert(episodes, scratching_target) if swing is None else SwingsInFront(episodes, swing)


class SwingsInFront:
    """Goes to each of N itches by the reactive rule, from in front only with arms that have swung there."""

    def __init__(self, episodes: RunningEpisodes, swing: Swing) -> None:
        """Begin where people and arms are."""
        self._episodes, self._planner = episodes, FeedbackPlanner(episodes)
        self._swing, self._first_rad = swing, self._planner.angles_rad
        self._way_rad = np.array(swing.way_rad)
        self._swung = np.zeros(len(self._first_rad), dtype=bool)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Actions (N, J)."""
        planner, state, task_state = self._planner, self._episodes.state(), self._episodes.task_state
        planner.relax()
        self._swung |= self._share_of_way() > SWUNG
        out_w, _ = surface(task_state, limb_frame(state, task_state)[1])
        in_front = faces_in(out_w, self._swing.inwards, self._swing.not_down)
        pos_w, q_w, speed = aim(state, task_state, planner, in_front * self._swung)
        angles_rad = planner.line_step(pos_w, q_w, speed, TURN_RAD_S)
        swings = (in_front > HALF) & ~self._swung
        if swings.any():
            swing_rad = planner.joint_step(self._first_rad + self._way_rad, SWING_M_S, np.pi)
            angles_rad = np.where(swings[:, None], swing_rad, angles_rad)
        return planner.action_to(angles_rad)

    def _share_of_way(self) -> FloatArray:
        """How much (N,) of their way arms have gone, in their joints."""
        way_rad = self._way_rad
        return ((self._planner.angles_rad - self._first_rad) * way_rad).sum(axis=-1) / (
            way_rad * way_rad
        ).sum()
