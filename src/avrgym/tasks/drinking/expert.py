"""Drinking by script: carry the cup before the mouth, its rim to the lips, then tilt it about the rim."""

from dataclasses import dataclass

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.models.cup import AXIS_X_M, RIM_RADIUS_M
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.head_clearance import clearance_way_m, face_direction
from avrgym.tasks.experts.motion_planner import COLLISION_COST_S, MotionPlanner
from avrgym.tasks.experts.robot_clearance import Clearance
from avrgym.tasks.task import RunningEpisodes

ASIDE_DEG = (0.0, 15.0, -15.0, 30.0, -30.0)
ROLL_DEG = (0.0, -22.5, -45.0)
"""How the cup may come: its heading from that of the face, and turned about its axis, the hand lower when tilted."""
SECONDS_PER_M = 200.0
"""What it is worth in time to have the rim nearer to the mouth."""

CARRY_M_S, ENTER_M_S, TURN_RAD_S = 0.35, 0.10, 0.8
AWAY_M, ARRIVED_RAD, NEAR_M = 0.08, 0.03, 0.01
CLEARANCE_M = 0.003
LIPS_BACK_M, LIPS_UP_M = 0.01, 0.01
"""Where the edge goes, before and above the mouth's middle: slow water falls back by as much."""
TIPPED_RAD, FULL_RAD, EMPTY_RAD = np.radians([45.0, 70.0, 92.0])
"""At the first tilt the cup comes to the mouth: then the fingers before it pass below the chin. Up to the second
no water pours; at the third none is left."""
POUR_RAD_S = 0.04
TILTS_RAD = np.linspace(float(TIPPED_RAD), float(EMPTY_RAD), 5)
"""Where a way is looked at before it is taken."""

FORWARD, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
_AROUND = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
RIM = np.stack(
    [
        AXIS_X_M + RIM_RADIUS_M * elementary.cos(_AROUND),
        RIM_RADIUS_M * elementary.sin(_AROUND),
        0.0 * _AROUND,
    ],
    axis=-1,
)
"""Points (P, 3) of the rim in the tool's frame."""


@dataclass(frozen=True)
class Way:
    """How a cup comes to each of N people, (N,): its heading from that of the face, its turn about its axis."""

    aside_rad: FloatArray
    roll_rad: FloatArray


class DrinkingExpert:
    """Chooses a way for each person, then follows it."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Plan for the people who are there now."""
        self._episodes = episodes
        self._planner, self._clearance = MotionPlanner(episodes), Clearance(episodes.simulation)
        count = self._episodes.simulation.num_worlds
        self._tilt_rad, self._arrived = np.full(count, TIPPED_RAD), np.zeros(count, dtype=bool)
        self._way, self._before_rad = self._plan(self._episodes.state())

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Actions (N, J)."""
        state, planner = self._episodes.state(), self._planner
        self._arrived |= np.abs(planner.angles_rad - self._before_rad).max(axis=-1) < ARRIVED_RAD
        swing = planner.joint_step(self._before_rad, CARRY_M_S, TIPPED_RAD)
        pos_w, q_w = at_mouth(state, self._way, self._tilt_rad)
        near = self._arrived & (norm(pos_w - planner.pos_w) < NEAR_M)
        rate = np.where(self._tilt_rad < FULL_RAD, TURN_RAD_S, POUR_RAD_S)
        self._tilt_rad = np.minimum(self._tilt_rad + np.where(near, CONTROL_STEP_S * rate, 0.0), EMPTY_RAD)
        into = planner.line_step(pos_w, q_w, ENTER_M_S, TURN_RAD_S)
        return planner.action_to(np.where(self._arrived[:, None], into, swing))

    def _plan(self, state: State) -> tuple[Way, FloatArray]:
        """Of all ways on which the arm can tilt the cup, one that is quick and brings the rim near to the mouth.

        Also the arm's angles (N, J) where it begins.
        """
        worlds = np.arange(self._episodes.simulation.num_worlds)
        ways = np.radians([(aside, roll) for aside in ASIDE_DEG for roll in ROLL_DEG])
        tried = [self._try(state, Way(*np.tile(way[:, None], len(worlds)))) for way in ways]
        costs, before_rad = (np.array(parts) for parts in zip(*tried, strict=True))
        best = costs.argmin(axis=0)
        return Way(*ways[best].T), before_rad[best, worlds]

    def _try(self, state: State, way: Way) -> tuple[FloatArray, FloatArray]:
        """What a way costs, (N,), and the arm's angles (N, J) where it begins."""
        pos_w, q_w = at_mouth(state, way, np.full_like(way.roll_rad, TIPPED_RAD))
        before_w = pos_w - AWAY_M * transforms.rotate(yaw_q_w(state, way), FORWARD)
        angles, seconds = (
            part[:, 0] for part in self._planner.find_angles(before_w[:, None], q_w[:, None], TIPPED_RAD)
        )
        return seconds + self._tilting_cost_s(state, way, angles), angles

    def _tilting_cost_s(self, state: State, way: Way, angles_rad: FloatArray) -> FloatArray:
        """What it costs, (N,), that the rim stays away from the mouth and the arm comes close to something."""
        gap_m = np.full(len(angles_rad), np.inf)
        poses = [at_mouth(state, way, np.full_like(way.roll_rad, tilt)) for tilt in TILTS_RAD.tolist()]
        for pos_w, q_w in poses:
            angles_rad = self._planner.angles_at(pos_w, q_w, angles_rad)
            gap = self._clearance.least_m(angles_rad[:, None], state, tool=False)[:, 0]
            gap_m = np.minimum(gap_m, gap)
        pos_w, q_w = poses[-1]
        reached_w, _ = self._planner.pose(angles_rad)
        distance = norm(_edge_w(pos_w, q_w, way) - state.mouth_pos_w) + norm(pos_w - reached_w)
        return SECONDS_PER_M * distance + COLLISION_COST_S * np.clip(1.0 - gap_m / CLEARANCE_M, 0.0, 1.0)


def carried_tilt_rad(q_w: FloatArray) -> FloatArray:
    """How far (N,) cups with rotations (N, 4) are tilted, or ``TIPPED_RAD`` where that is more."""
    z_w = transforms.rotate(q_w, UP)[:, 2]
    return np.maximum(elementary.arccos(np.clip(z_w, -1.0, 1.0)), TIPPED_RAD)


def yaw_q_w(state: State, way: Way) -> FloatArray:
    """The rotation (N, 4) of an upright cup whose x axis is the way's heading."""
    into = face_direction(state)
    return transforms.from_axis_angle(UP, elementary.arctan2(into[:, 1], into[:, 0]) + way.aside_rad)


def at_mouth(state: State, way: Way, tilt_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The cup's pose, (N, 3) and (N, 4), at a tilt, its lowest edge as near to the lips as the head lets it."""
    yaw = yaw_q_w(state, way)
    tilt = transforms.from_axis_angle([0.0, 1.0, 0.0], tilt_rad)
    roll = transforms.from_axis_angle(UP, way.roll_rad)
    q_w = transforms.multiply(transforms.multiply(yaw, tilt), roll)
    back = -transforms.rotate(yaw, FORWARD)
    lips_w = state.mouth_pos_w + LIPS_BACK_M * back + LIPS_UP_M * UP
    pos_w = lips_w - _edge_w(np.zeros(3), q_w, way)
    rim_w = pos_w[:, None] + transforms.rotate(q_w[:, None], RIM)
    return pos_w + clearance_way_m(rim_w, back, state, CLEARANCE_M)[:, None] * back, q_w


def _edge_w(pos_w: FloatArray, q_w: FloatArray, way: Way) -> FloatArray:
    """The point (N, 3) of the rim over which a cup with this pose pours."""
    edge = [
        RIM_RADIUS_M * elementary.cos(way.roll_rad) + AXIS_X_M,
        -RIM_RADIUS_M * elementary.sin(way.roll_rad),
    ]
    return pos_w + transforms.rotate(q_w, np.stack([*edge, np.zeros_like(way.roll_rad)], axis=-1))
