"""Planning expert for feeding: carries the spoon to a point in front of the mouth, then moves it in."""

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.models.tools import Tool
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.head_clearance import compute_clearance_shift_m, compute_direction_into_face_w
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.feeding.reward import MOUTH_RADIUS_M, SUCCESS_FOOD_FRACTION
from avrgym.tasks.task import RunningEpisodes

TIP_FIRST_SPOON_POSES = [
    (0.0, pitch, 0.0, rise) for pitch in (0.0, 15.0, -15.0) for rise in (0.0, 0.006, -0.006)
]
TURNED_SPOON_POSES = [(turn, 0.0, 0.0, 0.0) for turn in (20.0, -20.0, -40.0)]
SIDEWAYS_SPOON_POSES = [(turn, 0.0, roll, 0.0) for turn in (-75.0, -90.0, -105.0) for roll in (0.0, -15.0)]
SPOON_YAWS_DEG, SPOON_PITCHES_DEG, SPOON_ROLLS_DEG, SPOON_HEIGHTS_M = np.array(
    TIP_FIRST_SPOON_POSES + TURNED_SPOON_POSES + SIDEWAYS_SPOON_POSES
).T
"""Candidate spoon poses: yaw, pitch, roll and height above the mouth.

The yaw is relative to the direction into the face, the roll is towards the lips.
"""
OUTSIDE_FOOD_COST_S = 3.0
"""Cost in seconds of each piece of food that may remain outside the mouth."""
FAILURE_COST_S = 10.0
"""Cost in seconds of a pose with too few pieces of food in the mouth for success."""
FOOD_SHIFT_MARGIN_M = 0.001
"""Margin of the spoon's position, because food may slide on the spoon."""

CARRY_SPEED_M_S, INSERTION_SPEED_M_S, TURN_SPEED_RAD_S, MAX_TILT_RAD = 0.35, 0.08, 0.8, np.radians(20.0)
STANDOFF_M, ARRIVAL_TOLERANCE_RAD = 0.06, 0.03
CLEARANCE_M = 0.002
"""Initial clearance of the spoon from the face."""
APPROACH_STEP_M = 0.0005
"""Distance that the spoon moves closer in a control step if too little food reaches the mouth."""
MAX_APPROACH_FORCE_N = 4.0
"""Maximum contact force on the person at which the spoon moves closer."""
SPOON_RADIUS_M = 0.05
UP = np.array([0.0, 0.0, 1.0])


class FeedingExpert:
    """Selects a spoon pose for each person. The spoon moves to a point in front of the mouth, then straight in."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Plan the motion of the spoons to the current people."""
        self._episodes = episodes
        self._planner = MotionPlanner(episodes)
        self._tool, count = episodes.scene.tool, episodes.simulation.num_worlds
        self._spare_pieces = (1.0 - SUCCESS_FOOD_FRACTION) * len(compute_initial_food_positions(self._tool))
        self._clearance_m, self._arrived = np.full(count, CLEARANCE_M), np.zeros(count, dtype=bool)
        self._plan(episodes.get_state())

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) of the next control step."""
        state, planner = self._episodes.get_state(), self._planner
        self._arrived |= planner.compute_max_joint_distance_rad(self._before) < ARRIVAL_TOLERANCE_RAD
        swing = planner.plan_joint_space_step(self._before, CARRY_SPEED_M_S, MAX_TILT_RAD)
        target = compute_spoon_pos_at_mouth_w(self._tool, state, self._q_w, self._rise_m, self._clearance_m)
        there = self._arrived & (norm(target - planner.tool_pos_w) < 2.0 * APPROACH_STEP_M)
        self._clearance_m -= np.where(there & self._may_move_closer(state), APPROACH_STEP_M, 0.0)
        into = planner.plan_straight_line_step(target, self._q_w, INSERTION_SPEED_M_S, TURN_SPEED_RAD_S)
        return planner.compute_action_to_joint_positions(np.where(self._arrived[:, None], into, swing))

    def _plan(self, state: State) -> None:
        """Select the fastest reachable pose that brings most of the food into the mouth."""
        q_w = _spoon_q_w(state)
        pos_w = np.stack(
            [
                compute_spoon_pos_at_mouth_w(self._tool, state, q_w[:, way], rise, self._clearance_m)
                for way, rise in enumerate(SPOON_HEIGHTS_M)
            ],
            axis=1,
        )
        food_w = pos_w[:, :, None] + transforms.rotate(
            q_w[:, :, None], compute_initial_food_positions(self._tool)
        )
        from_mouth = norm(food_w - state.mouth_pos_w[:, None, None])
        in_doubt = (from_mouth > MOUTH_RADIUS_M - FOOD_SHIFT_MARGIN_M).sum(axis=-1)
        failed = (from_mouth > MOUTH_RADIUS_M).sum(axis=-1) > self._spare_pieces
        before, seconds = self._planner.find_joint_positions(
            pos_w - STANDOFF_M * compute_direction_into_face_w(state)[:, None], q_w, MAX_TILT_RAD
        )
        cost = seconds + OUTSIDE_FOOD_COST_S * in_doubt + FAILURE_COST_S * failed
        best = cost.argmin(axis=-1)
        world = np.arange(len(best))
        self._q_w, self._rise_m = q_w[world, best], SPOON_HEIGHTS_M[best]
        self._before = before[world, best]
        self._planner.preferred_posture = self._before

    def _may_move_closer(self, state: State) -> BoolArray:
        """Returns a boolean mask (N,) of worlds in which the spoon may move closer: too much food is on the spoon, and
        the contact force is small.
        """
        on_spoon = norm(state.particle_pos_w - state.tool_pos_w[:, None]) < SPOON_RADIUS_M
        return (on_spoon.sum(axis=-1) > self._spare_pieces) & (state.robot_force_n < MAX_APPROACH_FORCE_N)


def compute_initial_food_positions(tool: Tool) -> FloatArray:
    """Returns the initial positions (K, 3) of the food in the spoon's frame."""
    assert tool.particles is not None
    return tool.particles.initial_pos


def _spoon_q_w(state: State) -> FloatArray:
    """Returns the spoon rotations (N, K, 4) of all candidates."""
    into = compute_direction_into_face_w(state)
    yaw = elementary.arctan2(into[:, 1], into[:, 0])[:, None]
    turn = transforms.from_axis_angle([0.0, 0.0, 1.0], yaw + np.radians(SPOON_YAWS_DEG))
    pitch = transforms.from_axis_angle([0.0, -1.0, 0.0], np.radians(SPOON_PITCHES_DEG))
    roll = transforms.from_axis_angle([1.0, 0.0, 0.0], np.radians(SPOON_ROLLS_DEG))
    return transforms.multiply(turn, transforms.multiply(pitch, roll))


def compute_spoon_pos_at_mouth_w(
    tool: Tool, state: State, q_w: FloatArray, rise_m: FloatArray | float, clearance_m: FloatArray
) -> FloatArray:
    """Returns spoon positions (N, 3) in the middle of the mouth, or farther out if the clearance requires it."""
    assert tool.mouth_part_outline is not None
    pos_w = state.mouth_pos_w + np.multiply.outer(rise_m, UP)
    outline_w = pos_w[:, None] + transforms.rotate(q_w[:, None], tool.mouth_part_outline)
    back = -compute_direction_into_face_w(state)
    return pos_w + compute_clearance_shift_m(outline_w, back, state, clearance_m)[:, None] * back
