"""Small vectors and matrices for many rows.

The row is the last axis, (..., N): operations then use contiguous memory. A row's result does not depend on other rows,
bit for bit.
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms

MIN_DIVISOR = 1e-30
"""Minimum divisor. It replaces zero and smaller positive divisors."""


def move_batch_axis_last(move_batch_axis_first: FloatArray) -> FloatArray:
    """Returns an array (N, ...) with reversed axes, (..., N). The result is contiguous; matrices become transposed."""
    return np.ascontiguousarray(move_batch_axis_first.T)


def move_batch_axis_first(move_batch_axis_last: FloatArray) -> FloatArray:
    """Returns an array (..., N) with reversed axes, (N, ...). The result is contiguous; matrices become transposed."""
    return np.ascontiguousarray(move_batch_axis_last.T)


def norm(v: FloatArray) -> FloatArray:
    """Returns the length (N,) of vectors (k, N)."""
    return np.sqrt(reduce(np.add, v * v))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the cross products (K, 3, N) of vectors (K, 3, N)."""
    out = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.subtract(a[:, j] * b[:, k], a[:, k] * b[:, j], out=out[:, i])
    return out


def weighted_sum(columns: Sequence[FloatArray] | FloatArray, factors: Sequence[float]) -> FloatArray:
    """Returns the sum of three columns, weighted by factors (3,)."""
    terms = [c if f == 1.0 else f * c for c, f in zip(columns, factors, strict=True) if f != 0.0]
    return reduce(np.add, terms) if terms else np.zeros_like(columns[0])


def weighted_gram_matrix(matrix: FloatArray, weights: FloatArray) -> FloatArray:
    """Returns A W Aᵀ (6, 6, N).

    ``matrix`` contains the K columns of A (K, 6, N), ``weights`` the diagonal of W (K, N).
    """
    square = np.zeros((6, 6, matrix.shape[-1]), matrix.dtype)
    for column, weight in zip(matrix, weights, strict=True):
        square += (weight * column)[:, None] * column
    return square


def diagonal(matrix: FloatArray) -> FloatArray:
    """Returns a view of the diagonal (6, N) of matrices (6, 6 or more, N)."""
    return np.einsum("iin->in", matrix[:, :6])


def gaussian_elimination(system: FloatArray) -> None:
    """Apply Gaussian elimination in place to matrices (6, 6 or more, N).

    The first six columns must be positive semidefinite. No pivoting is needed. After the elimination, the determinant
    is the product of the diagonal.
    """
    for k in range(5):
        factor = system[k + 1 :, k] / np.maximum(system[k, k], MIN_DIVISOR)
        system[k + 1 :, k + 1 :] -= factor[:, None] * system[k, k + 1 :]


def solve_linear(system: FloatArray) -> FloatArray:
    """Returns the solution (6, N) of linear equations (6, 7, N). The last column is the right-hand side.

    The function changes ``system``.
    """
    gaussian_elimination(system)
    x = system[:, 6]
    for k in range(5, -1, -1):
        x[k] /= system[k, k]
        x[:k] -= system[:k, k] * x[k]
    return x


def rotation_between(columns: FloatArray, target: FloatArray) -> FloatArray:
    """Returns the rotation vector (3, N) from a rotation to a target rotation, given by their columns (3, 3, N)."""
    sine = 0.5 * reduce(np.add, cross(columns, target))
    cosine = 0.5 * (reduce(np.add, reduce(np.add, columns * target)) - 1.0)
    length = norm(sine)
    turn = sine * (elementary.arctan2(length, cosine) / np.maximum(length, MIN_DIVISOR))
    opposite = np.nonzero(cosine < -0.999)[0]  # here the sine is too small to determine the axis
    if len(opposite):
        turn[:, opposite] = _rotation_by_quaternions(columns[..., opposite], target[..., opposite])
    return turn


def _rotation_by_quaternions(columns: FloatArray, target: FloatArray) -> FloatArray:
    q, target_q = (transforms.from_matrix(move_batch_axis_first(m)) for m in (columns, target))
    return move_batch_axis_last(
        transforms.to_rotation_vector(transforms.multiply(target_q, transforms.conjugate(q)))
    )
