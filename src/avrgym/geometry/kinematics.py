"""Kinematics of chains of hinges and slides: forward kinematics, Jacobian, isotropy, inverse kinematics.

Joint positions are in radians for hinges and in metres for slides. ``Chain.joint_scales`` makes them comparable. In
public arrays (N, ...) the row is the first axis. Internally it is the last axis: operations then use contiguous memory.
A rotation is stored as its three columns, (3, 3, N). A row's result does not depend on other rows, bit for bit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any

import mujoco
import numpy as np
from numpy.typing import DTypeLike

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.small_matrices import (
    MIN_DIVISOR,
    cross,
    diagonal,
    gaussian_elimination,
    move_batch_axis_first,
    move_batch_axis_last,
    norm,
    rotation_between,
    solve_linear,
    weighted_gram_matrix,
    weighted_sum,
)

SLIDE_JOINT_TYPE = int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, eq=False)
class Chain:
    """A kinematic chain of J hinges and slides from a base frame to a tip frame.

    Attributes:
        body_pos, body_quat: pose of each joint's body in the frame of the previous body at joint position zero, (J, 3)
            and (J, 4).
        joint_axis: joint axes in the frame of their bodies (J, 3).
        tip_pos, tip_quat: pose of the tip in the frame of the last body, (3,) and (4,).
        lower_limit, upper_limit: joint ranges (J,), infinite for continuous joints.
        slide_joints: indices of the joints that are slides.
    """

    body_pos: FloatArray
    body_quat: FloatArray
    joint_axis: FloatArray
    tip_pos: FloatArray
    tip_quat: FloatArray
    lower_limit: FloatArray
    upper_limit: FloatArray
    slide_joints: frozenset[int] = frozenset()

    @cached_property
    def joint_scales(self) -> FloatArray:
        """Unit of each joint's position (J,): 1 rad for a hinge, ``METRES_PER_RADIAN`` for a slide."""
        units = np.ones(len(self.body_pos))
        units[list(self.slide_joints)] = METRES_PER_RADIAN
        return units

    @cached_property
    def links(self) -> tuple[tuple[list[float], list[list[float]]], ...]:
        """The chain as J + 1 links, in frames with the joint axis as z axis. The last link ends at the tip.

        Each link is a fixed translation (3,) and the three columns (3, 3) of a fixed rotation matrix.
        """
        turned = [np.eye(3), *(_frame_with_z(axis) for axis in self.joint_axis)]
        offsets, rotations = (
            [*self.body_pos, self.tip_pos],
            transforms.to_matrix([*self.body_quat, self.tip_quat]),
        )
        ends = [*turned[1:], np.eye(3)]
        return tuple(
            (_snapped(_product(before.T, offset)), _snapped(_product(_product(before.T, rotation), after).T))
            for before, offset, rotation, after in zip(turned, offsets, rotations, ends, strict=True)
        )


def _frame_with_z(axis: FloatArray) -> FloatArray:
    """Returns a rotation matrix (3, 3) with ``axis`` as third column. It is a permutation matrix if possible."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = transforms.normalize(helper - axis * (axis * helper).sum())
    return np.stack([x, np.cross(axis, x), axis], axis=-1)


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the product of two matrices (3, 3), or of a matrix and a vector (3,). Terms are added in column order."""
    return reduce(np.add, (np.multiply.outer(column, row) for column, row in zip(a.T, b, strict=True)))


def _snapped(values: FloatArray) -> list[Any]:
    """Returns the values, with numbers close to 0 or ±1 rounded to it. Products with 0 and ±1 are faster."""
    whole = np.round(values)
    return np.where(np.abs(values - whole) < 1e-12, whole, values).tolist()


def extract_chain(model: mujoco.MjModel, joints: Sequence[str], base: str, tip: str) -> Chain:
    """Returns the chain of a model from the frame of body ``base`` to body ``tip``. Bodies without joints are allowed.

    Raises:
        ValueError: if the joints on the path from base to tip are not ``joints``, one per body and in this order.
    """
    joint_of_body = {int(model.joint(name).bodyid[0]): name for name in joints}
    base_id, body = model.body(base).id, model.body(tip).id
    pos, q = np.zeros(3), transforms.IDENTITY_QUATERNION
    segments: list[tuple[str, FloatArray, FloatArray]] = []
    while body != base_id:
        if body == 0:
            raise ValueError(
                f"body {tip!r} is not a descendant of {base!r}; allowed: a tip below the base in the model"
            )
        if body in joint_of_body:
            segments.insert(0, (joint_of_body[body], pos, q))
            pos, q = np.zeros(3), transforms.IDENTITY_QUATERNION
        elif model.body_jntnum[body]:
            raise ValueError(
                f"body {model.body(body).name!r} between {base!r} and {tip!r} has a joint that is not in the list "
                f"{tuple(joints)}; add this joint to the list"
            )
        pos, q = transforms.compose(model.body_pos[body], model.body_quat[body], pos, q)
        body = int(model.body_parentid[body])
    names = tuple(name for name, _, _ in segments)
    if names != tuple(joints):
        raise ValueError(
            f"the joints from {base!r} to {tip!r} are {names}, but {tuple(joints)} are given; list them in this order"
        )
    # A transform after a joint belongs to the link before the next joint; the last one leads to the tip.
    before = [(pos, q), *((p, r) for _, p, r in segments[:-1])]
    ranges = np.stack([_range(model, name) for name in joints])
    return Chain(
        body_pos=np.stack([p for p, _ in before]),
        body_quat=np.stack([r for _, r in before]),
        joint_axis=np.stack([model.joint(name).axis for name in joints]),
        tip_pos=segments[-1][1],
        tip_quat=segments[-1][2],
        lower_limit=ranges[:, 0],
        upper_limit=ranges[:, 1],
        slide_joints=frozenset(
            i for i, name in enumerate(joints) if model.joint(name).type[0] == SLIDE_JOINT_TYPE
        ),
    )


def compute_joint_scales(types: Sequence[int]) -> FloatArray:
    """Returns the unit of each joint's position (J,), from MuJoCo's joint types; see ``Chain.joint_scales``."""
    return np.where(np.equal(types, SLIDE_JOINT_TYPE), METRES_PER_RADIAN, 1.0)


def _range(model: mujoco.MjModel, joint: str) -> FloatArray:
    limited = model.jnt_limited[model.joint(joint).id]
    return model.joint(joint).range if limited else np.array([-np.inf, np.inf])


def forward_kinematics(chain: Chain, joint_positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns tip positions (N, 3) and quaternions (N, 4), w ≥ 0, in the base frame, at joint positions (N, J)."""
    poses = _poses(chain, move_batch_axis_last(joint_positions))
    return move_batch_axis_first(poses.tip), transforms.from_matrix(move_batch_axis_first(poses.columns))


def compute_jacobian(chain: Chain, joint_positions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns the pose and the geometric Jacobian of the tip in the base frame, at joint positions (N, J).

    Returns:
        Tip positions (N, 3), quaternions (N, 4) and Jacobian (N, 6, J). Rows 0–2 are translations, rows 3–5 rotations.
    """
    poses = _poses(chain, move_batch_axis_last(joint_positions))
    q = transforms.from_matrix(move_batch_axis_first(poses.columns))
    return move_batch_axis_first(poses.tip), q, move_batch_axis_first(_jacobian(poses))


def compute_action_jacobian(chain: Chain, joint_positions: FloatArray, *, drives: bool) -> FloatArray:
    """Returns the Jacobian (N, 6, A) of the tip in the frame of the robot's base, for speeds of joints and base.

    If ``drives`` is true, the last two columns belong to the base's motion along x and its rotation about z.
    """
    pos, _, j = compute_jacobian(chain, joint_positions)
    if not drives:
        return j
    base = np.zeros((len(pos), 6, 2))
    base[:, 0, 0] = base[:, 5, 1] = 1.0
    base[:, 0, 1], base[:, 1, 1] = -pos[:, 1], pos[:, 0]
    return np.concatenate([j, base], axis=-1)


def prepend_slide(chain: Chain, travel_m: float) -> Chain:
    """Returns the chain with a slide before its first joint.

    The slide moves the base by up to ± ``travel_m`` along its x axis.
    """
    return replace(
        chain,
        body_pos=np.concatenate([np.zeros((1, 3)), chain.body_pos]),
        body_quat=np.concatenate([transforms.IDENTITY_QUATERNION[None], chain.body_quat]),
        joint_axis=np.concatenate([[[1.0, 0.0, 0.0]], chain.joint_axis]),
        lower_limit=np.concatenate([[-travel_m], chain.lower_limit]),
        upper_limit=np.concatenate([[travel_m], chain.upper_limit]),
        slide_joints=frozenset({0, *(slide + 1 for slide in chain.slide_joints)}),
    )


def compute_max_reach_m(chain: Chain) -> float:
    """Returns an upper bound of the distance in metres between the tip and the first joint.

    If the first joint is a slide, it is at position zero.
    """
    travel = np.zeros((len(chain.body_pos), 2, 3))
    for slide in chain.slide_joints:
        travel[slide, :, 2] = chain.lower_limit[slide], chain.upper_limit[slide]
    offsets = (offset for offset, _ in chain.links[1:])
    return float(
        sum(transforms.norm(offset + ends).max() for offset, ends in zip(offsets, travel, strict=True))
    )


def wrap_angles(chain: Chain, joint_positions: FloatArray) -> FloatArray:
    """Returns joint positions (..., J) with the angles of continuous joints wrapped to ±π."""
    free = ~np.isfinite(chain.upper_limit)
    return np.where(free, np.mod(joint_positions + np.pi, 2.0 * np.pi) - np.pi, joint_positions)


JOINT_LIMIT_MARGIN_FRACTION = 0.05
"""Width of the zone near a joint limit in which weights decrease, as a share of half the joint range."""
MIN_JOINT_LIMIT_WEIGHT = 0.001
"""Minimum of the joint-limit weights. It applies to positions outside the joint range."""


def compute_joint_limit_weights(chain: Chain, joint_positions: FloatArray) -> FloatArray:
    """Returns joint-limit weights (N, J) at joint positions (N, J).

    The weight is 0.5 at a limit, almost 1 far from both limits, and 1 for continuous joints. With half range r and
    lower limit l, w = 1 − 0.5^((r − |r − q + l|) / (0.05 r) + 1). Outside the range the minimum is 0.001 (Kapusta and
    Kemp, "Task-centric optimization of configurations for assistive robots", Autonomous Robots 43, 2019).
    """
    limited = np.isfinite(chain.upper_limit)
    lower, upper = np.where(limited, chain.lower_limit, -1.0), np.where(limited, chain.upper_limit, 1.0)
    half = 0.5 * (upper - lower)
    margins = (half - np.abs(half - joint_positions + lower)) / (JOINT_LIMIT_MARGIN_FRACTION * half)
    # the minimum of 0.001 applies below this exponent; powers with lower exponents would overflow
    bounded = np.maximum(margins, -1.0)
    return np.where(
        limited, np.maximum(1.0 - elementary.power(0.5, bounded + 1.0), MIN_JOINT_LIMIT_WEIGHT), 1.0
    )


def compute_isotropy(chain: Chain, joint_positions: FloatArray) -> FloatArray:
    """Returns the joint-limit-weighted kinematic isotropy (N,) at joint positions (N, J).

    It is 0 at singularities and at most 1. For joint positions in ``Chain.joint_scales``, it is the geometric mean of
    the eigenvalues of J W Jᵀ, divided by their arithmetic mean: det(J W Jᵀ)^(1/6) / (trace(J W Jᵀ) / 6), W =
    diag(``compute_joint_limit_weights``). Source: Kapusta and Kemp (Autonomous Robots 43, 2019), after the kinematic
    isotropy of Kim and Khosla (IROS 1991).
    """
    j = _scaled_jacobian(_poses(chain, move_batch_axis_last(joint_positions)))
    square = weighted_gram_matrix(
        j, move_batch_axis_last(compute_joint_limit_weights(chain, joint_positions))
    )
    trace = reduce(np.add, diagonal(square))
    gaussian_elimination(square)
    determinant = reduce(np.multiply, np.maximum(diagonal(square), 0.0))
    return 6.0 * elementary.power(determinant, 1.0 / 6.0) / trace


@dataclass(frozen=True)
class IKSolution:
    """Result of the inverse kinematics.

    ``joint_positions`` (N, J), and the residual errors of position (N,) in metres and rotation (N,) in radians. Without
    a target rotation, the rotation error is 0.
    """

    joint_positions: FloatArray
    position_error_m: FloatArray
    rotation_error_rad: FloatArray


MAX_ITERATIONS = 50
MAX_IK_STEP_RAD = 0.5
METRES_PER_RADIAN = 0.3
"""Length that is equivalent to one radian of a rotation error or of a joint's motion."""
MAX_ROWS_PER_BATCH = 8192
"""Number of rows in one batch of computations. NumPy's call overhead is then small, and the data fit into the cache."""


def inverse_kinematics(
    chain: Chain,
    target_pos: FloatArray,
    target_q: FloatArray | None,
    start: FloatArray,
    *,
    iterations: int = MAX_ITERATIONS,
    tolerance: float = 1e-4,
    precision: DTypeLike = np.float64,
) -> IKSolution:
    """Returns a solution of the inverse kinematics, by damped least squares (Wampler, IEEE Trans. SMC 16(1), 1986).

    Solutions are within the joint ranges. The damping is proportional to the squared error (Sugihara, IEEE Trans.
    Robotics 27(5), 2011). A joint is excluded from a step that would move it beyond a limit. Projected Newton methods
    use the same rule (Bertsekas, SIAM J. Control and Optimization 20(2), 1982). A few iterations are enough to follow a
    moving target from the current positions.

    Args:
        chain: kinematic chain of the arm.
        target_pos: target positions of the tip (N, 3) in the base frame, metres.
        target_q: target rotations of the tip (N, 4) in the base frame, or None for any rotation.
        start: initial joint positions of the search (N, J).
        iterations: maximum number of steps. A step moves each joint by at most half of its ``Chain.joint_scales``.
        tolerance: the search of a row ends when its weighted error is at most this value, metres.
        precision: data type of the computation. ``numpy.float32`` takes half the time, with errors of at most 0.1 mm.
    """
    target, metres_per_radian = _target(target_pos, target_q)
    target, limits = (
        target.astype(precision),
        np.stack([chain.lower_limit, chain.upper_limit]).astype(precision),
    )
    angles = np.clip(move_batch_axis_last(start).astype(precision), *limits[..., None])
    units = chain.joint_scales[:, None].astype(precision)
    left, steps = np.empty((2, len(start))), np.zeros(len(start), dtype=int)
    rows, waiting = np.split(np.arange(len(start)), [MAX_ROWS_PER_BATCH])
    while len(rows):
        now = angles.take(rows, axis=-1)
        poses = _poses(chain, now)
        error = _error(poses, target.take(rows, axis=-1), metres_per_radian)
        left[:, rows] = norm(error[:3]), norm(error[3:])
        (going,) = np.nonzero((norm(error) > tolerance) & (steps[rows] < iterations))
        j, done = _scaled_jacobian(poses, metres_per_radian), len(rows) - len(going)
        if done:
            rows, (now, error, j) = rows[going], (each.take(going, axis=-1) for each in (now, error, j))
        angles[:, rows] = _step(now, limits[..., None], units, j, error)
        steps[rows] += 1
        rows, waiting = np.concatenate([rows, waiting[:done]]), waiting[done:]
    found = np.clip(move_batch_axis_first(angles), chain.lower_limit, chain.upper_limit)
    return IKSolution(found, left[0], left[1] / METRES_PER_RADIAN)


NUM_RESTARTS = 4
MAX_RESTART_OFFSET_RAD = 1.0
MAX_POSITION_ERROR_M, MAX_ROTATION_ERROR_RAD = 0.005, 0.05


def count_restart_random_numbers(joints: int) -> int:
    """Returns the number of uniform random numbers that the restarts of one arm with ``joints`` joints need."""
    return NUM_RESTARTS * joints


def inverse_kinematics_with_restarts(
    chain: Chain, target_pos: FloatArray, target_q: FloatArray, seed_pose: FloatArray, uniforms: FloatArray
) -> FloatArray:
    """Returns joint positions (N, J) for target positions (N, 3) and rotations (N, 4).

    The search starts at a seed pose (J,), then at random poses near the seed pose. In these poses each joint differs
    from the seed pose by at most one unit, see ``Chain.joint_scales``. Random numbers ``uniforms`` (N,
    ``count_restart_random_numbers(J)``) determine the random poses. The result of a row is the first solution with
    errors below 5 mm and 0.05 rad. Without such a solution, it is the solution with the smallest error. Continuous
    joints are wrapped to ±π.
    """
    best = inverse_kinematics(chain, target_pos, target_q, np.tile(seed_pose, (len(target_pos), 1)))
    for restart in range(NUM_RESTARTS):
        rows = np.nonzero(~is_accurate(best))[0]
        if not len(rows):
            break
        spread = uniforms[rows, restart * len(seed_pose) : (restart + 1) * len(seed_pose)]
        start = seed_pose + MAX_RESTART_OFFSET_RAD * chain.joint_scales * (2.0 * spread - 1.0)
        best = replace_worse_solutions(
            best, inverse_kinematics(chain, target_pos[rows], target_q[rows], start), rows
        )
    return wrap_angles(chain, best.joint_positions)


def is_accurate(solution: IKSolution) -> BoolArray:
    """Returns a boolean mask (N,) of the rows with errors below 5 mm and 0.05 rad."""
    return (solution.position_error_m < MAX_POSITION_ERROR_M) & (
        solution.rotation_error_rad < MAX_ROTATION_ERROR_RAD
    )


def replace_worse_solutions(old: IKSolution, new: IKSolution, rows: IntArray) -> IKSolution:
    """Returns the solutions ``old`` (N rows), improved by the solutions ``new``.

    A solution in ``new`` replaces its row in ``rows`` if its error is smaller.
    """
    cost = new.position_error_m + METRES_PER_RADIAN * new.rotation_error_rad
    old_cost = old.position_error_m[rows] + METRES_PER_RADIAN * old.rotation_error_rad[rows]
    improved = rows[cost < old_cost]
    merged = IKSolution(
        old.joint_positions.copy(), old.position_error_m.copy(), old.rotation_error_rad.copy()
    )
    for name in ("joint_positions", "position_error_m", "rotation_error_rad"):
        getattr(merged, name)[improved] = getattr(new, name)[cost < old_cost]
    return merged


# In the following functions, the row is the last axis.


@dataclass(frozen=True)
class _Poses:
    """Joint origins and axes (J, 3, N), tip position (3, N) and rotation columns (3, 3, N) in the base frame.

    ``slides`` are the indices of the joints that are slides.
    """

    origins: FloatArray
    axes: FloatArray
    tip: FloatArray
    columns: FloatArray
    slides: frozenset[int]


def _poses(chain: Chain, angles: FloatArray) -> _Poses:
    sine, cosine = elementary.sine_and_cosine(angles)
    pos = np.zeros((3, angles.shape[-1]), angles.dtype)
    columns: Sequence[FloatArray] | FloatArray = np.repeat(
        np.eye(3, dtype=angles.dtype)[..., None], angles.shape[-1], axis=-1
    )
    origins, axes = np.empty((2, len(angles), *pos.shape), angles.dtype)
    for i, (offset, rotation) in enumerate(chain.links[:-1]):
        origins[i] = pos = pos + weighted_sum(columns, offset)
        x, y, axes[i] = (weighted_sum(columns, column) for column in rotation)
        if i in chain.slide_joints:
            pos, columns = pos + angles[i] * axes[i], (x, y, axes[i])
        else:
            columns = (cosine[i] * x + sine[i] * y, cosine[i] * y - sine[i] * x, axes[i])
    offset, rotation = chain.links[-1]
    tip = pos + weighted_sum(columns, offset)
    turned = np.stack([weighted_sum(columns, column) for column in rotation])
    return _Poses(origins, axes, tip, turned, chain.slide_joints)


def _jacobian(poses: _Poses, metres_per_radian: float = 1.0) -> FloatArray:
    """Returns the J columns of the Jacobian, (J, 6, N). Components 3–5 are multiplied by ``metres_per_radian``."""
    j = np.empty((len(poses.axes), 6, poses.tip.shape[-1]), poses.tip.dtype)
    j[:, :3] = cross(poses.axes, poses.tip - poses.origins)
    np.multiply(metres_per_radian, poses.axes, out=j[:, 3:])
    for slide in poses.slides:
        j[slide, :3], j[slide, 3:] = poses.axes[slide], 0.0
    return j


def _scaled_jacobian(poses: _Poses, metres_per_radian: float = 1.0) -> FloatArray:
    """Returns the result of ``_jacobian`` for joint positions in ``Chain.joint_scales``."""
    j = _jacobian(poses, metres_per_radian)
    for slide in poses.slides:
        j[slide] *= METRES_PER_RADIAN
    return j


def _target(pos: FloatArray, q: FloatArray | None) -> tuple[FloatArray, float]:
    """Returns the target as position and rotation columns (4, 3, N), and the rotation weight in metres per radian."""
    place = move_batch_axis_last(pos)[None]
    if q is None:
        return np.concatenate([place, np.repeat(np.eye(3)[..., None], len(pos), axis=-1)]), 0.0
    return np.concatenate([place, move_batch_axis_last(transforms.to_matrix(q))]), METRES_PER_RADIAN


def _error(poses: _Poses, target: FloatArray, metres_per_radian: float) -> FloatArray:
    turn = metres_per_radian * rotation_between(poses.columns, target[1:])
    return np.concatenate([target[0] - poses.tip, turn])


DAMPING_PER_SQUARED_ERROR = 0.3
MIN_DAMPING_M2 = 1e-5


def _step(
    angles: FloatArray, limits: FloatArray, units: FloatArray, j: FloatArray, error: FloatArray
) -> FloatArray:
    """Returns joint positions (J, N) after the step W Jᵀ (J W Jᵀ + damping)⁻¹ error. W is diag(``_free``)."""
    free = _free(angles, limits, _times_error(j, error))
    system = np.concatenate([weighted_gram_matrix(j, free), error[:, None]], axis=1)
    diagonal(system)[...] += DAMPING_PER_SQUARED_ERROR * norm(error) ** 2 + MIN_DAMPING_M2
    step = free * _times_error(j, solve_linear(system))
    step *= np.minimum(1.0, MAX_IK_STEP_RAD / np.maximum(np.abs(step).max(axis=0), MIN_DIVISOR))
    return np.clip(angles + units * step, *limits)


def _free(angles: FloatArray, limits: FloatArray, pull: FloatArray) -> FloatArray:
    """Returns weights (J, N): 0 for joints at a limit if ``pull`` would move them beyond it, otherwise 1."""
    lower, upper = limits
    stuck = ((angles <= lower) & (pull < 0.0)) | ((angles >= upper) & (pull > 0.0))
    return (~stuck).astype(pull.dtype)


def _times_error(j: FloatArray, error: FloatArray) -> FloatArray:
    """Returns the product of the transposed Jacobian and the error, Jᵀ e, (J, N)."""
    return reduce(np.add, (j[:, i] * error[i] for i in range(6)))
