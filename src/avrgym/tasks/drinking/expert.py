"""Planning expert for drinking: brings the cup's rim to the lips, then tilts the cup about the rim."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.models.cup import DEFAULT_CUP_SHAPE, CupShape
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.head_clearance import compute_clearance_shift_m, compute_direction_into_face_w
from avrgym.tasks.experts.motion_planner import COLLISION_COST_S, MotionPlanner
from avrgym.tasks.task import RunningEpisodes

APPROACH_YAWS_DEG = (0.0, 15.0, -15.0, 30.0, -30.0)
APPROACH_ROLLS_DEG = (0.0, -22.5, -45.0)
"""Candidate rotations of the cup about its axis, for each candidate yaw relative to the face. The rotation lowers the
robot's hand.
"""
DISTANCE_COST_S_PER_M = 200.0
"""Cost of an approach in seconds, per metre of distance between rim and mouth."""

CARRY_SPEED_M_S, APPROACH_SPEED_M_S, TURN_SPEED_RAD_S = 0.35, 0.10, 0.8
STANDOFF_M, ARRIVAL_TOLERANCE_RAD, TILT_START_DISTANCE_M = 0.08, 0.03, 0.01
CLEARANCE_M = 0.003
POUR_FORWARD_OFFSET_M, POUR_UPWARD_OFFSET_M = 0.01, 0.01
"""Offsets of the pouring edge from the middle of the mouth: in front of the mouth, and above it.

Slowly poured water flows backwards along the outside of the cup. The offsets compensate this.
"""
CARRY_TILT_RAD = np.radians(45.0)
"""Tilt of the cup during the approach. The robot's fingers are then below the chin."""
POUR_START_TILT_RAD = np.radians(70.0)
"""Tilt of the cup from the vertical below which no water flows out."""
EMPTY_CUP_TILT_RAD = np.radians(92.0)
"""Tilt of the cup from the vertical at which the cup is empty."""
POUR_SPEED_RAD_S = 0.04
TILTS_RAD = np.linspace(float(CARRY_TILT_RAD), float(EMPTY_CUP_TILT_RAD), 5)
"""Tilts of the cup at which the clearance of an approach is checked."""

FORWARD, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
_AROUND = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)


@dataclass(frozen=True)
class Approach:
    """Directions of the cup's approach to the mouths of N people.

    ``yaw_rad`` (N,) is the yaw relative to the face, ``roll_rad`` (N,) the rotation about the cup's axis.
    """

    yaw_rad: FloatArray
    roll_rad: FloatArray


class DrinkingExpert:
    """Selects an approach of the cup for each person, and executes it."""

    def __init__(self, episodes: RunningEpisodes, cup: CupShape = DEFAULT_CUP_SHAPE) -> None:
        """Plan the approach of the cup to each current person."""
        self._cup = cup
        self._episodes = episodes
        self._planner = MotionPlanner(episodes)
        count = self._episodes.simulation.num_worlds
        self._tilt_rad, self._arrived = np.full(count, CARRY_TILT_RAD), np.zeros(count, dtype=bool)
        self._way, self._before = self._plan(self._episodes.get_state())

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) of the next control step."""
        state, planner = self._episodes.get_state(), self._planner
        self._arrived |= planner.compute_max_joint_distance_rad(self._before) < ARRIVAL_TOLERANCE_RAD
        swing = planner.plan_joint_space_step(self._before, CARRY_SPEED_M_S, CARRY_TILT_RAD)
        pos_w, q_w = compute_cup_pose_at_mouth(state, self._way, self._tilt_rad, self._cup)
        near = self._arrived & (norm(pos_w - planner.tool_pos_w) < TILT_START_DISTANCE_M)
        rate = np.where(self._tilt_rad < POUR_START_TILT_RAD, TURN_SPEED_RAD_S, POUR_SPEED_RAD_S)
        self._tilt_rad = np.minimum(
            self._tilt_rad + np.where(near, planner.scene.control_step_s * rate, 0.0), EMPTY_CUP_TILT_RAD
        )
        into = planner.plan_straight_line_step(pos_w, q_w, APPROACH_SPEED_M_S, TURN_SPEED_RAD_S)
        return planner.compute_action_to_joint_positions(np.where(self._arrived[:, None], into, swing))

    def _plan(self, state: State) -> tuple[Approach, FloatArray]:
        """Select approaches that are fast and bring the rim near the mouth.

        Returns the approaches, and the joint positions (N, J) at their start.
        """
        worlds = np.arange(self._episodes.simulation.num_worlds)
        ways = np.radians([(aside, roll) for aside in APPROACH_YAWS_DEG for roll in APPROACH_ROLLS_DEG])
        tried = [self._try(state, Approach(*np.tile(approach[:, None], len(worlds)))) for approach in ways]
        costs, before = (np.array(parts) for parts in zip(*tried, strict=True))
        best = costs.argmin(axis=0)
        return Approach(*ways[best].T), before[best, worlds]

    def _try(self, state: State, approach: Approach) -> tuple[FloatArray, FloatArray]:
        """Returns the cost (N,) of an approach in seconds, and the joint positions (N, J) at its start."""
        pos_w, q_w = compute_cup_pose_at_mouth(
            state, approach, np.full_like(approach.roll_rad, CARRY_TILT_RAD), self._cup
        )
        before_w = pos_w - STANDOFF_M * transforms.rotate(
            compute_approach_heading_quat_w(state, approach), FORWARD
        )
        angles, seconds = (
            part[:, 0]
            for part in self._planner.find_joint_positions(before_w[:, None], q_w[:, None], CARRY_TILT_RAD)
        )
        return seconds + self._tilting_cost_s(state, approach, angles), angles

    def _tilting_cost_s(self, state: State, approach: Approach, joint_positions: FloatArray) -> FloatArray:
        """Returns the cost (N,) of small clearances during the tilt, and of the distance between rim and mouth."""
        gap_m = np.full(len(joint_positions), np.inf)
        poses = [
            compute_cup_pose_at_mouth(state, approach, np.full_like(approach.roll_rad, tilt), self._cup)
            for tilt in TILTS_RAD.tolist()
        ]
        for pos_w, q_w in poses:
            joint_positions = self._planner.solve_inverse_kinematics(pos_w, q_w, joint_positions)
            gap = self._planner.compute_clearance_m(joint_positions[:, None], state, tool=False)[:, 0]
            gap_m = np.minimum(gap_m, gap)
        pos_w, q_w = poses[-1]
        reached_w, _ = self._planner.compute_tool_pose(joint_positions)
        distance = norm(_edge_w(pos_w, q_w, approach, self._cup) - state.mouth_pos_w) + norm(
            pos_w - reached_w
        )
        return DISTANCE_COST_S_PER_M * distance + COLLISION_COST_S * np.clip(
            1.0 - gap_m / CLEARANCE_M, 0.0, 1.0
        )


def compute_clipped_cup_tilt_rad(q_w: FloatArray) -> FloatArray:
    """Returns the tilt (N,) of cups with rotations (N, 4), at least ``CARRY_TILT_RAD``."""
    z_w = transforms.rotate(q_w, UP)[:, 2]
    return np.maximum(elementary.arccos(np.clip(z_w, -1.0, 1.0)), CARRY_TILT_RAD)


def compute_approach_heading_quat_w(state: State, approach: Approach) -> FloatArray:
    """Returns the rotation (N, 4) of an upright cup. Its x axis is the heading of the approach."""
    into = compute_direction_into_face_w(state)
    return transforms.from_axis_angle(UP, elementary.arctan2(into[:, 1], into[:, 0]) + approach.yaw_rad)


def compute_cup_pose_at_mouth(
    state: State, approach: Approach, tilt_rad: FloatArray, cup: CupShape = DEFAULT_CUP_SHAPE
) -> tuple[FloatArray, FloatArray]:
    """Returns the cup pose, (N, 3) and (N, 4), at a tilt.

    The pouring edge is at the lips. If this pose would cause contact, the cup is farther away.
    """
    yaw = compute_approach_heading_quat_w(state, approach)
    tilt = transforms.from_axis_angle([0.0, 1.0, 0.0], tilt_rad)
    roll = transforms.from_axis_angle(UP, approach.roll_rad)
    q_w = transforms.multiply(transforms.multiply(yaw, tilt), roll)
    back = -transforms.rotate(yaw, FORWARD)
    lips_w = state.mouth_pos_w + POUR_FORWARD_OFFSET_M * back + POUR_UPWARD_OFFSET_M * UP
    pos_w = lips_w - _edge_w(np.zeros(3), q_w, approach, cup)
    rim_w = pos_w[:, None] + transforms.rotate(q_w[:, None], _rim(cup))
    return pos_w + compute_clearance_shift_m(rim_w, back, state, CLEARANCE_M)[:, None] * back, q_w


@cache
def _rim(cup: CupShape) -> FloatArray:
    """Returns points (P, 3) of the rim in the tool's frame."""
    return np.stack(
        [
            cup.axis_x_m + cup.rim_radius_m * elementary.cos(_AROUND),
            cup.rim_radius_m * elementary.sin(_AROUND),
            0.0 * _AROUND,
        ],
        axis=-1,
    )


def _edge_w(
    pos_w: FloatArray, q_w: FloatArray, approach: Approach, cup: CupShape = DEFAULT_CUP_SHAPE
) -> FloatArray:
    """Returns the point (N, 3) of the rim over which the cup pours."""
    edge = [
        cup.rim_radius_m * elementary.cos(approach.roll_rad) + cup.axis_x_m,
        -cup.rim_radius_m * elementary.sin(approach.roll_rad),
    ]
    return pos_w + transforms.rotate(q_w, np.stack([*edge, np.zeros_like(approach.roll_rad)], axis=-1))
