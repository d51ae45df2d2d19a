"""Memory-based expert for drinking. Recurrent policies imitate it.

- Near the lips the cup moves slowly, because the person's face follows the cup. If the person leans forward, the cup
  moves away faster.
- The cup pours only into a mouth at rest, and stops if the mouth moves. With less water in the cup, pouring begins at a
  larger tilt. Up to this tilt the cup tilts quickly. Short times at rest are therefore enough for pouring.
- While the person looks away, the cup waits at the expected return position of the face. The cup does not wait if the
  face has had this direction since the start.
- The cup stays on its side of the head. The cup rotates about its axis, and pours over the part of the rim at the lips.
- The cup always approaches slightly rotated. The hand is then lower, where the arm reaches farther.
"""

from dataclasses import replace

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.models.cup import DEFAULT_CUP_SHAPE, CupShape
from avrgym.models.human import GEOMS
from avrgym.simulation.worlds import State
from avrgym.tasks.drinking import expert
from avrgym.tasks.drinking.expert import Approach
from avrgym.tasks.drinking.reward import is_in_cup
from avrgym.tasks.experts.feedback import (
    MAX_SPEED_M_S,
    SPEED_GAIN_PER_S,
    TURN_SPEED_RAD_S,
    FeedbackPlanner,
    compute_funnel_standoff_m,
)
from avrgym.tasks.experts.head_clearance import compute_direction_into_face_w
from avrgym.tasks.particles import count_events
from avrgym.tasks.task import RunningEpisodes

MIN_SPEED_M_S = 0.02
"""Minimum speed of a cup that approaches the person's lips."""
MIN_RETREAT_SPEED_M_S = 0.10
"""Minimum speed of a cup that moves away from the lips."""
POUR_START_DISTANCE_M = 0.03
"""Distance between cup and lips below which pouring starts."""
POUR_STOP_DISTANCE_M = 0.05
"""Distance between cup and lips above which pouring stops."""
MAX_RESTING_MOUTH_SPEED_M_S = 0.05
"""Maximum speed of a mouth that is treated as at rest."""
POUR_TILT_RAD = np.radians(89.5)
"""Tilt at which the last water reaches the rim, in simulation at a tilt rate of 0.1 rad/s."""
TILT_PER_PARTICLE_RAD = np.radians(0.145)
"""Reduction of the pouring tilt for each particle in the cup. The error is below one degree at any filling."""
SPILL_MARGIN_RAD = float(np.radians(4.0))
"""Margin below the pouring tilt at which a moving cup spills nothing."""
TILT_GAIN_PER_S = 3.0
"""Tilt rate per radian of distance from the pouring tilt, 1/s."""
POUR_SPEED_RAD_S = 0.03
"""Angular speed of the cup's tilt while it pours."""
LOOK_AWAY_ANGLE_RAD = np.radians(25.0)
"""Yaw of the face relative to the direction to the cup above which the person looks away."""
FAR_LOOK_AWAY_ANGLE_RAD = np.radians(33.0)
"""Yaw of the face relative to the direction to the cup at which the person looks far away."""
EXPECTED_RETURN_ANGLE_RAD = np.radians(8.0)
"""Expected yaw of the face when the person returns after looking far away.

If the largest angle was smaller, the expected angle is larger. Both are equal at ``LOOK_AWAY_ANGLE_RAD``.
"""
MIN_HEAD_TURN_RAD = float(np.radians(8.0))
"""Rotation of the face since the start below which the person does not look away."""
MAX_GOAL_OVERSHOOT_M = 0.001
"""Maximum distance of the cup past its goal. If it is exceeded, the cup moves away at ``MIN_RETREAT_SPEED_M_S`` or
faster.
"""
WAITING_STANDOFF_M = 0.01
"""Additional distance of a waiting cup from the lips."""
DEFAULT_LATERAL_OFFSET_M = 0.025
"""Default lateral offset of the cup's reference point from its pouring point.

A rotation about the cup's axis causes the offset. The rotation helps arms on the person's right to reach the mouth.
"""
MAX_LATERAL_OFFSET_M = 0.042
"""Maximum lateral offset of the cup's reference point from its pouring point."""
MIN_MIDPLANE_DISTANCE_M = 0.01
"""Minimum distance of the cup from the mid-plane of the head."""
MAX_LIP_OFFSET_M = 0.04
"""Maximum lateral offset of the cup from the lips."""
ROTATION_COMPENSATION_FRACTION = 0.7
"""Share of the lateral offset that a rotation of the cup compensates."""
FACING_CUP_YAW_RAD = float(np.radians(8.0))
"""Yaw, to the left, of a face that looks at the cup."""

_RIGHT, _LEFT = (list(GEOMS).index(f"{side}_shoulder") for side in ("right", "left"))


class DrinkingMemoryExpert:
    """Brings cups to N mouths. A cup waits while the person looks away, and pours while the mouth is at rest."""

    def __init__(self, episodes: RunningEpisodes, cup: CupShape = DEFAULT_CUP_SHAPE) -> None:
        """Start with the current poses of the cups and the people."""
        self._cup = cup
        self._episodes, self._planner = episodes, FeedbackPlanner(episodes)
        state = episodes.get_state()
        self._mouth_w, self._first_turn_rad = state.mouth_pos_w, _turn_rad(state)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) of the next control step."""
        planner, state = self._planner, self._episodes.get_state()
        planner.reset_preferred_posture()
        rests = (
            norm(state.mouth_pos_w - self._mouth_w)
            < MAX_RESTING_MOUTH_SPEED_M_S * self._planner.scene.control_step_s
        )
        self._mouth_w = state.mouth_pos_w
        turn_rad = _turn_rad(state)
        away = (np.abs(turn_rad) > LOOK_AWAY_ANGLE_RAD) & (
            np.abs(turn_rad - self._first_turn_rad) >= MIN_HEAD_TURN_RAD
        )
        awaited = _turned(state, np.where(away, _expected_rad(turn_rad) - turn_rad, 0.0))
        return self._bring(awaited, rests, away)

    def _bring(self, state: State, rests: BoolArray, away: BoolArray) -> FloatArray:
        planner, cup = self._planner, self._cup
        way = _way(np.full(len(rests), DEFAULT_LATERAL_OFFSET_M), cup)
        tilt = expert.compute_clipped_cup_tilt_rad(planner.tool_quat_w)
        at_lips_w, _ = expert.compute_cup_pose_at_mouth(state, way, tilt, cup)
        left = _to_the_left(state)
        aside_m = _aside_m(state, left, planner.tool_pos_w, at_lips_w)
        turned_m = np.clip(
            DEFAULT_LATERAL_OFFSET_M + ROTATION_COMPENSATION_FRACTION * aside_m,
            -MAX_LATERAL_OFFSET_M,
            MAX_LATERAL_OFFSET_M,
        )
        way = _way(turned_m, cup)
        at_lips_w, _ = expert.compute_cup_pose_at_mouth(state, way, tilt, cup)
        aside = (DEFAULT_LATERAL_OFFSET_M + aside_m - turned_m)[:, None] * left
        offset = at_lips_w + aside - planner.tool_pos_w
        pours_rad = POUR_TILT_RAD - TILT_PER_PARTICLE_RAD * count_events(is_in_cup(state, cup))
        tilt = _next_tilt_rad(planner.scene.control_step_s, tilt, pours_rad, norm(offset), rests, away)
        goal_w, q_w = expert.compute_cup_pose_at_mouth(
            state, way, np.minimum(tilt, expert.EMPTY_CUP_TILT_RAD), cup
        )
        into = transforms.rotate(expert.compute_approach_heading_quat_w(state, way), expert.FORWARD)
        back_m = compute_funnel_standoff_m(offset, into, 0.01, expert.STANDOFF_M) + np.where(
            away, WAITING_STANDOFF_M, 0.0
        )
        goal_w = goal_w + aside - back_m[:, None] * into
        too_far = ((goal_w - planner.tool_pos_w) * into).sum(axis=-1) < -MAX_GOAL_OVERSHOOT_M
        slowest = np.where(too_far, MIN_RETREAT_SPEED_M_S, MIN_SPEED_M_S)
        speed = np.clip(SPEED_GAIN_PER_S * norm(offset), slowest, MAX_SPEED_M_S)
        return planner.compute_action_to_pose(goal_w, q_w, speed, TURN_SPEED_RAD_S)


def _way(left_m: FloatArray, cup: CupShape = DEFAULT_CUP_SHAPE) -> Approach:
    """Returns the directions of the cups' approach. ``left_m`` (N,) is the distance of the reference point to the left
    of the pouring point.
    """
    return Approach(np.zeros_like(left_m), -elementary.arcsin(left_m / cup.rim_radius_m))


def _next_tilt_rad(
    step_s: float,
    tilt: FloatArray,
    pours_rad: FloatArray,
    distance_m: FloatArray,
    rests: BoolArray,
    away: BoolArray,
) -> FloatArray:
    """Returns the next tilt (N,), from the current tilt, the pouring tilt and the distance to the lips, (N,) each.

    ``rests``: the mouth is at rest. ``away``: the person looks away.
    """
    calm_rad = pours_rad - SPILL_MARGIN_RAD
    pours = (distance_m < POUR_START_DISTANCE_M) & ~away & (rests | (tilt < calm_rad))
    on = tilt + step_s * np.clip(TILT_GAIN_PER_S * (pours_rad - tilt), POUR_SPEED_RAD_S, TURN_SPEED_RAD_S)
    ready = np.minimum(tilt + step_s * TURN_SPEED_RAD_S, expert.POUR_START_TILT_RAD)
    stops = (tilt > calm_rad) & (away | ~rests | (distance_m > POUR_STOP_DISTANCE_M))
    waits = np.where(
        tilt < expert.POUR_START_TILT_RAD, ready, np.where(stops, expert.POUR_START_TILT_RAD, tilt)
    )
    return np.where(pours, on, np.where(distance_m > expert.STANDOFF_M, expert.CARRY_TILT_RAD, waits))


def _to_the_left(state: State) -> FloatArray:
    """Returns the direction (N, 3) from the right to the left shoulder."""
    shoulders_w = state.person_capsule_ends_w[:, [_RIGHT, _LEFT]].mean(axis=2)
    return transforms.normalize(shoulders_w[:, 1] - shoulders_w[:, 0])


def _turn_rad(state: State) -> FloatArray:
    """Returns the yaw angle (N,) of faces in radians. It is 0 for a face that looks at the cup, and positive to the
    left.
    """
    into, left = compute_direction_into_face_w(state), _to_the_left(state)
    turn_rad = elementary.arctan2(
        -(into * left).sum(axis=-1), (into * transforms.cross(expert.UP, left)).sum(axis=-1)
    )
    return turn_rad - FACING_CUP_YAW_RAD


def _expected_rad(turn_rad: FloatArray) -> FloatArray:
    """Returns the expected return angle (N,) of the faces of people who look away, in radians."""
    share = (np.abs(turn_rad) - LOOK_AWAY_ANGLE_RAD) / (FAR_LOOK_AWAY_ANGLE_RAD - LOOK_AWAY_ANGLE_RAD)
    return np.sign(turn_rad) * np.maximum(
        LOOK_AWAY_ANGLE_RAD - share * (LOOK_AWAY_ANGLE_RAD - EXPECTED_RETURN_ANGLE_RAD),
        EXPECTED_RETURN_ANGLE_RAD,
    )


def _turned(state: State, angle_rad: FloatArray) -> State:
    """Returns the state with heads turned about the vertical by angles (N,)."""
    turn = transforms.from_axis_angle(expert.UP, angle_rad)
    mouth_w = state.head_pos_w + transforms.rotate(turn, state.mouth_pos_w - state.head_pos_w)
    return replace(state, mouth_pos_w=mouth_w, head_quat_w=transforms.multiply(turn, state.head_quat_w))


def _aside_m(state: State, left: FloatArray, tool_w: FloatArray, at_lips_w: FloatArray) -> FloatArray:
    """Returns the lateral offset (N,) from the lips, in metres, at which cups stay on their side of the head.

    If the required offset exceeds ``MAX_LIP_OFFSET_M``, the returned offset decreases. The returned offset is zero if
    the required offset is 1.5 × ``MAX_LIP_OFFSET_M``.
    """
    tool_m, lips_m = (((pos_w - state.head_pos_w) * left).sum(axis=-1) for pos_w in (tool_w, at_lips_w))
    side = np.where(tool_m > 0.0, 1.0, -1.0)
    missing_m = np.maximum(MIN_MIDPLANE_DISTANCE_M - side * lips_m, 0.0)
    return side * np.maximum(np.minimum(missing_m, 3.0 * MAX_LIP_OFFSET_M - 2.0 * missing_m), 0.0)
