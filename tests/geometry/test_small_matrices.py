import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import small_matrices, transforms

COUNT = 200


def positive_definite(rng: np.random.Generator) -> np.ndarray:
    """Random matrices A W Aᵀ (N, 6, 6), made by NumPy, of the columns and weights returned rows last."""
    columns, weights = rng.standard_normal((7, 6, COUNT)), rng.uniform(0.1, 1.0, (7, COUNT))
    by_numpy = np.einsum("kn,kin,kjn->nij", weights, columns, columns)
    assert_allclose(
        small_matrices.weighted_gram_matrix(columns, weights).transpose(2, 0, 1), by_numpy, rtol=1e-9
    )
    return by_numpy


def test_equations_are_solved(rng):
    square, right = positive_definite(rng), rng.standard_normal((COUNT, 6))
    system = np.concatenate([square, right[..., None]], axis=-1).transpose(1, 2, 0)
    x = small_matrices.solve_linear(np.ascontiguousarray(system)).T
    assert_allclose(np.einsum("nij,nj->ni", square, x), right, atol=1e-9)


def test_elimination_leaves_the_determinant_on_the_diagonal(rng):
    square = positive_definite(rng)
    system = square.transpose(1, 2, 0).copy()
    small_matrices.gaussian_elimination(system)
    assert_allclose(np.prod(small_matrices.diagonal(system), axis=0), np.linalg.det(square), rtol=1e-9)


def test_a_matrix_of_zeros_is_eliminated():
    system = np.zeros((6, 6, 3))
    small_matrices.gaussian_elimination(system)
    assert_array_equal(system, 0.0)


def test_rows_are_turned_to_the_end_and_back(rng):
    q = transforms.normalize(rng.standard_normal((COUNT, 4)))
    matrix = transforms.to_matrix(q)
    columns = small_matrices.move_batch_axis_last(matrix)
    assert_array_equal(columns[0].T, matrix[:, :, 0])
    assert_array_equal(small_matrices.move_batch_axis_first(columns), matrix)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 0.5, 2.0, 3.0, np.pi - 0.05, np.pi - 1e-4, np.pi - 1e-9])
def test_the_rotation_between_rotations(rng, angle_rad):
    q = transforms.normalize(rng.standard_normal((COUNT, 4)))
    vector = angle_rad * transforms.normalize(rng.standard_normal((COUNT, 3)))
    target = transforms.multiply(transforms.from_rotation_vector(vector), q)
    columns = (small_matrices.move_batch_axis_last(transforms.to_matrix(r)) for r in (q, target))
    assert_allclose(small_matrices.rotation_between(*columns).T, vector, atol=1e-7)


def test_half_a_turn_between_rotations_has_one_of_two_axes(rng):
    q = transforms.normalize(rng.standard_normal((COUNT, 4)))
    vector = np.pi * transforms.normalize(rng.standard_normal((COUNT, 3)))
    target = transforms.multiply(transforms.from_rotation_vector(vector), q)
    columns = (small_matrices.move_batch_axis_last(transforms.to_matrix(r)) for r in (q, target))
    found = small_matrices.rotation_between(*columns).T
    assert_allclose(np.abs(np.einsum("ni,ni->n", found, vector)), np.pi**2, rtol=1e-7)
