"""Drinking by script: carry the cup before the mouth, its rim to the lips, then tilt it about the rim."""

import numpy as np
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.episodes import Episodes
from avrgym.models.cup import AXIS_X_M, RIM_RADIUS_M
from avrgym.models.human import GEOMS
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.oracles.guide import Guide
from avrgym.simulation import State
from avrgym.tasks.base import norm

Array = NDArray[np.float64]

ASIDE_DEG = (0.0, 15.0, -15.0, 30.0, -30.0)
"""How the cup may come: its heading from that of the face."""
SECONDS_PER_M = 200.0
"""What it is worth in time to have the rim nearer to the mouth."""
RISE_SHARE = 0.4
"""How much higher the rim is per distance that the face keeps it from the mouth: the water falls that far."""

CARRY_M_S, ENTER_M_S, TURN_RAD_S, UPRIGHT_RAD = 0.35, 0.10, 0.8, np.radians(20.0)
AWAY_M, ARRIVED_RAD, NEAR_M = 0.08, 0.03, 0.01
CLEARANCE_M = 0.003
LIP_BACK_M, LIP_UP_M = 0.01, 0.01
FULL_RAD, EMPTY_RAD = np.radians([76.0, 100.0])
"""Up to the first tilt no water pours; at the second none is left."""
POUR_RAD_S = 0.05
_PATH = 8

HEAD = [list(GEOMS).index(name) for name in ("jaw", "cranium")]
UP = np.array([0.0, 0.0, 1.0])
_AROUND = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
RIM = np.stack(
    [AXIS_X_M + RIM_RADIUS_M * np.cos(_AROUND), RIM_RADIUS_M * np.sin(_AROUND), 0.0 * _AROUND], axis=-1
)
"""Points (P, 3) of the rim in the tool's frame."""


class DrinkingOracle:
    """Chooses for each person from where the cup comes, then follows that way."""

    def __init__(self, episodes: Episodes) -> None:
        """Plan for the people who are there now."""
        self._simulation = episodes.simulation
        self._guide = Guide(episodes)
        count = self._simulation.num_worlds
        self._tilt_rad, self._arrived = np.zeros(count), np.zeros(count, dtype=bool)
        self._plan(self._simulation.state())

    def __call__(self, observation: Array) -> Array:
        """Actions (N, 7)."""
        state, guide = self._simulation.state(), self._guide
        self._arrived |= np.abs(guide.angles_rad - self._before_rad).max(axis=-1) < ARRIVED_RAD
        swing = guide.swing(self._before_rad, CARRY_M_S, UPRIGHT_RAD)
        pos_w, q_w = _at_mouth(state, self._aside_rad, self._tilt_rad)
        near = self._arrived & (norm(pos_w - guide.pos_w) < NEAR_M)
        rate = np.where(self._tilt_rad < FULL_RAD, TURN_RAD_S, POUR_RAD_S)
        self._tilt_rad = np.minimum(self._tilt_rad + np.where(near, CONTROL_STEP_S * rate, 0.0), EMPTY_RAD)
        into = guide.straight(pos_w, q_w, ENTER_M_S, TURN_RAD_S)
        return guide.ask(np.where(self._arrived[:, None], into, swing))

    def _plan(self, state: State) -> None:
        """Of all ways on which the arm can tilt the cup, take the one that is quick and brings the rim near."""
        costs, starts = [], []
        for aside in np.radians(ASIDE_DEG):
            cost, before_rad = self._try(state, np.full(len(self._tilt_rad), aside))
            costs.append(cost)
            starts.append(before_rad)
        best = np.argmin(costs, axis=0)
        self._aside_rad = np.radians(ASIDE_DEG)[best]
        self._before_rad = np.array(starts)[best, np.arange(len(best))]
        self.cost = np.min(costs, axis=0)

    def _try(self, state: State, aside_rad: Array) -> tuple[Array, Array]:
        """What it costs to come from there, (N,), and the angles (N, 7) before the mouth."""
        pos_w, q_w = _at_mouth(state, aside_rad, 0.0 * aside_rad)
        back = transforms.rotate(q_w, [-AWAY_M, 0.0, 0.0])
        angles, seconds = (part[:, 0] for part in self._guide.find((pos_w + back)[:, None], q_w[:, None]))
        before_rad = angles
        for tilt in np.linspace(0.0, EMPTY_RAD, _PATH):
            pos_w, q_w = _at_mouth(state, aside_rad, np.full_like(aside_rad, tilt))
            angles = self._guide.angles_at(pos_w, q_w, angles)
        missed, _ = self._guide._pose(angles)
        distance = norm(pos_w - state.mouth_pos_w) + norm(pos_w - missed)
        return seconds + SECONDS_PER_M * distance, before_rad


def _at_mouth(state: State, aside_rad: Array, tilt_rad: Array) -> tuple[Array, Array]:
    """The cup's pose, (N, 3) and (N, 4), at a tilt, its rim as near to the mouth as the head lets it."""
    face = transforms.rotate(state.head_q_w, [0.0, 1.0, 0.0])
    yaw = transforms.from_axis_angle(UP, np.arctan2(face[:, 1], face[:, 0]) + aside_rad)
    q_w = transforms.multiply(yaw, transforms.from_axis_angle([0.0, 1.0, 0.0], tilt_rad))
    back = transforms.rotate(yaw, [-1.0, 0.0, 0.0])
    pos_w = state.mouth_pos_w + LIP_BACK_M * back + LIP_UP_M * UP
    rim_w = pos_w[:, None] + transforms.rotate(q_w[:, None], RIM)
    out = _way_out(rim_w, back, state)[:, None]
    return pos_w + out * (back + RISE_SHARE * UP), q_w


def _way_out(points_w: Array, out: Array, state: State) -> Array:
    """How far (N,) points (N, P, 3) must move along ``out`` to be clear of the head."""
    radius = state.person_radius_m[:, HEAD] + CLEARANCE_M
    offset = points_w[:, None] - state.person_segment_w[:, HEAD, :1]
    along = (offset * out[:, None, None]).sum(axis=-1)
    reach = along**2 - (offset * offset).sum(axis=-1) + radius[..., None] ** 2
    way = np.where(reach > 0.0, np.sqrt(np.maximum(reach, 0.0)) - along, 0.0)
    return np.maximum(way.max(axis=(1, 2)), 0.0)
