"""Planning expert for drinking: carry the cup to the mouth, its rim to the lips, then tilt it about the rim."""

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
"""Candidate approaches: yaw relative to the face, and turn about the cup's axis (which lowers the hand)."""
SECONDS_PER_M = 200.0
"""Cost of the distance between rim and mouth."""

CARRY_M_S, ENTER_M_S, TURN_RAD_S = 0.35, 0.10, 0.8
AWAY_M, ARRIVED_RAD, NEAR_M = 0.08, 0.03, 0.01
CLEARANCE_M = 0.003
LIPS_BACK_M, LIPS_UP_M = 0.01, 0.01
"""Pouring edge relative to the middle of the mouth, in front and above: slow water falls back by as much."""
TIPPED_RAD, FULL_RAD, EMPTY_RAD = np.radians([45.0, 70.0, 92.0])
"""Tilts: at ``TIPPED_RAD`` the cup approaches, with the fingers below the chin; up to ``FULL_RAD`` no water pours; at
``EMPTY_RAD`` none is left."""
POUR_RAD_S = 0.04
TILTS_RAD = np.linspace(float(TIPPED_RAD), float(EMPTY_RAD), 5)
"""Tilts at which an approach is checked."""

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
    """Approach of the cup for N people: yaw relative to the face (N,) and turn about its axis (N,)."""

    aside_rad: FloatArray
    roll_rad: FloatArray


class DrinkingExpert:
    """Chooses an approach for each person and follows it."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Plan for the present people."""
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
        """Choose an approach that is fast and brings the rim near to the mouth. Also returns its first joint angles (N,
        J)."""
        worlds = np.arange(self._episodes.simulation.num_worlds)
        ways = np.radians([(aside, roll) for aside in ASIDE_DEG for roll in ROLL_DEG])
        tried = [self._try(state, Way(*np.tile(way[:, None], len(worlds)))) for way in ways]
        costs, before_rad = (np.array(parts) for parts in zip(*tried, strict=True))
        best = costs.argmin(axis=0)
        return Way(*ways[best].T), before_rad[best, worlds]

    def _try(self, state: State, way: Way) -> tuple[FloatArray, FloatArray]:
        """Cost (N,) and first joint angles (N, J) of an approach."""
        pos_w, q_w = at_mouth(state, way, np.full_like(way.roll_rad, TIPPED_RAD))
        before_w = pos_w - AWAY_M * transforms.rotate(yaw_q_w(state, way), FORWARD)
        angles, seconds = (
            part[:, 0] for part in self._planner.find_angles(before_w[:, None], q_w[:, None], TIPPED_RAD)
        )
        return seconds + self._tilting_cost_s(state, way, angles), angles

    def _tilting_cost_s(self, state: State, way: Way, angles_rad: FloatArray) -> FloatArray:
        """Cost (N,) of the distance between rim and mouth and of small clearances while tilting."""
        gap_m = np.full(len(angles_rad), np.inf)
        poses = [at_mouth(state, way, np.full_like(way.roll_rad, tilt)) for tilt in TILTS_RAD.tolist()]
        for pos_w, q_w in poses:
            angles_rad = self._planner.angles_at(pos_w, q_w, angles_rad)
            gap = self._clearance.min_distance_m(angles_rad[:, None], state, tool=False)[:, 0]
            gap_m = np.minimum(gap_m, gap)
        pos_w, q_w = poses[-1]
        reached_w, _ = self._planner.pose(angles_rad)
        distance = norm(_edge_w(pos_w, q_w, way) - state.mouth_pos_w) + norm(pos_w - reached_w)
        return SECONDS_PER_M * distance + COLLISION_COST_S * np.clip(1.0 - gap_m / CLEARANCE_M, 0.0, 1.0)


def carried_tilt_rad(q_w: FloatArray) -> FloatArray:
    """Tilt (N,) of cups with rotations (N, 4), at least ``TIPPED_RAD``."""
    z_w = transforms.rotate(q_w, UP)[:, 2]
    return np.maximum(elementary.arccos(np.clip(z_w, -1.0, 1.0)), TIPPED_RAD)


def yaw_q_w(state: State, way: Way) -> FloatArray:
    """Rotation (N, 4) of an upright cup whose x axis is the heading of the approach."""
    into = face_direction(state)
    return transforms.from_axis_angle(UP, elementary.arctan2(into[:, 1], into[:, 0]) + way.aside_rad)


def at_mouth(state: State, way: Way, tilt_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cup pose, (N, 3) and (N, 4), at a tilt, with its pouring edge as near to the lips as the head allows."""
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
    """Point (N, 3) of the rim over which the cup pours."""
    edge = [
        RIM_RADIUS_M * elementary.cos(way.roll_rad) + AXIS_X_M,
        -RIM_RADIUS_M * elementary.sin(way.roll_rad),
    ]
    return pos_w + transforms.rotate(q_w, np.stack([*edge, np.zeros_like(way.roll_rad)], axis=-1))
