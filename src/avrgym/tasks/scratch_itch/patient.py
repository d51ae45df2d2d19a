"""Scratching patiently: an expert who remembers whether the arm has turned over, for policies that remember.

To the inner side of the forearm a hand comes from in front, over the lap. The PR2's arm begins with its forearm turned
so that the elbow then leans on the person, and no short way leads to the other turn. It first swings, all joints
together, to where the oracle's detour leads: before and above the wrist, with its elbow up.
"""

import numpy as np
from numpy.typing import NDArray

from avrgym.tasks.experts.reactive import TURN_RAD_S, PresentGuide, Reactive
from avrgym.tasks.scratch_itch.expert import SWING_M_S, surface
from avrgym.tasks.scratch_itch.reactive import aim, faces_in, scratch
from avrgym.tasks.scratch_itch.reward import limb_frame
from avrgym.tasks.task import Controller, RunningEpisodes

Array = NDArray[np.float64]

OVER_RAD = {
    "l_shoulder_pan_joint": -0.85,
    "l_shoulder_lift_joint": -0.6,
    "l_upper_arm_roll_joint": -0.9,
    "l_forearm_roll_joint": 2.6,
    "l_wrist_flex_joint": 0.75,
}
"""By how much joints move to turn the PR2's arm over: the mean of the oracle's detours, which are about the same for
nearly everyone, and learned sooner where they are quite the same."""
INWARDS, NOT_DOWN = (0.3, 0.6), (-0.7, -0.5)
"""To which skin an arm that has turned over comes from in front, see ``reactive.faces_in``: more than a mounted one."""
HALF = 0.5
"""From what share of it on an arm turns over."""
TURNED = 0.85
"""What share of the way is enough."""


def patient_expert(episodes: RunningEpisodes) -> Controller:
    """One whose arm turns over, where it has these joints; others do as the reactive one."""
    turns_over = OVER_RAD.keys() <= set(episodes.scene.arm.joints)
    return TurnsOver(episodes) if turns_over else Reactive(episodes, scratch)


class TurnsOver:
    """Goes to each of N itches by the reactive rule, from in front only with arms that have turned over."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Begin where people and arms are."""
        self._episodes, self._guide = episodes, PresentGuide(episodes)
        self._first_rad = self._guide.angles_rad
        self._way_rad = np.array([OVER_RAD.get(joint, 0.0) for joint in episodes.scene.arm.joints])
        self._turned = np.zeros(len(self._first_rad), dtype=bool)

    def __call__(self, observation: Array) -> Array:
        """Actions (N, J)."""
        guide, state, task_state = self._guide, self._episodes.state(), self._episodes.task_state
        guide.relax()
        self._turned |= self._share_of_way() > TURNED
        out_w, _ = surface(task_state, limb_frame(state, task_state)[1])
        in_front = faces_in(out_w, INWARDS, NOT_DOWN)
        pos_w, q_w, speed = aim(state, task_state, guide, in_front * self._turned)
        angles_rad = guide.straight(pos_w, q_w, speed, TURN_RAD_S)
        turns = (in_front > HALF) & ~self._turned
        if turns.any():
            swing_rad = guide.swing(self._first_rad + self._way_rad, SWING_M_S, np.pi)
            angles_rad = np.where(turns[:, None], swing_rad, angles_rad)
        return guide.ask(angles_rad)

    def _share_of_way(self) -> Array:
        """How much (N,) of their way arms have gone, in their joints."""
        way_rad = self._way_rad
        return ((self._guide.angles_rad - self._first_rad) * way_rad).sum(axis=-1) / (way_rad * way_rad).sum()
