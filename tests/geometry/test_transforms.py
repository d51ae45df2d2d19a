import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.geometry import transforms
from avrgym.geometry.transforms import compose, conjugate, invert, multiply, rotate

COUNT = 1000
X, Y, Z = np.eye(3)


def rotations(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return transforms.normalize(rng.standard_normal((*(shape or (COUNT,)), 4)))


def positions(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-2, 2, (COUNT, 3))


def assert_same_rotation(a: np.ndarray, b: np.ndarray, atol: float = 1e-12) -> None:
    expected = np.broadcast_to(transforms.to_matrix(b), (*np.shape(a)[:-1], 3, 3))
    assert_allclose(transforms.to_matrix(a), expected, atol=atol)


# Rotations


def test_the_product_is_the_product_of_matrices(rng):
    a, b = rotations(rng), rotations(rng)
    assert_allclose(
        transforms.to_matrix(multiply(a, b)), transforms.to_matrix(a) @ transforms.to_matrix(b), atol=1e-12
    )


def test_the_product_is_associative(rng):
    a, b, c = rotations(rng), rotations(rng), rotations(rng)
    assert_allclose(multiply(multiply(a, b), c), multiply(a, multiply(b, c)), atol=1e-12)


def test_the_inverse_undoes(rng):
    q, v = rotations(rng), positions(rng)
    assert_same_rotation(multiply(q, conjugate(q)), transforms.IDENTITY_QUATERNION)
    assert_allclose(rotate(conjugate(q), rotate(q, v)), v, atol=1e-12)


def test_rotating_is_what_the_matrix_does(rng):
    q, v = rotations(rng), positions(rng)
    assert_allclose(rotate(q, v), (transforms.to_matrix(q) @ v[..., None])[..., 0], atol=1e-12)


def test_rotating_keeps_lengths_and_angles(rng):
    q, v, w = rotations(rng), positions(rng), positions(rng)
    assert_allclose(np.linalg.norm(rotate(q, v), axis=-1), np.linalg.norm(v, axis=-1))
    assert_allclose((rotate(q, v) * rotate(q, w)).sum(-1), (v * w).sum(-1), atol=1e-12)


@pytest.mark.parametrize(("axis", "takes", "to"), [(X, Y, Z), (Y, Z, X), (Z, X, Y)])
def test_a_quarter_turn_follows_the_right_hand(axis, takes, to):
    assert_allclose(rotate(transforms.from_axis_angle(axis, np.pi / 2), takes), to, atol=1e-15)


# Matrices


def test_matrix_and_back(rng):
    q = rotations(rng)
    assert_same_rotation(transforms.from_matrix(transforms.to_matrix(q)), q)
    assert (transforms.from_matrix(transforms.to_matrix(q))[:, 0] >= 0).all()


@pytest.mark.parametrize("axis", [X, Y, Z, -X, transforms.normalize([1.0, 1.0, 1.0])])
@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi / 2, np.pi - 1e-9, np.pi])
def test_matrices_of_small_and_half_turns_come_back(axis, angle):
    q = transforms.from_axis_angle(axis, angle)
    assert_same_rotation(transforms.from_matrix(transforms.to_matrix(q)), q)


# Rotation vectors


def test_logarithm_and_back(rng):
    v = transforms.normalize(positions(rng)) * rng.uniform(0, np.pi, (COUNT, 1))
    assert_allclose(transforms.to_rotation_vector(transforms.from_rotation_vector(v)), v, atol=1e-9)


def test_exponential_and_back(rng):
    q = rotations(rng)
    assert_same_rotation(transforms.from_rotation_vector(transforms.to_rotation_vector(q)), q)
    assert (np.linalg.norm(transforms.to_rotation_vector(q), axis=-1) <= np.pi).all()


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-15, 1e-9, 1e-4])
def test_small_rotation_vectors_keep_their_precision(size):
    v = size * np.array([0.6, -0.8, 0.0])
    assert_allclose(
        transforms.to_rotation_vector(transforms.from_rotation_vector(v)), v, rtol=1e-6, atol=1e-300
    )


def test_the_angle_between_is_symmetric_and_signless(rng):
    a, b = rotations(rng), rotations(rng)
    angle = transforms.angle_between(a, b)
    assert_allclose(angle, transforms.angle_between(b, a), atol=1e-9)
    assert_allclose(angle, transforms.angle_between(a, -b), atol=1e-9)
    assert_allclose(transforms.angle_between(a, a), 0, atol=1e-7)


# Poses


def test_the_inverse_of_the_inverse_is_the_pose(rng):
    p, q = positions(rng), rotations(rng)
    back_p, back_q = invert(*invert(p, q))
    assert_allclose(back_p, p, atol=1e-12)
    assert_allclose(back_q, q, atol=1e-15)


def test_a_pose_and_its_inverse_compose_to_nothing(rng):
    p, q = positions(rng), rotations(rng)
    nowhere, still = compose(p, q, *invert(p, q))
    assert_allclose(nowhere, 0, atol=1e-12)
    assert_same_rotation(still, transforms.IDENTITY_QUATERNION)


def test_composing_is_associative(rng):
    a, b, c = ((positions(rng), rotations(rng)) for _ in range(3))
    left, right = compose(*compose(*a, *b), *c), compose(*a, *compose(*b, *c))
    assert_allclose(left[0], right[0], atol=1e-12)
    assert_allclose(left[1], right[1], atol=1e-12)


# Angles about x, y, z


def recomposed(angles: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(angles, -1, 0)
    turn = transforms.from_axis_angle
    return multiply(multiply(turn(X, a), turn(Y, b)), turn(Z, c))


def test_euler_angles_recompose(rng):
    q = rotations(rng)
    assert_same_rotation(recomposed(transforms.to_euler_xyz(q)), q)


def test_euler_angles_come_back(rng):
    angles = rng.uniform([-np.pi, -1.5, -np.pi], [np.pi, 1.5, np.pi], (COUNT, 3))
    assert_allclose(transforms.to_euler_xyz(recomposed(angles)), angles, atol=1e-9)


@pytest.mark.parametrize("b", [np.pi / 2, -np.pi / 2])
def test_euler_angles_recompose_in_gimbal_lock(rng, b):
    angles = rng.uniform(-np.pi, np.pi, (COUNT, 3))
    angles[:, 1] = b
    found = transforms.to_euler_xyz(recomposed(angles))
    assert_same_rotation(recomposed(found), recomposed(angles))
    assert (found[:, 2] == 0).all()


@pytest.mark.parametrize("offset", [1e-3, 1e-5, 1e-6, 1e-7, 1e-9])
def test_euler_angles_recompose_near_gimbal_lock(rng, offset):
    angles = rng.uniform(-np.pi, np.pi, (COUNT, 3))
    angles[:, 1] = np.pi / 2 - offset
    assert_same_rotation(
        recomposed(transforms.to_euler_xyz(recomposed(angles))), recomposed(angles), atol=2e-9
    )


# Shapes


def test_every_function_broadcasts(rng):
    q, v = rotations(rng, 5, 1), rng.standard_normal((3, 3))
    assert rotate(q, v).shape == (5, 3, 3)
    assert multiply(q, rotations(rng, 3)).shape == (5, 3, 4)
    assert compose(v, q, v, q)[0].shape == (5, 3, 3)
    assert transforms.to_matrix(q).shape == (5, 1, 3, 3)
    assert transforms.from_matrix(transforms.to_matrix(q)).shape == (5, 1, 4)
    assert transforms.to_euler_xyz(q).shape == transforms.to_rotation_vector(q).shape == (5, 1, 3)
    assert transforms.angle_between(q, rotations(rng, 3)).shape == (5, 3)
    assert transforms.from_axis_angle(Z, np.zeros((5, 3))).shape == (5, 3, 4)
    assert_allclose(rotate(q, v)[2, 1], rotate(q[2, 0], v[1]), atol=1e-15)
