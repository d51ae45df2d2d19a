"""Where a robot's base should stand so that its arm reaches what a task needs.

Task-centric optimisation (Kapusta and Kemp, "Task-centric optimization of configurations for assistive robots",
Autonomous Robots 43, 2019), here, as in the reference, over sampled base poses. All candidates of all worlds
are solved together; a world's result has the same bits alone and among others.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import elementary, kinematics, transforms
from avrgym.geometry.kinematics import METRES_PER_RADIAN, Chain, Solution
from avrgym.geometry.transforms import norm
from avrgym.models.robot import BaseRange

CANDIDATES = 100
NUM_UNIFORMS = 3 * CANDIDATES
"""How many numbers draw the candidates of a world."""
GOAL_ACCURACY_M, GOAL_ACCURACY_RAD = 0.03, np.radians(15.0)
START_ITERATIONS, START_TOLERANCE_M = 15, 0.003
RESTARTS, ENOUGH_CANDIDATES = 2, 10
GOAL_ITERATIONS, GOAL_TOLERANCE_M = 10, 0.02


@dataclass(frozen=True)
class BasePoses:
    """Positions (..., 3) and angles about the vertical (...) of a robot's base, world frame."""

    pos_w: FloatArray
    yaw_rad: FloatArray


@dataclass(frozen=True)
class Scores:
    """How each candidate did, (n, C).

    ``start_reached``: whether the arm reaches the start pose within 5 mm and 0.05 rad; ``start_error_m``: what
    is left, a radian counting as 0.3 m. ``goals_reached``: at how many goals the arm arrives from there.
    ``isotropy``: the sum over the poses that are reached, 0 where the start is not.
    """

    start_reached: BoolArray
    start_error_m: FloatArray
    goals_reached: IntArray
    isotropy: FloatArray


@dataclass(frozen=True)
class BaseChoice:
    """The best candidate of each world: its ``index`` (n,), its pose and the arm's angles (n, J) at the start.

    The start pose is met within 5 mm and 0.05 rad where ``reached`` (n,); elsewhere no candidate reaches it,
    and this one comes closest.
    """

    index: IntArray
    base: BasePoses
    angles_rad: FloatArray
    reached: BoolArray
    scores: Scores


def sample(base_range: BaseRange, pos_w: ArrayLike, yaw_rad: float, uniforms: FloatArray) -> BasePoses:
    """Candidates (n, C) around a nominal position (3,) and yaw, made of uniform numbers (n, 3C)."""
    ranges = np.array([base_range.x_m, base_range.y_m, base_range.yaw_rad])
    shares = uniforms.reshape(len(uniforms), -1, 3)
    offsets = ranges[:, 0] + (ranges[:, 1] - ranges[:, 0]) * shares
    return BasePoses(np.asarray(pos_w) + offsets * [1.0, 1.0, 0.0], yaw_rad + offsets[..., 2])


def search(
    chain: Chain,
    candidates: BasePoses,
    start_pos_w: FloatArray,
    start_q_w: FloatArray,
    goal_pos_w: FloatArray,
    goal_q_w: FloatArray | None,
    seed_rad: FloatArray,
) -> BaseChoice:
    """The candidates from which the arm reaches the start pose, then most goals, and those most freely.

    A goal counts within 3 cm (reference) and 15°. Among equal numbers of goals the sum of joint-limit-weighted
    kinematic isotropy over the start pose and the goals that are reached decides. The start pose is sought from
    the seed pose, the goals from the start pose. In worlds where fewer than ten candidates reach the start from
    the seed pose, the others try twice more from poses up to 1 rad around it.

    Args:
        chain: the arm from the robot's base to its tip.
        candidates: where the base may stand, (n, C).
        start_pos_w: (n, 3), where the tip starts.
        start_q_w: (n, 4).
        goal_pos_w: (n, G, 3), where it should be able to go from there.
        goal_q_w: (n, G, 4), or None where any rotation will do.
        seed_rad: (J,), where the search for the start pose begins.
    """
    count, per_world = len(candidates.yaw_rad), candidates.yaw_rad.shape[1]
    bases = BasePoses(candidates.pos_w.reshape(-1, 3), candidates.yaw_rad.reshape(-1))
    world = np.repeat(np.arange(count), per_world)
    pos, q = _point_from(bases, start_pos_w[world]), _rotation_from(bases, start_q_w[world])
    arms = _solve_starts(chain, pos, q, seed_rad, per_world)
    scores = _score(chain, bases, world, arms, goal_pos_w, goal_q_w)
    index = _merit(scores, goal_pos_w.shape[1]).reshape(count, per_world).argmax(axis=-1)
    best = index + per_world * np.arange(count)
    arm = kinematics.solve(chain, pos[best], q[best], arms.angles_rad[best])
    return BaseChoice(
        index=index,
        base=_rows(bases, best),
        angles_rad=kinematics.wrapped(chain, arm.angles_rad),
        reached=kinematics.accurate(arm),
        scores=Scores(**{name: score.reshape(count, per_world) for name, score in vars(scores).items()}),
    )


def _solve_starts(
    chain: Chain, pos: FloatArray, q: FloatArray, seed_rad: FloatArray, per_world: int
) -> Solution:
    """Arms (n C,) at start poses in the candidates' frames, ``per_world`` rows for each world."""
    seeds = np.tile(seed_rad, (len(pos), 1))
    arms = _solve_within_reach(chain, pos, q, seeds, START_ITERATIONS, START_TOLERANCE_M)
    around = seed_rad + kinematics.RESTART_SPREAD_RAD * _evenly_spread(RESTARTS * per_world, len(seed_rad))
    for starts in around.reshape(RESTARTS, per_world, -1):
        reached = kinematics.accurate(arms).reshape(-1, per_world)
        few = reached.sum(axis=-1, keepdims=True) < ENOUGH_CANDIDATES
        rows = np.nonzero((few & ~reached).reshape(-1))[0]
        again = _solve_within_reach(
            chain, pos[rows], q[rows], starts[rows % per_world], START_ITERATIONS, START_TOLERANCE_M
        )
        arms = kinematics.better(arms, again, rows)
    return arms


def _evenly_spread(count: int, dimensions: int) -> FloatArray:
    """Points (count, dimensions) that fill the cube ±1 evenly.

    Roberts' sequence (2018): steps of powers of 1/x, where x^(dimensions + 1) = x + 1.
    """
    x = 2.0
    for _ in range(50):
        x = (1.0 + x) ** (1.0 / (dimensions + 1))
    steps = elementary.power(x, -np.arange(1.0, dimensions + 1.0))
    return 2.0 * np.mod(np.arange(1.0, count + 1.0)[:, None] * steps, 1.0) - 1.0


def _score(
    chain: Chain,
    bases: BasePoses,
    world: IntArray,
    arms: Solution,
    goal_pos_w: FloatArray,
    goal_q_w: FloatArray | None,
) -> Scores:
    """Scores (n C,) of bases whose arms at the start are given."""
    reached = kinematics.accurate(arms)
    rows = np.nonzero(reached)[0]
    goals_reached, isotropy = np.zeros(len(reached), dtype=np.intp), np.zeros(len(reached))
    at, angles = _rows(bases, rows), arms.angles_rad[rows]
    isotropy[rows] = kinematics.isotropy(chain, angles)
    for goal in range(goal_pos_w.shape[1]):
        goal_q = None if goal_q_w is None else goal_q_w[world[rows], goal]
        arrived, freedom = _arrive(chain, at, angles, goal_pos_w[world[rows], goal], goal_q)
        goals_reached[rows] += arrived
        isotropy[rows] += freedom
    error = arms.position_error_m + METRES_PER_RADIAN * arms.rotation_error_rad
    return Scores(reached, error, goals_reached, isotropy)


def _arrive(
    chain: Chain,
    bases: BasePoses,
    angles_rad: FloatArray,
    goal_pos_w: FloatArray,
    goal_q_w: FloatArray | None,
) -> tuple[BoolArray, FloatArray]:
    """Which arms (N,) get to their goal from these angles, and how freely they stand there, 0 for others."""
    pos = _point_from(bases, goal_pos_w)
    q = None if goal_q_w is None else _rotation_from(bases, goal_q_w)
    arms = _solve_within_reach(chain, pos, q, angles_rad, GOAL_ITERATIONS, GOAL_TOLERANCE_M)
    arrived = (arms.position_error_m < GOAL_ACCURACY_M) & (arms.rotation_error_rad < GOAL_ACCURACY_RAD)
    isotropy = np.zeros(len(pos))
    isotropy[arrived] = kinematics.isotropy(chain, arms.angles_rad[arrived])
    return arrived, isotropy


def _merit(scores: Scores, goals: int) -> FloatArray:
    """Higher is better. An isotropy is at most 1: the sum of all does not outweigh one goal more."""
    merit = scores.goals_reached * (goals + 2.0) + scores.isotropy
    return np.where(scores.start_reached, merit, -scores.start_error_m)


def _solve_within_reach(
    chain: Chain,
    pos: FloatArray,
    q: FloatArray | None,
    start_rad: FloatArray,
    iterations: int,
    tolerance: float,
) -> Solution:
    """Inverse kinematics; what lies beyond the arm's reach is not tried and counts as half a turn away too."""
    beyond_m = norm(pos - chain.pos[0]) - kinematics.reach_m(chain)
    rows = np.nonzero(beyond_m <= 0.0)[0]
    found = kinematics.solve(
        chain, pos[rows], None if q is None else q[rows], start_rad[rows],
        iterations=iterations, tolerance=tolerance, precision=np.float32,
    )  # fmt: skip
    angles, position_error, rotation_error = start_rad.copy(), beyond_m, np.full(len(pos), np.pi)
    angles[rows] = found.angles_rad
    position_error[rows], rotation_error[rows] = found.position_error_m, found.rotation_error_rad
    return Solution(angles, position_error, rotation_error)


def _point_from(bases: BasePoses, pos_w: FloatArray) -> FloatArray:
    """World positions (N, 3) in the frames of bases (N,)."""
    return transforms.rotate(_upright(-bases.yaw_rad), pos_w - bases.pos_w)


def _rotation_from(bases: BasePoses, q_w: FloatArray) -> FloatArray:
    """World rotations (N, 4) in the frames of bases (N,)."""
    return transforms.multiply(_upright(-bases.yaw_rad), q_w)


def _upright(yaw_rad: FloatArray) -> FloatArray:
    return transforms.from_axis_angle([0.0, 0.0, 1.0], yaw_rad)


def _rows(bases: BasePoses, rows: IntArray) -> BasePoses:
    return BasePoses(bases.pos_w[rows], bases.yaw_rad[rows])
