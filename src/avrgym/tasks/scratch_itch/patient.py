"""Scratching patiently: an expert who remembers whether the arm has turned over, for policies that remember.

To the inner side of the forearm a hand comes from in front, over the lap. An arm that stands on the floor begins with
its forearm turned so that the elbow then leans on the person, and no short way leads to the other turn. It first
swings, all joints together, to the place before and above the wrist where the oracle's detour leads, with its elbow up.
So it does wherever it itches but underneath. Elsewhere either way would do, and where one must be chosen a policy that
is not sure does something in between.
"""

import numpy as np
from numpy.typing import NDArray

from avrgym.tasks.experts.reactive import TURN_RAD_S, PresentGuide, Reactive
from avrgym.tasks.scratch_itch.expert import HARD_S, SWING_M_S, find_detour, surface
from avrgym.tasks.scratch_itch.reactive import aim, faces_in, scratch
from avrgym.tasks.scratch_itch.reward import limb_frame
from avrgym.tasks.task import Controller, RunningEpisodes

Array = NDArray[np.float64]

DOWN = -0.65
"""Skin faces down whose normal is no higher: an arm comes to it from below, as it is."""
INWARDS, NOT_DOWN = (0.3, 0.6), (-0.9, -0.6)
"""To which skin an arm that has turned over comes from in front, see ``reactive.faces_in``: to more of it."""
TURNED = 0.85
"""What share of the way to the detour is enough."""


def patient_expert(episodes: RunningEpisodes) -> Controller:
    """One whose arm turns over, where it stands on the floor; a mounted arm need not, and does as the reactive one."""
    return TurnsOver(episodes) if episodes.scene.mount.on_floor else Reactive(episodes, scratch)


class TurnsOver:
    """Turns the arm over, unless it itches underneath, and then goes to each of N itches by the reactive rule."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Begin where people and arms are."""
        self._episodes, self._guide = episodes, PresentGuide(episodes)
        self._first_rad = self._guide.angles_rad
        self._detour_rad, cost_s = find_detour(self._guide, episodes.state())
        self._detour_rad[:, -1] = self._first_rad[:, -1]
        self._can_turn = cost_s < HARD_S
        self._turned = np.zeros(len(cost_s), dtype=bool)

    def __call__(self, observation: Array) -> Array:
        """Actions (N, J)."""
        guide, state, task_state = self._guide, self._episodes.state(), self._episodes.task_state
        guide.relax()
        self._turned |= self._share_of_detour() > TURNED
        out_w, _ = surface(task_state, limb_frame(state, task_state)[1])
        in_front = faces_in(out_w, INWARDS, NOT_DOWN) * self._turned
        pos_w, q_w, speed = aim(state, task_state, guide, in_front)
        angles_rad = guide.straight(pos_w, q_w, speed, TURN_RAD_S)
        turns = (out_w[:, 2] > DOWN) & self._can_turn & ~self._turned
        if turns.any():
            swing_rad = guide.swing(self._detour_rad, SWING_M_S, np.pi)
            angles_rad = np.where(turns[:, None], swing_rad, angles_rad)
        return guide.ask(angles_rad)

    def _share_of_detour(self) -> Array:
        """How much (N,) of their way to the detour the arms have gone, in their joints."""
        way = self._detour_rad - self._first_rad
        return ((self._guide.angles_rad - self._first_rad) * way).sum(axis=-1) / (way * way).sum(axis=-1)
