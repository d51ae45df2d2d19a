"""Search for the pose of a robot's base from which its arm reaches the poses of a task.

The method is task-centric optimisation (Kapusta and Kemp, "Task-centric optimization of configurations for assistive
robots", Autonomous Robots 43, 2019) over sampled base poses, as in Assistive Gym. Inverse kinematics for all candidates
of all worlds is solved in one batch. The result of a world does not depend on the other worlds, bit for bit.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import elementary, kinematics, transforms
from avrgym.geometry.kinematics import METRES_PER_RADIAN, Chain, IKSolution
from avrgym.geometry.transforms import norm
from avrgym.models.robot import BaseRange

NUM_CANDIDATES = 100
"""Number of candidate base poses for each world."""
NUM_RANDOM_NUMBERS = 3 * NUM_CANDIDATES
"""Number of uniform random numbers for the candidates of one world: x, y and yaw of each candidate."""
MAX_GOAL_ERROR_M, MAX_GOAL_ERROR_RAD = 0.03, np.radians(15.0)
"""Maximum errors of position (as in Assistive Gym) and rotation for a reached goal."""
START_IK_ITERATIONS, START_IK_TOLERANCE_M = 15, 0.003
"""Maximum number of iterations, and tolerance, of the inverse kinematics for the start pose."""
NUM_IK_RESTARTS, MIN_REACHING_CANDIDATES = 2, 10
"""Number of restarts of the inverse kinematics. Only worlds in which fewer candidates than the second number reach the
start pose are restarted."""
GOAL_IK_ITERATIONS, GOAL_IK_TOLERANCE_M = 10, 0.02
"""Maximum number of iterations, and tolerance, of the inverse kinematics for the goals."""


@dataclass(frozen=True)
class BasePoses:
    """Positions (..., 3) and yaw angles (...) of a robot's base, world frame."""

    pos_w: FloatArray
    yaw_rad: FloatArray


@dataclass(frozen=True)
class CandidateScores:
    """Scores of C candidates in n worlds. All arrays are (n, C).

    Attributes:
        is_start_reached: whether the arm reaches the start pose within 5 mm and 0.05 rad.
        start_error_m: residual position error plus rotation error in the start pose; 1 rad is weighted as 0.3 m.
        num_goals_reached: number of goals that the arm reaches from the start pose.
        isotropy_sum: sum of the kinematic isotropy over all reached poses; 0 if the start pose is not reached.
    """

    is_start_reached: BoolArray
    start_error_m: FloatArray
    num_goals_reached: IntArray
    isotropy_sum: FloatArray


@dataclass(frozen=True)
class BaseSearchResult:
    """The best candidate of each of n worlds.

    Attributes:
        candidate_index: index (n,) of the candidate.
        base_poses: poses (n,) of the base.
        joint_positions: joint positions (n, J) in the start pose.
        is_start_reached: whether (n,) the arm reaches the start pose within 5 mm and 0.05 rad. If no candidate of a
            world reaches it, the best candidate is the one with the smallest error.
        scores: scores (n, C) of all candidates.
    """

    candidate_index: IntArray
    base_poses: BasePoses
    joint_positions: FloatArray
    is_start_reached: BoolArray
    scores: CandidateScores


PathCost = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""A function that returns the costs (n, K) of K initial states of n worlds. Its arguments are the positions (n, K, 3)
and yaw angles (n, K) of the base, and the joint positions (n, K, J)."""
NUM_PATH_COST_CANDIDATES = 16
"""Number of candidates for which ``path_cost`` is computed."""


def sample_base_poses(
    base_range: BaseRange, pos_w: ArrayLike, yaw_rad: float, uniforms: FloatArray
) -> BasePoses:
    """Returns base poses (n, C) around a nominal position (3,) and yaw, from uniform random numbers (n, 3C)."""
    ranges = np.array([base_range.x_m, base_range.y_m, base_range.yaw_rad])
    shares = uniforms.reshape(len(uniforms), -1, 3)
    offsets = ranges[:, 0] + (ranges[:, 1] - ranges[:, 0]) * shares
    return BasePoses(np.asarray(pos_w) + offsets * [1.0, 1.0, 0.0], yaw_rad + offsets[..., 2])


def search_base_pose(
    chain: Chain,
    candidates: BasePoses,
    start_pos_w: FloatArray,
    start_q_w: FloatArray,
    goal_pos_w: FloatArray,
    goal_q_w: FloatArray | None,
    seed_pose: FloatArray,
    path_cost: PathCost | None = None,
) -> BaseSearchResult:
    """Returns the best candidate of each world: it reaches the start pose and most goals, with the highest isotropy.

    With ``path_cost``, the result is the candidate with the lowest cost among the best ``NUM_PATH_COST_CANDIDATES``
    candidates.

    A goal is reached if the errors are below 3 cm and 15°. Among candidates with the same number of reached goals, the
    one with the highest sum of isotropies is best. The sum is over the start pose and the reached goals; the isotropy
    is the joint-limit-weighted kinematic isotropy. Inverse kinematics begins at the seed pose for the start pose, and
    at the start pose for the goals. If fewer than ten candidates of a world reach the start pose, the search for the
    others is repeated twice. These searches begin at poses around the seed pose.

    Args:
        chain: the arm from the robot's base to its tip.
        candidates: base poses, (n, C).
        start_pos_w: start positions of the tip (n, 3), world frame.
        start_q_w: start orientations of the tip (n, 4), world frame.
        goal_pos_w: goal positions of the tip (n, G, 3), world frame.
        goal_q_w: goal orientations of the tip (n, G, 4), world frame, or None for any orientation.
        seed_pose: initial joint positions (J,) of the search for the start pose.
        path_cost: cost of the motion from an initial state.
    """
    count, per_world = len(candidates.yaw_rad), candidates.yaw_rad.shape[1]
    bases = BasePoses(candidates.pos_w.reshape(-1, 3), candidates.yaw_rad.reshape(-1))
    world = np.repeat(np.arange(count), per_world)
    pos, q = _point_from(bases, start_pos_w[world]), _rotation_from(bases, start_q_w[world])
    arms = _solve_starts(chain, pos, q, seed_pose, per_world)
    scores = _score(chain, bases, world, arms, goal_pos_w, goal_q_w)
    merit = _merit(scores, goal_pos_w.shape[1]).reshape(count, per_world)
    index = merit.argmax(axis=-1)
    if path_cost is not None:
        ranked = np.argsort(-merit, axis=-1, kind="stable")[:, :NUM_PATH_COST_CANDIDATES]
        rows = ranked + per_world * np.arange(count)[:, None]
        cost = path_cost(bases.pos_w[rows], bases.yaw_rad[rows], arms.joint_positions[rows])
        index = ranked[np.arange(count), cost.argmin(axis=-1)]
    best = index + per_world * np.arange(count)
    arm = kinematics.inverse_kinematics(chain, pos[best], q[best], arms.joint_positions[best])
    return BaseSearchResult(
        candidate_index=index,
        base_poses=_rows(bases, best),
        joint_positions=kinematics.wrap_angles(chain, arm.joint_positions),
        is_start_reached=kinematics.is_accurate(arm),
        scores=CandidateScores(
            **{name: score.reshape(count, per_world) for name, score in vars(scores).items()}
        ),
    )


def _solve_starts(
    chain: Chain, pos: FloatArray, q: FloatArray, seed_pose: FloatArray, per_world: int
) -> IKSolution:
    """Solves the inverse kinematics of start poses in the candidates' frames. Returns the solutions (n C,).

    Each world has ``per_world`` rows.
    """
    seeds = np.tile(seed_pose, (len(pos), 1))
    arms = _solve_within_reach(chain, pos, q, seeds, START_IK_ITERATIONS, START_IK_TOLERANCE_M)
    spread = kinematics.MAX_RESTART_OFFSET_RAD * chain.joint_scales
    around = seed_pose + spread * _evenly_spread(NUM_IK_RESTARTS * per_world, len(seed_pose))
    for starts in around.reshape(NUM_IK_RESTARTS, per_world, -1):
        reached = kinematics.is_accurate(arms).reshape(-1, per_world)
        few = reached.sum(axis=-1, keepdims=True) < MIN_REACHING_CANDIDATES
        rows = np.nonzero((few & ~reached).reshape(-1))[0]
        again = _solve_within_reach(
            chain, pos[rows], q[rows], starts[rows % per_world], START_IK_ITERATIONS, START_IK_TOLERANCE_M
        )
        arms = kinematics.replace_worse_solutions(arms, again, rows)
    return arms


def _evenly_spread(count: int, dimensions: int) -> FloatArray:
    """Returns quasi-random points (count, dimensions) in [−1, 1]^dimensions.

    Roberts' low-discrepancy sequence (2018): the step in dimension k is x^−k, where x^(dimensions + 1) = x + 1.
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
    arms: IKSolution,
    goal_pos_w: FloatArray,
    goal_q_w: FloatArray | None,
) -> CandidateScores:
    """Returns the scores (n C,) of base poses, given the joint positions in the start pose."""
    reached = kinematics.is_accurate(arms)
    rows = np.nonzero(reached)[0]
    goals_reached, isotropy = np.zeros(len(reached), dtype=np.intp), np.zeros(len(reached))
    shape = int(goal_pos_w.shape[1]), len(rows)
    goals = np.tile(rows, shape[0])
    number: IntArray = np.repeat(np.arange(shape[0]), shape[1])
    goal_q = None if goal_q_w is None else goal_q_w[world[goals], number]
    arrived, freedom = _arrive(
        chain, _rows(bases, goals), arms.joint_positions[goals], goal_pos_w[world[goals], number], goal_q
    )
    goals_reached[rows] = arrived.reshape(shape).sum(axis=0)
    isotropy[rows] = kinematics.compute_isotropy(chain, arms.joint_positions[rows])
    for each in freedom.reshape(shape):
        isotropy[rows] += each
    error = arms.position_error_m + METRES_PER_RADIAN * arms.rotation_error_rad
    return CandidateScores(reached, error, goals_reached, isotropy)


def _arrive(
    chain: Chain,
    bases: BasePoses,
    joint_positions: FloatArray,
    goal_pos_w: FloatArray,
    goal_q_w: FloatArray | None,
) -> tuple[BoolArray, FloatArray]:
    """Returns a mask (N,) of the arms that reach their goal from these joint positions, and the isotropy (N,) at the
    goal. The isotropy is 0 if the goal is not reached."""
    pos = _point_from(bases, goal_pos_w)
    q = None if goal_q_w is None else _rotation_from(bases, goal_q_w)
    arms = _solve_within_reach(chain, pos, q, joint_positions, GOAL_IK_ITERATIONS, GOAL_IK_TOLERANCE_M)
    arrived = (arms.position_error_m < MAX_GOAL_ERROR_M) & (arms.rotation_error_rad < MAX_GOAL_ERROR_RAD)
    isotropy = np.zeros(len(pos))
    isotropy[arrived] = kinematics.compute_isotropy(chain, arms.joint_positions[arrived])
    return arrived, isotropy


def _merit(scores: CandidateScores, goals: int) -> FloatArray:
    """Returns a score for the ranking of each candidate; higher is better.

    One more reached goal always increases the score more than the isotropies, because each isotropy is at most 1.
    """
    merit = scores.num_goals_reached * (goals + 2.0) + scores.isotropy_sum
    return np.where(scores.is_start_reached, merit, -scores.start_error_m)


def _solve_within_reach(
    chain: Chain,
    pos: FloatArray,
    q: FloatArray | None,
    start: FloatArray,
    iterations: int,
    tolerance: float,
) -> IKSolution:
    """Returns solutions of the inverse kinematics for poses (N,) within reach.

    For poses out of reach, the position error is the distance beyond the reach, and the rotation error is π.
    """
    beyond_m = norm(pos - chain.body_pos[0]) - kinematics.compute_max_reach_m(chain)
    rows = np.nonzero(beyond_m <= 0.0)[0]
    found = kinematics.inverse_kinematics(
        chain, pos[rows], None if q is None else q[rows], start[rows],
        iterations=iterations, tolerance=tolerance, precision=np.float32,
    )  # fmt: skip
    angles, position_error, rotation_error = start.copy(), beyond_m, np.full(len(pos), np.pi)
    angles[rows] = found.joint_positions
    position_error[rows], rotation_error[rows] = found.position_error_m, found.rotation_error_rad
    return IKSolution(angles, position_error, rotation_error)


def _point_from(bases: BasePoses, pos_w: FloatArray) -> FloatArray:
    """Transforms positions (N, 3) from the world frame to the frames of bases (N,)."""
    return transforms.rotate(_upright(-bases.yaw_rad), pos_w - bases.pos_w)


def _rotation_from(bases: BasePoses, q_w: FloatArray) -> FloatArray:
    """Transforms rotations (N, 4) from the world frame to the frames of bases (N,)."""
    return transforms.multiply(_upright(-bases.yaw_rad), q_w)


def _upright(yaw_rad: FloatArray) -> FloatArray:
    return transforms.from_axis_angle([0.0, 0.0, 1.0], yaw_rad)


def _rows(bases: BasePoses, rows: IntArray) -> BasePoses:
    return BasePoses(bases.pos_w[rows], bases.yaw_rad[rows])
