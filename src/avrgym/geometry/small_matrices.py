"""Small vectors and matrices for many rows.

Rows are last, (..., N), so that operations run along contiguous memory. All operations are element-wise over rows: a
row's result has the same bits alone and among others.
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms

TINY = 1e-30
"""Divisor that replaces zero."""


def rows_last(rows_first: FloatArray) -> FloatArray:
    """Reverse the axes of an array (N, ...): rows come last, and a matrix becomes its columns."""
    return np.ascontiguousarray(rows_first.T)


def rows_first(rows_last: FloatArray) -> FloatArray:
    """Reverse the axes of an array (..., N): rows come first, and columns become their matrix."""
    return np.ascontiguousarray(rows_last.T)


def norm(v: FloatArray) -> FloatArray:
    """Length (N,) of vectors (k, N)."""
    return np.sqrt(reduce(np.add, v * v))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products of vectors (K, 3, N)."""
    out = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.subtract(a[:, j] * b[:, k], a[:, k] * b[:, j], out=out[:, i])
    return out


def weighted_sum(columns: Sequence[FloatArray] | FloatArray, factors: Sequence[float]) -> FloatArray:
    """Weighted sum of three columns with factors (3,); factors 0 and 1 need no multiplication."""
    terms = [c if f == 1.0 else f * c for c, f in zip(columns, factors, strict=True) if f != 0.0]
    return reduce(np.add, terms) if terms else np.zeros_like(columns[0])


def weighted_square(matrix: FloatArray, weights: FloatArray) -> FloatArray:
    """The product A W Aᵀ (6, 6, N), given the K columns (K, 6, N) of A and the diagonal (K, N) of W."""
    square = np.zeros((6, 6, matrix.shape[-1]), matrix.dtype)
    for column, weight in zip(matrix, weights, strict=True):
        square += (weight * column)[:, None] * column
    return square


def diagonal(matrix: FloatArray) -> FloatArray:
    """The diagonal (6, N) of matrices (6, 6 or more, N), as a view."""
    return np.einsum("iin->in", matrix[:, :6])


def gaussian_elimination(system: FloatArray) -> None:
    """Gaussian elimination, in place, of matrices (6, 6 or more, N) whose first six columns are positive semidefinite.

    These need no pivoting. After the elimination the determinant is the product of the diagonal.
    """
    for k in range(5):
        factor = system[k + 1 :, k] / np.maximum(system[k, k], TINY)
        system[k + 1 :, k + 1 :] -= factor[:, None] * system[k, k + 1 :]


def solve_linear(system: FloatArray) -> FloatArray:
    """Solution (6, N) of linear equations (6, 7, N) with the right side in the last column."""
    gaussian_elimination(system)
    x = system[:, 6]
    for k in range(5, -1, -1):
        x[k] /= system[k, k]
        x[:k] -= system[:k, k] * x[k]
    return x


def rotation_between(columns: FloatArray, target: FloatArray) -> FloatArray:
    """Rotation vector (3, N) from a rotation, given by its columns (3, 3, N), to the target."""
    sine = 0.5 * reduce(np.add, cross(columns, target))
    cosine = 0.5 * (reduce(np.add, reduce(np.add, columns * target)) - 1.0)
    length = norm(sine)
    turn = sine * (elementary.arctan2(length, cosine) / np.maximum(length, TINY))
    opposite = np.nonzero(cosine < -0.999)[0]  # here the sine is too small to determine the axis
    if len(opposite):
        turn[:, opposite] = _rotation_by_quaternions(columns[..., opposite], target[..., opposite])
    return turn


def _rotation_by_quaternions(columns: FloatArray, target: FloatArray) -> FloatArray:
    q, target_q = (transforms.from_matrix(rows_first(m)) for m in (columns, target))
    return rows_last(transforms.to_rotation_vector(transforms.multiply(target_q, transforms.conjugate(q))))
