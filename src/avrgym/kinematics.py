"""Kinematics of a chain of hinges for many poses at once: forward, Jacobian, damped least squares.

Rows are independent: a row's result has the same bits alone and among others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym import transforms

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Chain:
    """J hinges from a base frame to a tip frame.

    ``pos`` (J, 3) and ``q`` (J, 4) place each hinge's body in the one before it at angle zero, the first in
    the base; ``axis`` (J, 3) is in that body; ``tip_pos`` (3,), ``tip_q`` (4,) place the tip in the last
    body. ``lower_rad``, ``upper_rad`` (J,) are the ranges.
    """

    pos: Array
    q: Array
    axis: Array
    tip_pos: Array
    tip_q: Array
    lower_rad: Array
    upper_rad: Array


def chain_of(model: mujoco.MjModel, joints: Sequence[str], base: str, tip: str) -> Chain:
    """Read a chain from a model: ``base`` is the body whose frame is the base frame, ``tip`` the last body.

    Between two hinges there may be any number of welded bodies.

    Raises:
        ValueError: when the joints do not lie on the way from tip to base, one per body and in this order.
    """
    hinge_of_body = {int(model.joint(name).bodyid[0]): name for name in joints}
    base_id, body = model.body(base).id, model.body(tip).id
    pos, q = np.zeros(3), transforms.IDENTITY_QUATERNION
    segments: list[tuple[str, Array, Array]] = []
    while body != base_id:
        if body == 0:
            raise ValueError(f"body {tip!r} is not carried by {base!r}")
        if body in hinge_of_body:
            segments.insert(0, (hinge_of_body[body], pos, q))
            pos, q = np.zeros(3), transforms.IDENTITY_QUATERNION
        pos, q = transforms.compose(model.body_pos[body], model.body_quat[body], pos, q)
        body = int(model.body_parentid[body])
    names = tuple(name for name, _, _ in segments)
    if names != tuple(joints):
        raise ValueError(f"the hinges from {base!r} to {tip!r} are {names}, not {tuple(joints)}")
    # What was gathered after a hinge belongs before the next one; the last piece is the tip.
    before = [(pos, q), *((p, r) for _, p, r in segments[:-1])]
    ranges = np.stack([model.joint(name).range for name in joints])
    return Chain(
        pos=np.stack([p for p, _ in before]),
        q=np.stack([r for _, r in before]),
        axis=np.stack([model.joint(name).axis for name in joints]),
        tip_pos=segments[-1][1],
        tip_q=segments[-1][2],
        lower_rad=ranges[:, 0],
        upper_rad=ranges[:, 1],
    )


def forward(chain: Chain, angles_rad: Array) -> tuple[Array, Array]:
    """The tip's pose in the base frame for angles (N, J): positions (N, 3) and quaternions (N, 4)."""
    pos, q, _, _ = _frames(chain, angles_rad)
    return pos, q


def jacobian(chain: Chain, angles_rad: Array) -> tuple[Array, Array, Array]:
    """The tip's pose and its geometric Jacobian in the base frame.

    Returns:
        positions (N, 3), quaternions (N, 4) and J (N, 6, J): rows 0–2 m/rad, rows 3–5 rad/rad.
    """
    pos, q, origins, axes = _frames(chain, angles_rad)
    linear = transforms.cross(axes, pos[:, None] - origins)
    return pos, q, np.concatenate([linear, axes], axis=-1).swapaxes(-1, -2)


def _frames(chain: Chain, angles_rad: Array) -> tuple[Array, Array, Array, Array]:
    count = len(angles_rad)
    pos, q = np.zeros((count, 3)), np.tile(transforms.IDENTITY_QUATERNION, (count, 1))
    origins, axes = [], []
    for i in range(len(chain.pos)):
        pos, q = transforms.compose(pos, q, chain.pos[i], chain.q[i])
        origins.append(pos)
        axes.append(transforms.rotate(q, chain.axis[i]))
        q = transforms.multiply(q, transforms.from_axis_angle(chain.axis[i], angles_rad[:, i]))
    pos, q = transforms.compose(pos, q, chain.tip_pos, chain.tip_q)
    return pos, q, np.stack(origins, axis=1), np.stack(axes, axis=1)


@dataclass(frozen=True)
class Solution:
    """Angles (N, J) and what is left of the error: metres (N,) and radians (N,)."""

    angles_rad: Array
    position_error_m: Array
    rotation_error_rad: Array


DAMPING = 0.05
MAX_TURN_RAD = 0.3
METRES_PER_RADIAN = 0.3
"""An error of one radian weighs as much as 0.3 m."""


def solve(
    chain: Chain,
    target_pos: Array,
    target_q: Array,
    start_rad: Array,
    *,
    iterations: int = 100,
    tolerance: float = 1e-4,
) -> Solution:
    """Inverse kinematics by damped least squares (Wampler, IEEE Trans. SMC 16(1), 1986), within the ranges.

    Args:
        chain: the arm.
        target_pos: (N, 3) in the base frame, metres.
        target_q: (N, 4).
        start_rad: (N, J), the angles to start from.
        iterations: how many steps at most.
        tolerance: a row stops moving when its weighted error is below this many metres.
    """
    angles = np.clip(start_rad, chain.lower_rad, chain.upper_rad)
    weight = np.array([1.0, 1.0, 1.0, METRES_PER_RADIAN, METRES_PER_RADIAN, METRES_PER_RADIAN])
    for _ in range(iterations):
        pos, q, j = jacobian(chain, angles)
        error = np.concatenate([target_pos - pos, _turn(q, target_q)], axis=-1) * weight
        moving = np.sqrt((error * error).sum(axis=-1)) > tolerance
        if not moving.any():
            break
        step = _damped_step(j * weight[:, None], error)
        step *= np.minimum(1.0, MAX_TURN_RAD / np.maximum(np.abs(step).max(axis=-1, keepdims=True), 1e-12))
        angles = np.clip(angles + np.where(moving[:, None], step, 0.0), chain.lower_rad, chain.upper_rad)
    pos, q = forward(chain, angles)
    turn = _turn(q, target_q)
    return Solution(
        angles, np.sqrt(((target_pos - pos) ** 2).sum(axis=-1)), np.sqrt((turn * turn).sum(axis=-1))
    )


RESTARTS = 4
RESTART_UNIFORMS = 7 * RESTARTS
RESTART_SPREAD_RAD = 1.0
ACCURACY_M, ACCURACY_RAD = 0.005, 0.05


def solve_with_restarts(
    chain: Chain, target_pos: Array, target_q: Array, seed_rad: Array, uniforms: Array
) -> Array:
    """Angles (N, J) for targets (N, 3), (N, 4): from one seed pose (J,), then from poses up to 1 rad around
    it.

    A row keeps the first solution within 5 mm and 0.05 rad, else the one that comes closest. ``uniforms``
    (N, ``RESTART_UNIFORMS``) draw the restarts.
    """
    best = solve(chain, target_pos, target_q, np.tile(seed_rad, (len(target_pos), 1)))
    for restart in range(RESTARTS):
        rows = np.nonzero(~_accurate(best))[0]
        if not len(rows):
            break
        spread = uniforms[rows, 7 * restart : 7 * restart + len(seed_rad)]
        start = seed_rad + RESTART_SPREAD_RAD * (2.0 * spread - 1.0)
        best = _better(best, solve(chain, target_pos[rows], target_q[rows], start), rows)
    return best.angles_rad


def _accurate(solution: Solution) -> NDArray[np.bool_]:
    return (solution.position_error_m < ACCURACY_M) & (solution.rotation_error_rad < ACCURACY_RAD)


def _better(old: Solution, new: Solution, rows: NDArray[np.intp]) -> Solution:
    cost = new.position_error_m + METRES_PER_RADIAN * new.rotation_error_rad
    old_cost = old.position_error_m[rows] + METRES_PER_RADIAN * old.rotation_error_rad[rows]
    improved = rows[cost < old_cost]
    merged = Solution(old.angles_rad.copy(), old.position_error_m.copy(), old.rotation_error_rad.copy())
    for name in ("angles_rad", "position_error_m", "rotation_error_rad"):
        getattr(merged, name)[improved] = getattr(new, name)[cost < old_cost]
    return merged


def _turn(q: Array, target_q: Array) -> Array:
    """The rotation vector (N, 3), base frame, that takes q to the target."""
    return transforms.to_rotation_vector(transforms.multiply(target_q, transforms.conjugate(q)))


def _damped_step(j: Array, error: Array) -> Array:
    transpose = j.swapaxes(-1, -2)
    square = j @ transpose + DAMPING**2 * np.eye(6)
    return (transpose @ np.linalg.solve(square, error[..., None]))[..., 0]
