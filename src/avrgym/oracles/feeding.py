"""Feeding by script: keep the spoon level, turn it towards the face, bring it into the mouth."""

import numpy as np
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.episodes import Episodes
from avrgym.oracles.guide import Guide

Array = NDArray[np.float64]

SPEED_M_S, TURN_RAD_S = 0.20, 0.8
AWAY_M = 0.15


class FeedingOracle:
    """First to a point before the mouth, then straight in; the spoon's yaw is that of the head."""

    def __init__(self, episodes: Episodes) -> None:
        self._episodes = episodes
        self._guide = Guide(episodes)
        self._near = np.zeros(episodes.simulation.num_worlds, dtype=bool)

    def __call__(self, observation: Array) -> Array:
        state = self._episodes.simulation.state()
        forward = transforms.rotate(state.head_q_w, [0.0, 1.0, 0.0])
        yaw = np.arctan2(forward[:, 1], forward[:, 0])
        q_w = transforms.from_axis_angle([0.0, 0.0, 1.0], yaw)
        into = transforms.rotate(q_w, [1.0, 0.0, 0.0])
        before = state.mouth_pos_w - AWAY_M * into
        self._near |= np.sqrt(((self._guide.pos_w - before) ** 2).sum(axis=-1)) < 0.02
        target = np.where(self._near[:, None], state.mouth_pos_w, before)
        return self._guide.toward(target, q_w, np.full(len(q_w), SPEED_M_S), TURN_RAD_S)
