"""Small vectors and matrices for many rows at once.

Rows come last, (..., N), so that every operation runs along contiguous memory. Rows meet only element-wise
operations: a row's result has the same bits alone and among others.
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms

TINY = 1e-30
"""Stands in for a divisor of zero."""


def rows_last(rows_first: FloatArray) -> FloatArray:
    """(N, ...) to (..., N), the axes reversed: a matrix becomes its columns."""
    return np.ascontiguousarray(rows_first.T)


def rows_first(rows_last: FloatArray) -> FloatArray:
    """(..., N) to (N, ...), the axes reversed: columns become their matrix."""
    return np.ascontiguousarray(rows_last.T)


def norm(v: FloatArray) -> FloatArray:
    """The length (N,) of vectors (k, N)."""
    return np.sqrt(reduce(np.add, v * v))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """The cross products of vectors (K, 3, N)."""
    out = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.subtract(a[:, j] * b[:, k], a[:, k] * b[:, j], out=out[:, i])
    return out


def combined(columns: Sequence[FloatArray] | FloatArray, factors: Sequence[float]) -> FloatArray:
    """The sum of three columns, arrays of one shape, times the factors (3,); a factor of 0 or 1 costs nothing."""
    terms = [c if f == 1.0 else f * c for c, f in zip(columns, factors, strict=True) if f != 0.0]
    return reduce(np.add, terms) if terms else np.zeros_like(columns[0])


def weighted_square(matrix: FloatArray, weights: FloatArray) -> FloatArray:
    """A W Aᵀ (6, 6, N) for a matrix A given as its K columns, (K, 6, N), and weights (K, N)."""
    square = np.zeros((6, 6, matrix.shape[-1]), matrix.dtype)
    for column, weight in zip(matrix, weights, strict=True):
        square += (weight * column)[:, None] * column
    return square


def diagonal(matrix: FloatArray) -> FloatArray:
    """The diagonal (6, N) of (6, 6 or more, N), as a view."""
    return np.einsum("iin->in", matrix[:, :6])


def eliminate(system: FloatArray) -> None:
    """Gauss's elimination in place of (6, 6 or more, N), whose first six columns are positive semidefinite.

    Such a matrix needs no pivoting. Its determinant is then the product of its diagonal.
    """
    for k in range(5):
        factor = system[k + 1 :, k] / np.maximum(system[k, k], TINY)
        system[k + 1 :, k + 1 :] -= factor[:, None] * system[k, k + 1 :]


def solved(system: FloatArray) -> FloatArray:
    """The solution (6, N) of the linear equations (6, 7, N), whose last column is the right side."""
    eliminate(system)
    x = system[:, 6]
    for k in range(5, -1, -1):
        x[k] /= system[k, k]
        x[:k] -= system[:k, k] * x[k]
    return x


def rotation_between(columns: FloatArray, target: FloatArray) -> FloatArray:
    """The rotation vector (3, N) that takes a rotation, (3, 3, N) as its three columns, to the target."""
    sine = 0.5 * reduce(np.add, cross(columns, target))
    cosine = 0.5 * (reduce(np.add, reduce(np.add, columns * target)) - 1.0)
    length = norm(sine)
    turn = sine * (elementary.arctan2(length, cosine) / np.maximum(length, TINY))
    opposite = np.nonzero(cosine < -0.999)[0]  # where the sine says little about the axis
    if len(opposite):
        turn[:, opposite] = _rotation_by_quaternions(columns[..., opposite], target[..., opposite])
    return turn


def _rotation_by_quaternions(columns: FloatArray, target: FloatArray) -> FloatArray:
    q, target_q = (transforms.from_matrix(rows_first(m)) for m in (columns, target))
    return rows_last(transforms.to_rotation_vector(transforms.multiply(target_q, transforms.conjugate(q))))
