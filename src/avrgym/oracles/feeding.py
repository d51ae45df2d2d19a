"""Feeding by script: carry the spoon level to the lips, then into the mouth piece by piece."""

import numpy as np
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.episodes import Episodes
from avrgym.models.human import GEOMS
from avrgym.models.spoon import FOOD, OUTLINE
from avrgym.oracles.guide import Guide
from avrgym.simulation import State
from avrgym.tasks.base import norm
from avrgym.tasks.feeding import MOUTH_RADIUS_M

Array = NDArray[np.float64]

WAYS_DEG = ((0.0, 0.0), (-80.0, -15.0), (-90.0, -15.0), (-100.0, -15.0))
"""How the spoon may come to the face: tip first, or with its long side, tipped towards the lips; turns about
the vertical and about the spoon's own axis, from where its tip points as the person looks."""
SECONDS_PER_PIECE = 2.0
"""What a piece out of reach is worth in time."""

CARRY_M_S, ENTER_M_S, TURN_RAD_S = 0.35, 0.08, 0.8
TILT_RAD = np.radians(50.0)
AWAY_M, CLEARANCE_M = 0.06, 0.002
ARRIVED_RAD = 0.03
HEAD_GEOMS = [list(GEOMS).index(name) for name in ("jaw", "cranium")]


class FeedingOracle:
    """Chooses for each person how the spoon comes; then brings what is left on it to the mouth.

    Tip first a spoon reaches 3.5 cm beyond its middle, with its long side 2.4 cm: the second way also feeds those
    whose open mouth is less deep.
    """

    def __init__(self, episodes: Episodes) -> None:
        """Plan for the people who are there now."""
        self._episodes = episodes
        self._guide = Guide(episodes)
        self._arrived = np.zeros(episodes.simulation.num_worlds, dtype=bool)
        self._plan(episodes.simulation.state())

    def __call__(self, observation: Array) -> Array:
        state = self._episodes.simulation.state()
        guide = self._guide
        swing = guide.swing(self._before_rad, CARRY_M_S, TILT_RAD)
        self._arrived |= np.abs(guide.angles_rad - self._before_rad).max(axis=-1) < ARRIVED_RAD
        target = self._at_mouth(state, self._q_w, self._food(state))
        into = guide.straight(target, self._q_w, ENTER_M_S, TURN_RAD_S)
        return guide.ask(np.where(self._arrived[:, None], into, swing))

    def _plan(self, state: State) -> None:
        ways = _ways(state)
        spread = State(**{name: _spread(value, ways.shape[1]) for name, value in vars(state).items()})
        flat = ways.reshape(-1, 4)
        pos_w = self._at_mouth(spread, flat, FOOD.start.mean(axis=0))
        food_w = pos_w[:, None] + transforms.rotate(flat[:, None], FOOD.start)
        missed = (norm(food_w - spread.mouth_pos_w[:, None]) > MOUTH_RADIUS_M).sum(axis=-1)
        angles, seconds = self._guide.find(pos_w.reshape(*ways.shape[:2], 3), ways)
        best = (seconds + SECONDS_PER_PIECE * missed.reshape(seconds.shape)).argmin(axis=-1)
        world = np.arange(len(best))
        self.best, self.sec, self.missed = (
            best,
            seconds[world, best],
            missed.reshape(seconds.shape)[world, best],
        )
        self._q_w = ways[world, best]
        self._guide.posture_rad = angles[world, best]
        before = pos_w.reshape(*ways.shape[:2], 3)[world, best] + AWAY_M * _face(state)
        self._before_rad = self._guide.angles_at(before, self._q_w, self._guide.posture_rad)

    def _food(self, state: State) -> Array:
        """The middle (N, 3) of the food that is still on the spoon, in the spoon's frame."""
        off = state.particle_pos_w - state.tool_pos_w[:, None]
        on = (norm(off) < 0.05)[..., None]
        middle = (off * on).sum(axis=1) / np.maximum(on.sum(axis=1), 1)
        return transforms.rotate(transforms.conjugate(state.tool_q_w), middle)

    def _at_mouth(self, state: State, q_w: Array, food: Array) -> Array:
        """Where the spoon (N, 3) has the food in the mouth, or as near as the head lets it."""
        pos_w = state.mouth_pos_w - transforms.rotate(q_w, food)
        outline_w = pos_w[:, None] + transforms.rotate(q_w[:, None], OUTLINE)
        out = _face(state)
        return pos_w + _way_out(outline_w, out, state)[:, None] * out


def _spread(value: Array, count: int) -> Array:
    return np.repeat(value, count, axis=0) if isinstance(value, np.ndarray) else value


def _face(state: State) -> Array:
    """Where the person looks, (N, 3)."""
    return transforms.rotate(state.head_q_w, [0.0, -1.0, 0.0])


def _ways(state: State) -> Array:
    face = _face(state)
    yaw = np.arctan2(-face[:, 1], -face[:, 0])
    about, tip = np.radians(WAYS_DEG).T
    return transforms.multiply(
        transforms.from_axis_angle([0.0, 0.0, 1.0], yaw[:, None] + about),
        transforms.from_axis_angle([1.0, 0.0, 0.0], tip),
    )


def _way_out(points_w: Array, out: Array, state: State) -> Array:
    """How far (N,) points (N, P, 3) must move along ``out`` to be clear of the head's spheres."""
    centre = state.person_segment_w[:, HEAD_GEOMS, 0][:, :, None]
    radius = state.person_radius_m[:, HEAD_GEOMS][:, :, None] + CLEARANCE_M
    offset = points_w[:, None] - centre
    along = (offset * out[:, None, None]).sum(axis=-1)
    inside = along**2 - (offset * offset).sum(axis=-1) + radius**2
    way = np.where(inside > 0.0, np.sqrt(np.maximum(inside, 0.0)) - along, 0.0)
    return np.maximum(way.max(axis=(1, 2)), 0.0)
