"""Reward of dressing: length of the arm in the sleeve, and the preferences of the person.

The arm is a path from the centre of the hand through wrist and elbow to the shoulder. The sleeve's opening has passed a
point of the path if its rim winds around the arm there. As in Assistive Gym, the reward increases with the covered
length of the arm. It decreases with the forces on the person.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like, get_namespace, make_row_indices
from avrgym.geometry.transforms import norm
from avrgym.models import human
from avrgym.models.human import People
from avrgym.models.sleeve import VERTICES_PER_RING
from avrgym.simulation.worlds import State
from avrgym.tasks.person import zero_comfortable_forces
from avrgym.tasks.task import StepResult

DRESSED_SHOULDER_DISTANCE_M = 0.12
"""Distance of the opening from the shoulder joint, along the upper arm, at which the arm is dressed.

At smaller distances the inner side of the opening touches the torso. The surface of the torso is about 0.1 m from the
joint.
"""

ARM_POINTS = ("wrist", "elbow", "shoulder")
"""Names of the points of the arm that the sleeve's opening passes, in this order."""

REWARD_WEIGHTS: Mapping[str, float] = {
    "distance_m": -1.0,
    "action_squared": -0.01,
    "newly_dressed_m": 200.0,
    "tool_speed_m_s": -0.25,
    "force_elsewhere_n": -0.01,
    "cloth_force_n": -0.01,
    "strong_cloth_force_n": -0.05,
}
"""Weights of the reward terms: first of the task, then of the person's preferences, as in the other tasks. The reward
for a fully dressed arm is about 100.
"""

_GEOMS = list(human.GEOMS)
HAND_GEOM_INDEX, FOREARM_GEOM_INDEX, UPPER_ARM_GEOM_INDEX = (
    _GEOMS.index(name) for name in ("left_hand", "left_forearm", "left_upper_arm")
)


@dataclass(frozen=True)
class DressingState:
    """Progress of dressing in N worlds.

    ``dressed_m`` (N,) is the largest length of the arm that has been in the sleeve. ``passed`` (N,) is the number of
    ``ARM_POINTS`` that the opening has passed.
    """

    dressed_m: FloatArray
    passed: IntArray


class ArmPath(NamedTuple):
    """Three sections of the left arm, from the hand's centre to wrist, elbow and shoulder; world frame.

    ``section_start_w`` and ``section_direction_w`` are start point and direction of each section, (N, 3, 3).
    ``length_m`` (N, 3) are the lengths of the sections. ``section_end_distance_m`` (N, 3) are the distances of their
    ends from the hand's centre along the arm.
    """

    section_start_w: FloatArray
    section_direction_w: FloatArray
    length_m: FloatArray
    section_end_distance_m: FloatArray


class NearestPathPoint(NamedTuple):
    """The points of N arm paths that are nearest to given points.

    ``pos_w`` (N, 3) is the nearest point, ``section_index`` (N,) its section. ``path_distance_m`` (N,) is its distance
    from the hand's centre along the arm, negative in front of the hand.
    """

    pos_w: FloatArray
    section_index: IntArray
    path_distance_m: FloatArray


class SleeveOpening(NamedTuple):
    """Position of the sleeve's opening relative to the arm.

    ``centre_w`` (N, 3) is its centre, ``section_index`` (N,) the nearest section of the arm. ``path_distance_m`` (N,)
    is the distance of the nearest point from the hand's centre along the arm. ``is_around_arm`` (N,): whether the rim
    winds around the arm there.
    """

    centre_w: FloatArray
    section_index: IntArray
    path_distance_m: FloatArray
    is_around_arm: BoolArray


def make_initial_task_state(people: People, uniforms: FloatArray) -> DressingState:
    """Returns the initial task state of N worlds: no part of the arm is in the sleeve."""
    xp, first = get_namespace(uniforms), uniforms[:, 0]
    return DressingState(xp.zeros_like(first), xp.zeros_like(xp.astype(first, xp.int64)))


def evaluate_step(state: State, action: FloatArray, task_state: DressingState) -> StepResult:
    """Returns the result of a step. The force elsewhere (not at the target) is the force of the robot's links and of
    the hoop on the person.
    """
    xp, path = get_namespace(state.tool_pos_w), compute_arm_path(state)
    opening = locate_opening(state, path)
    dressed_m = xp.where(opening.is_around_arm, opening.path_distance_m, 0.0)
    most_m = xp.maximum(dressed_m, task_state.dressed_m)
    places_m = path.section_end_distance_m - constant_like(
        np.array([0.0, 0.0, DRESSED_SHOULDER_DISTANCE_M]), most_m
    )
    passed = xp.astype((most_m[:, None] >= places_m).sum(axis=-1), xp.int64)
    passed = xp.maximum(passed, task_state.passed)
    to_hand_m = norm(opening.centre_w - path.section_start_w[:, 0])
    distance_m = (
        path.section_end_distance_m[:, 2] - dressed_m + xp.where(opening.is_around_arm, 0.0, to_hand_m)
    )
    terms = {
        "distance_m": distance_m,
        "action_squared": (action * action).sum(axis=-1),
        "newly_dressed_m": most_m - task_state.dressed_m,
        "tool_speed_m_s": norm(state.tool_velocity_w),
        "force_elsewhere_n": xp.maximum(state.total_force_n - state.cloth_force_n, 0.0),
        "cloth_force_n": state.cloth_force_n,
        "strong_cloth_force_n": zero_comfortable_forces(state.cloth_force_n),
    }
    nothing = xp.zeros((len(distance_m), 0), dtype=xp.bool, device=distance_m.device)
    after = DressingState(most_m, passed)
    return StepResult(
        after, terms, distance_m, state.total_force_n, is_dressed(after), passed - task_state.passed, nothing
    )


def is_dressed(task_state: DressingState) -> BoolArray:
    """Returns a boolean mask (N,): whether the opening has passed the shoulder."""
    return task_state.passed == len(ARM_POINTS)


def compute_arm_path(state: State) -> ArmPath:
    """Returns the paths along the left arms of N people, world frame."""
    segments_w, xp = state.person_capsule_ends_w, get_namespace(state.person_capsule_ends_w)
    points_w = xp.stack(
        [
            segments_w[:, HAND_GEOM_INDEX, 0],
            segments_w[:, FOREARM_GEOM_INDEX, 0],
            segments_w[:, UPPER_ARM_GEOM_INDEX, 0],
            segments_w[:, UPPER_ARM_GEOM_INDEX, 1],
        ],
        axis=1,
    )
    way = points_w[:, 1:] - points_w[:, :-1]
    length_m = norm(way)
    return ArmPath(
        points_w[:, :-1], way / length_m[..., None], length_m, xp.cumulative_sum(length_m, axis=-1)
    )


def locate_opening(state: State, path: ArmPath) -> SleeveOpening:
    """Returns the position of the openings relative to the nearest sections of the arms."""
    rim_w = state.cloth_pos_w[:, :VERTICES_PER_RING]
    centre_w = rim_w.mean(axis=1)
    nearest = find_nearest_path_point(centre_w, path)
    axis_w = path.section_direction_w[make_row_indices(nearest.section_index), nearest.section_index]
    ahead_m = ((centre_w - path.section_start_w[:, 0]) * path.section_direction_w[:, 0]).sum(axis=-1)
    around = is_rim_around_axis(rim_w, nearest.pos_w, axis_w) & (ahead_m > 0.0)
    return SleeveOpening(centre_w, nearest.section_index, nearest.path_distance_m, around)


def find_nearest_path_point(pos_w: FloatArray, path: ArmPath, *, extended: bool = False) -> NearestPathPoint:
    """Returns the points of the paths that are nearest to positions (N, 3).

    If ``extended`` is true, the first section is extended in front of the hand.
    """
    xp = get_namespace(pos_w)
    ahead_m = ((pos_w[:, None] - path.section_start_w) * path.section_direction_w).sum(axis=-1)
    lowest = constant_like(np.array([-np.inf if extended else 0.0, 0.0, 0.0]), pos_w)
    inside_m = xp.minimum(xp.maximum(ahead_m, lowest), path.length_m)
    points_w = path.section_start_w + inside_m[..., None] * path.section_direction_w
    section = norm(pos_w[:, None] - points_w).argmin(axis=-1)
    row = make_row_indices(section)
    at_m = path.section_end_distance_m[row, section] - path.length_m[row, section] + inside_m[row, section]
    return NearestPathPoint(points_w[row, section], section, at_m)


def is_rim_around_axis(rim_w: FloatArray, point_w: FloatArray, axis_w: FloatArray) -> BoolArray:
    """Returns a boolean mask (N,) of the closed polylines ``rim_w`` (N, R, 3) that wind around their axis.

    Each axis is given by a point (N, 3) and a unit direction (N, 3).
    """
    xp, offset = get_namespace(rim_w), rim_w - point_w[:, None]
    across = offset[:, 0] - (offset[:, 0] * axis_w).sum(axis=-1)[:, None] * axis_w
    first = across / xp.maximum(norm(across), 1e-9)[:, None]
    second = transforms.cross(axis_w, first)
    angle = elementary.arctan2(
        (offset * second[:, None]).sum(axis=-1), (offset * first[:, None]).sum(axis=-1)
    )
    turn = xp.concat([angle[:, 1:], angle[:, :1]], axis=1) - angle
    turn = turn - 2.0 * np.pi * xp.round(turn / (2.0 * np.pi))
    return xp.abs(turn.sum(axis=-1)) > np.pi
