"""Planning expert for scratching: approaches the itch with clearance, presses gently, and rubs along the limb."""

from typing import NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like
from avrgym.geometry.transforms import norm
from avrgym.models.scratcher import ROD_RADIUS_M
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.person import LATERAL_AXES
from avrgym.tasks.scratch_itch.reward import (
    ITCH_RADIUS_M,
    ScratchItchState,
    compute_itch_limb_frame,
    compute_itch_pos_w,
)
from avrgym.tasks.task import RunningEpisodes

TILTS_RAD = np.radians([25.0, 50.0, 70.0])
NUM_TILT_DIRECTIONS = 8
"""Number of directions in which a tilt is tried.

Candidate directions of the rod are normal to the skin, or tilted by each of ``TILTS_RAD`` in each direction.
"""
TILT_COST_S_PER_RAD = 2.0
"""Cost in seconds per radian of the rod's tilt from the skin normal."""

SWING_SPEED_M_S, APPROACH_SPEED_M_S, RUB_SPEED_M_S, TURN_SPEED_RAD_S = 0.30, 0.05, 0.10, 0.8
STANDOFF_M, ARRIVAL_TOLERANCE_RAD = 0.06, 0.05
CONTACT_FORCE_N = 0.3
NO_CONTACT_DEPTH_STEP_M = 0.004
"""Increase of the tip's target depth in each control step without contact."""
CONTACT_SEARCH_DEPTH_M = 0.03
"""Target depth of the tip below the skin before contact."""
MIN_DETOUR_COST_S = 20.0
"""Threshold of a plan's cost in seconds. Above it, the tool first moves to a point in front of the wrist and above it.
"""
NUM_DETOUR_STEPS = 50
"""Number of control steps of the detour. Afterwards, the expert plans again."""
DETOUR_OFFSET_M = (0.0, -0.15, 0.10)
DOWNWARD_QUAT_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(0.5 * np.pi))
ROD_DIRECTION = (1.0, 0.0, 0.0)
"""Direction of the rod in the tool's frame."""
LOOP_HALF_AXES_M = np.array([0.014, 0.009])
"""Half axes of the tip's elliptic path around the itch: along and across the limb."""
LOOKAHEAD_ANGLE_RAD = np.radians(75.0)
"""Angle on the elliptic path between the tip and its target."""


class ForceControl(NamedTuple):
    """Force control of the tip: target force, depth step per newton of force error, and limits of the depth step."""

    target_force_n: float
    gain_m_per_n: float
    min_depth_step_m: float
    max_depth_step_m: float


FORCE_CONTROL = ForceControl(
    target_force_n=3.0, gain_m_per_n=0.0005, min_depth_step_m=-0.002, max_depth_step_m=0.001
)


class ScratchItchExpert:
    """Selects a direction of the rod for each person. The measured force controls the depth of the tip."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Plan the motion of the scratchers to the itches of the current people."""
        self._episodes = episodes
        self._planner = MotionPlanner(episodes)
        count = episodes.simulation.num_worlds
        self._arrived, self._touched = np.zeros((2, count), dtype=bool)
        self._q_limb, self._before = np.zeros((count, 4)), np.zeros_like(self._planner.joint_positions)
        self._steps = 0
        hard = self._plan(np.ones(count, dtype=bool)) > MIN_DETOUR_COST_S
        self._detour_positions, cost_s = plan_detour(self._planner, episodes.get_state())
        self._detour = hard & (cost_s < MIN_DETOUR_COST_S)

    def __call__(self, observation: FloatArray) -> FloatArray:
        planner = self._planner
        if self._steps == NUM_DETOUR_STEPS and self._detour.any():
            self._plan(self._detour)
            self._detour = np.zeros_like(self._detour)
        self._steps += 1
        goal = np.where(self._detour[:, None], self._detour_positions, self._before)
        swing = planner.plan_joint_space_step(goal, SWING_SPEED_M_S, np.pi)
        there = planner.compute_max_joint_distance_rad(goal) < ARRIVAL_TOLERANCE_RAD
        self._arrived |= there & ~self._detour
        tip_w, q_w = self._rub()
        speed = np.where(self._touched, RUB_SPEED_M_S, APPROACH_SPEED_M_S)
        straight = planner.plan_straight_line_step(tip_w, q_w, speed, TURN_SPEED_RAD_S)
        return planner.compute_action_to_joint_positions(np.where(self._arrived[:, None], straight, swing))

    def _rub(self) -> tuple[FloatArray, FloatArray]:
        """Returns the next tip position (N, 3) and rod rotation (N, 4)."""
        state, task_state = self._episodes.get_state(), self._episodes.task_state
        _, limb_q_w = compute_itch_limb_frame(state, task_state)
        out, _ = compute_skin_directions_w(task_state, limb_q_w)
        q_w = transforms.multiply(limb_q_w, self._q_limb)
        rod_w = transforms.rotate(q_w, ROD_DIRECTION)
        near = norm(state.tool_pos_w - compute_itch_pos_w(state, task_state)) < ITCH_RADIUS_M
        self._touched = near & (self._touched | (self._arrived & (state.tool_force_n > CONTACT_FORCE_N)))
        inside_w = compute_tip_pos_w(
            compute_itch_pos_w(state, task_state) - CONTACT_SEARCH_DEPTH_M * out, out, rod_w
        )
        rubbed_w = compute_rubbing_target(state, task_state, self._planner.tool_pos_w, rod_w, FORCE_CONTROL)
        return np.where(self._touched[:, None], rubbed_w, inside_w), q_w

    def _plan(self, worlds: BoolArray) -> FloatArray:
        """Select the fastest collision-free direction towards the itch, in the worlds of a mask (N,).

        The rotation about the rod is free; the last joint performs this rotation.

        Returns:
            Cost of the path (N,), seconds.
        """
        state, task_state = self._episodes.get_state(), self._episodes.task_state
        _, limb_q_w = compute_itch_limb_frame(state, task_state)
        out, along = compute_skin_directions_w(task_state, limb_q_w)
        into, tilt = _ways(out, along)
        here = np.broadcast_to(transforms.rotate(state.tool_quat_w, ROD_DIRECTION)[:, None], into.shape)
        q_w = transforms.multiply(_turn(here, into), state.tool_quat_w[:, None])
        tip_w = compute_tip_pos_w(compute_itch_pos_w(state, task_state)[:, None], out[:, None], into)
        angles, cost_s = self._planner.find_joint_positions(tip_w, q_w)
        world, best = np.arange(len(out)), (cost_s + TILT_COST_S_PER_RAD * tilt).argmin(axis=-1)
        tip_w, q_w, into = tip_w[world, best], q_w[world, best], into[world, best]
        angles = angles[world, best]
        before = self._planner.solve_inverse_kinematics(tip_w - STANDOFF_M * into, q_w, angles)
        q_limb = transforms.multiply(transforms.conjugate(limb_q_w), q_w)
        new = worlds[:, None]
        self._q_limb = np.where(new, q_limb, self._q_limb)
        self._before = np.where(new, before, self._before)
        self._planner.preferred_posture = np.where(new, angles, self._planner.preferred_posture)
        return cost_s[world, best]


def plan_detour(planner: MotionPlanner, state: State) -> tuple[FloatArray, FloatArray]:
    """Returns joint positions (N, J) of the detour and their cost (N,).

    The tool is in front of the wrist and above it. The rod points down.
    """
    wrist_w = state.right_arm_pos_w[:, 2]
    turns = transforms.from_axis_angle([1.0, 0.0, 0.0], np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False))
    q_w = np.tile(transforms.multiply(DOWNWARD_QUAT_W, turns), (len(wrist_w), 1, 1))
    place_w = np.repeat((wrist_w + DETOUR_OFFSET_M)[:, None], q_w.shape[1], axis=1)
    angles, cost_s = planner.find_joint_positions(place_w, q_w)
    world, best = np.arange(len(wrist_w)), cost_s.argmin(axis=-1)
    return angles[world, best], cost_s[world, best]


def compute_rubbing_target(
    state: State, task_state: ScratchItchState, pos_w: FloatArray, rod_w: FloatArray, press: ForceControl
) -> FloatArray:
    """Returns the next position (N, 3) of a tip that circles around the itch.

    The motion along the skin depends only on the tip's current position. The depth depends on the contact force.

    Args:
        state: physical state of N worlds.
        task_state: state of the task, with the position of the itch.
        pos_w: current target of the tip (N, 3), world frame.
        rod_w: rod direction, unit vectors (N, 3), world frame.
        press: parameters of the force control.
    """
    _, limb_q_w = compute_itch_limb_frame(state, task_state)
    out, along = compute_skin_directions_w(task_state, limb_q_w)
    axes = np.stack([along, transforms.cross(out, along)], axis=1)
    middle_w = compute_tip_pos_w(compute_itch_pos_w(state, task_state), out, rod_w)
    offset = ((state.tool_pos_w - middle_w)[:, None] * axes).sum(axis=-1) / LOOP_HALF_AXES_M
    angle = elementary.arctan2(offset[:, 1], offset[:, 0]) + LOOKAHEAD_ANGLE_RAD
    ahead = LOOP_HALF_AXES_M * np.stack([elementary.cos(angle), elementary.sin(angle)], axis=-1)
    next_w = middle_w + (ahead[..., None] * axes).sum(axis=1)
    deeper = np.clip(
        press.gain_m_per_n * (press.target_force_n - state.tool_force_n),
        press.min_depth_step_m,
        press.max_depth_step_m,
    )
    deeper = np.where(state.tool_force_n > 0.0, deeper, NO_CONTACT_DEPTH_STEP_M)
    height = ((pos_w - next_w) * out).sum(axis=-1) - deeper
    return next_w + height[:, None] * out


def compute_skin_directions_w(
    task_state: ScratchItchState, limb_q_w: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns unit vectors (N, 3) at the itch in the world frame: skin normal, and direction along the limb."""
    out = transforms.normalize(task_state.itch * constant_like(LATERAL_AXES, task_state.itch))
    return transforms.rotate(limb_q_w, out), transforms.rotate(limb_q_w, [0.0, 0.0, 1.0])


def _ways(out: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns candidate rod directions, unit vectors (N, K, 3), and their tilts (K,) in radians."""
    across = transforms.cross(out, along)
    sides = np.linspace(0.0, 2.0 * np.pi, NUM_TILT_DIRECTIONS, endpoint=False)
    aslant = [elementary.cos(side) * along + elementary.sin(side) * across for side in sides]
    tilted = [elementary.sin(tilt) * way - elementary.cos(tilt) * out for tilt in TILTS_RAD for way in aslant]
    return np.stack([-out, *tilted], axis=1), np.concatenate(
        [[0.0], np.repeat(TILTS_RAD, NUM_TILT_DIRECTIONS)]
    )


def compute_tip_pos_w(skin_w: FloatArray, out: FloatArray, into: FloatArray) -> FloatArray:
    """Returns the position (..., 3) of the tip of a rod with direction ``into`` that touches the skin at ``skin_w``.

    The tip has a distance from the touched point, because the end of the rod is round.
    """
    return skin_w + ROD_RADIUS_M * (out + into)


def _turn(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the shortest rotations (..., 4) from unit vectors a to unit vectors b, (..., 3)."""
    half = transforms.normalize(a + b)
    return np.concatenate([(a * half).sum(axis=-1, keepdims=True), transforms.cross(a, half)], axis=-1)
