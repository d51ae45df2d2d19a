from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import kinematics, transforms
from avrgym.models.robot import build_robot_spec
from avrgym.models.scene import build_robot_with_tool_spec
from avrgym.models.tools import TOOL_BODY as TOOL_BODY
from avrgym.robots.jaco.robot import JACO
from avrgym.tasks.placement import make_arm_chain
from helpers.robots import jaco_xacro

COUNT = 1000


@pytest.fixture(scope="module")
def arm(feeding_scene) -> kinematics.Chain:
    """From the Jaco's base to the spoon."""
    return make_arm_chain(feeding_scene)


@pytest.fixture(scope="module")
def hand() -> kinematics.Chain:
    """From the Jaco's base to its end effector."""
    model = build_robot_spec(JACO, JACO.arms["right"], appearance=False).compile()
    return kinematics.extract_chain(
        model, JACO.arms["right"].joints, JACO.base, JACO.arms["right"].end_effector
    )


@pytest.fixture(scope="module")
def any_chain() -> tuple[mujoco.MjModel, kinematics.Chain]:
    """Eight hinges about axes of any direction, every second one without a range, welded bodies between."""
    rng, spec = np.random.default_rng(4), mujoco.MjSpec()
    spec.compiler.degree = False
    body = spec.worldbody
    for i in range(8):
        body = body.add_body(pos=rng.uniform(-0.2, 0.2, 3), quat=transforms.normalize(rng.standard_normal(4)))
        body = body.add_body(name=f"body_{i}", pos=rng.uniform(-0.2, 0.2, 3), quat=rng.standard_normal(4))
        axis = transforms.normalize(rng.standard_normal(3))
        body.add_joint(name=f"hinge_{i}", axis=axis, range=[-2, 1], limited=i % 2)
        body.add_geom(size=[0.01, 0.01, 0.01])
    model = spec.compile()
    return model, kinematics.extract_chain(model, [f"hinge_{i}" for i in range(8)], "world", "body_7")


def within_ranges(rng: np.random.Generator, chain: kinematics.Chain, count: int = COUNT) -> np.ndarray:
    return rng.uniform(chain.lower_limit, chain.upper_limit, (count, len(chain.body_pos)))


def seed_pose() -> np.ndarray:
    return JACO.arms["right"].seed_pose


def rotation_error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(transforms.to_matrix(a) - transforms.to_matrix(b)).max(axis=(-1, -2))


# Forward


def test_forward_is_that_of_mujoco(rng, feeding_scene, arm):
    model = build_robot_with_tool_spec(feeding_scene, appearance=False).compile()
    data = mujoco.MjData(model)
    angles = within_ranges(rng, arm)
    pos, q = np.empty((COUNT, 3)), np.empty((COUNT, 4))
    for i in range(COUNT):
        data.qpos[:7] = angles[i]
        mujoco.mj_kinematics(model, data)
        pos[i], q[i] = data.body(TOOL_BODY).xpos, data.body(TOOL_BODY).xquat
    found_pos, found_q = kinematics.forward_kinematics(arm, angles)
    assert_allclose(found_pos, pos, atol=1e-9)
    assert rotation_error(found_q, q).max() < 1e-9


def test_forward_is_that_of_mujoco_for_axes_of_any_direction(rng, any_chain):
    model, chain = any_chain
    data = mujoco.MjData(model)
    angles = rng.uniform(-4, 4, (50, 8))
    found_pos, found_q = kinematics.forward_kinematics(chain, angles)
    for i in range(50):
        data.qpos = angles[i]
        mujoco.mj_kinematics(model, data)
        assert_allclose(found_pos[i], data.body("body_7").xpos, atol=1e-9)
        assert rotation_error(found_q[i], data.body("body_7").xquat) < 1e-9


def test_the_tip_stays_within_reach_of_the_first_hinge(rng, any_chain):
    _, chain = any_chain
    pos, _ = kinematics.forward_kinematics(chain, rng.uniform(-4, 4, (COUNT, 8)))
    assert np.linalg.norm(pos - chain.body_pos[0], axis=-1).max() < kinematics.compute_max_reach_m(chain)


def test_a_straight_arm_reaches_as_far_as_can_be():
    straight = chain_of_columns(np.array([[1.0, 0, 0], [2.0, 0, 0]]), np.array([[0, 0, 1.0]] * 2), 1.0)
    assert kinematics.compute_max_reach_m(straight) == 1.0 + 2.0


def test_the_end_effector_is_where_the_public_description_has_it(rng, hand):
    angles = within_ranges(rng, hand)
    found_pos, found_q = kinematics.forward_kinematics(hand, angles)
    pos, q = jaco_xacro.forward(angles)
    assert_allclose(found_pos, pos, atol=1e-6)
    assert rotation_error(found_q, q).max() < 1e-6


def test_the_jacobian_is_the_derivative(rng, arm):
    angles, step = within_ranges(rng, arm, 50), 1e-6
    _, _, jacobian = kinematics.compute_jacobian(arm, angles)
    for joint in range(7):
        nudge = step * np.eye(7)[joint]
        above_pos, above_q = kinematics.forward_kinematics(arm, angles + nudge)
        below_pos, below_q = kinematics.forward_kinematics(arm, angles - nudge)
        turn = transforms.multiply(above_q, transforms.conjugate(below_q))
        assert_allclose((above_pos - below_pos) / (2 * step), jacobian[:, :3, joint], atol=1e-8)
        assert_allclose(transforms.to_rotation_vector(turn) / (2 * step), jacobian[:, 3:, joint], atol=1e-8)


def test_a_chain_needs_its_joints_in_order():
    model = build_robot_spec(JACO, JACO.arms["right"], appearance=False).compile()
    swapped = ("joint_2", "joint_1", *JACO.arms["right"].joints[2:])
    with pytest.raises(ValueError, match=r"are \('joint_1', 'joint_2', .*but \('joint_2', 'joint_1'"):
        kinematics.extract_chain(model, swapped, JACO.base, JACO.arms["right"].end_effector)


def test_a_chain_needs_a_tip_that_the_base_carries():
    model = build_robot_spec(JACO, JACO.arms["right"], appearance=False).compile()
    with pytest.raises(ValueError, match="'base' is not a descendant of 'link_3'"):
        kinematics.extract_chain(model, JACO.arms["right"].joints, "link_3", "base")


# Inverse


def test_inverse_kinematics_inverts_forward_kinematics(rng, arm):
    """From up to 0.2 rad away in every joint, near singular poses and ends of ranges as well."""
    angles = within_ranges(rng, arm)
    pos, q = kinematics.forward_kinematics(arm, angles)
    solution = kinematics.inverse_kinematics(arm, pos, q, angles + rng.uniform(-0.2, 0.2, angles.shape))
    assert np.quantile(solution.position_error_m, 0.99) < 1e-4
    assert kinematics.is_accurate(solution).all()


def test_inverse_kinematics_without_target_rotation(rng, arm):
    pos, _ = kinematics.forward_kinematics(arm, within_ranges(rng, arm))
    solution = kinematics.inverse_kinematics(arm, pos, None, np.tile(seed_pose(), (COUNT, 1)))
    found_pos, _ = kinematics.forward_kinematics(arm, solution.joint_positions)
    assert np.mean(np.linalg.norm(found_pos - pos, axis=-1) < 1e-4) > 0.99
    assert_array_equal(solution.rotation_error_rad, 0.0)


def test_hinges_without_range_turn_freely(rng, any_chain):
    """They pass ±π on the way, and a start pose has them within ±π at the same pose."""
    _, chain = any_chain
    free = np.arange(8) % 2 == 0
    assert_array_equal(np.isinf(chain.lower_limit), free)
    assert_array_equal(np.isinf(chain.upper_limit), free)
    angles = np.clip(rng.uniform(3.0, 3.3, (100, 8)), chain.lower_limit, chain.upper_limit)
    goal = angles + np.where(free, 0.2, 0.0)
    found = kinematics.inverse_kinematics(
        chain, *kinematics.forward_kinematics(chain, goal), angles, tolerance=1e-9
    ).joint_positions
    assert (found[:, free].max(axis=0) > np.pi).all()
    wrapped = kinematics.wrap_angles(chain, found)
    assert np.abs(wrapped[:, free]).max() <= np.pi
    assert_allclose(
        kinematics.forward_kinematics(chain, wrapped)[0],
        kinematics.forward_kinematics(chain, found)[0],
        atol=1e-12,
    )
    assert_array_equal(wrapped[:, ~free], found[:, ~free])


def test_a_few_iterations_follow_a_path(rng, arm):
    """A tool that moves 1 cm and turns 2° in each control step is followed within 1 mm and 0.5°."""
    angles = seed_pose() + rng.uniform(-0.3, 0.3, (64, 7))
    pos, q = kinematics.forward_kinematics(arm, angles)
    direction = transforms.normalize(rng.standard_normal((64, 3)))
    for _ in range(10):
        pos = pos + 0.01 * direction
        q = transforms.multiply(transforms.from_axis_angle(direction, np.full(64, np.radians(2.0))), q)
        solution = kinematics.inverse_kinematics(arm, pos, q, angles, iterations=3)
        assert np.abs(solution.joint_positions - angles).max() < 0.3
        assert solution.position_error_m.max() < 0.001
        assert solution.rotation_error_rad.max() < np.radians(0.5)
        angles = solution.joint_positions


def test_the_inverse_stays_where_it_already_is(rng, arm):
    angles = within_ranges(rng, arm, 100)
    solution = kinematics.inverse_kinematics(arm, *kinematics.forward_kinematics(arm, angles), angles)
    assert_array_equal(solution.joint_positions, angles)


def test_reported_errors_match_the_angles(rng, arm):
    pos, q = kinematics.forward_kinematics(arm, within_ranges(rng, arm, 100))
    solution = kinematics.inverse_kinematics(arm, pos, q, within_ranges(rng, arm, 100), iterations=10)
    found_pos, found_q = kinematics.forward_kinematics(arm, solution.joint_positions)
    assert_allclose(np.linalg.norm(found_pos - pos, axis=-1), solution.position_error_m)
    assert_allclose(transforms.angle_between(found_q, q), solution.rotation_error_rad)


def test_angles_stay_within_the_ranges(rng, arm):
    """For any target and any start."""
    pos, q = rng.uniform(-2, 2, (200, 3)), transforms.normalize(rng.standard_normal((200, 4)))
    start = rng.uniform(-10, 10, (200, 7))
    uniforms = rng.random((200, kinematics.count_restart_random_numbers(7)))
    for angles in (
        kinematics.inverse_kinematics(arm, pos, q, start).joint_positions,
        kinematics.inverse_kinematics_with_restarts(arm, pos, q, seed_pose(), uniforms),
    ):
        assert (angles >= arm.lower_limit).all()
        assert (angles <= arm.upper_limit).all()
        assert np.isfinite(angles).all()


def test_a_row_has_the_same_bits_alone_and_among_others(rng, arm):
    pos, q = kinematics.forward_kinematics(arm, within_ranges(rng, arm, 64))
    uniforms = rng.random((64, kinematics.count_restart_random_numbers(7)))
    together = kinematics.inverse_kinematics_with_restarts(arm, pos, q, seed_pose(), uniforms)
    for row in range(0, 64, 5):
        only = slice(row, row + 1)
        alone = kinematics.inverse_kinematics_with_restarts(
            arm, pos[only], q[only], seed_pose(), uniforms[only]
        )
        assert_array_equal(alone, together[only])


@pytest.mark.parametrize("precision", [np.float64, np.float32])
def test_rows_that_wait_for_others_have_the_same_bits_alone(rng, arm, precision):
    """More rows than a block; some do not converge."""
    count = kinematics.MAX_ROWS_PER_BATCH + 500
    pos, q = kinematics.forward_kinematics(arm, within_ranges(rng, arm, count))
    pos[::7] += 1.0
    start = np.tile(seed_pose(), (count, 1))
    together = kinematics.inverse_kinematics(arm, pos, q, start, iterations=12, precision=precision)
    for rows in (
        slice(0, 1),
        slice(40, 49),
        slice(kinematics.MAX_ROWS_PER_BATCH - 9, None),
        slice(3, None, 97),
    ):
        alone = kinematics.inverse_kinematics(
            arm, pos[rows], q[rows], start[rows], iterations=12, precision=precision
        )
        assert_array_equal(alone.joint_positions, together.joint_positions[rows])
        assert_array_equal(alone.position_error_m, together.position_error_m[rows])
        assert_array_equal(alone.rotation_error_rad, together.rotation_error_rad[rows])


def test_single_precision_is_good_for_a_tenth_of_a_millimetre(rng, arm):
    angles = within_ranges(rng, arm)
    pos, q = kinematics.forward_kinematics(arm, angles)
    start = angles + rng.uniform(-0.2, 0.2, angles.shape)
    solution = kinematics.inverse_kinematics(arm, pos, q, start, precision=np.float32)
    found_pos, found_q = kinematics.forward_kinematics(arm, solution.joint_positions)
    assert np.quantile(np.linalg.norm(found_pos - pos, axis=-1), 0.99) < 1e-4
    assert np.quantile(transforms.angle_between(found_q, q), 0.99) < 1e-3
    assert kinematics.is_accurate(solution).all()
    assert solution.joint_positions.dtype == np.float64
    assert (solution.joint_positions >= arm.lower_limit).all()
    assert (solution.joint_positions <= arm.upper_limit).all()


def reached(chain: kinematics.Chain, angles: np.ndarray, pos: np.ndarray, q: np.ndarray) -> np.ndarray:
    found_pos, found_q = kinematics.forward_kinematics(chain, angles)
    near = np.linalg.norm(found_pos - pos, axis=-1) < kinematics.MAX_POSITION_ERROR_M
    return near & (transforms.angle_between(found_q, q) < kinematics.MAX_ROTATION_ERROR_RAD)


def test_restarts_help_and_never_harm(rng, arm):
    """Whatever one search from the seed pose reaches, the search with restarts does; and it reaches more."""
    pos, q = kinematics.forward_kinematics(arm, within_ranges(rng, arm, 2 * COUNT))
    once = kinematics.inverse_kinematics(arm, pos, q, np.tile(seed_pose(), (2 * COUNT, 1))).joint_positions
    uniforms = rng.random((2 * COUNT, kinematics.count_restart_random_numbers(7)))
    with_restarts = kinematics.inverse_kinematics_with_restarts(arm, pos, q, seed_pose(), uniforms)
    before, after = reached(arm, once, pos, q), reached(arm, with_restarts, pos, q)
    assert (after | ~before).all()
    assert before.sum() < after.sum()
    assert after.mean() > 0.995


# Isotropy


def chain_of_columns(origins: np.ndarray, axes: np.ndarray, half_range_rad: float) -> kinematics.Chain:
    """Hinges at places (J, 3) about axes (J, 3) in the base frame; the tip is the base frame's origin."""
    count = len(origins)
    return kinematics.Chain(
        body_pos=np.diff(origins, axis=0, prepend=0.0),
        body_quat=np.tile(transforms.IDENTITY_QUATERNION, (count, 1)),
        joint_axis=axes,
        tip_pos=-origins[-1],
        tip_quat=transforms.IDENTITY_QUATERNION,
        lower_limit=np.full(count, -half_range_rad),
        upper_limit=np.full(count, half_range_rad),
    )


def cross_of_hinges(arm_m: float, half_range_rad: float = np.inf) -> kinematics.Chain:
    """Two hinges about each axis, on both sides of the tip: J Jᵀ = 2 diag(arm², arm², arm², 1, 1, 1)."""
    sideways = arm_m * np.repeat(np.roll(np.eye(3), 1, axis=1), 2, axis=0)
    sides = np.array([1.0, -1.0] * 3)[:, None]
    return chain_of_columns(sides * sideways, np.repeat(np.eye(3), 2, axis=0), half_range_rad)


@pytest.mark.parametrize(
    ("arm_m", "isotropy"),
    [
        (1.0, 1.0),  # all eigenvalues are alike
        (2.0, 4.0 / 5.0),  # eigenvalues 8 and 2: the geometric mean is 4, the arithmetic 5
        (0.5, 1.0 / 1.25),  # eigenvalues 0.5 and 2
    ],
)
def test_isotropy_by_hand(arm_m, isotropy):
    assert_allclose(
        kinematics.compute_isotropy(cross_of_hinges(arm_m), np.zeros((1, 6))), isotropy, rtol=1e-12
    )


def test_equal_weights_do_not_matter_to_isotropy():
    """In the middle of all ranges the isotropy is that of hinges that turn freely."""
    assert_allclose(kinematics.compute_isotropy(cross_of_hinges(1.0, 2.0), np.zeros((1, 6))), 1.0, rtol=1e-12)


def test_isotropy_with_limits_by_hand():
    """A pair of hinges at the ends of their ranges, the others free: one eigenvalue pair of J W Jᵀ is halved."""
    chain = cross_of_hinges(1.0)
    lower, upper = chain.lower_limit.copy(), chain.upper_limit.copy()
    lower[4:], upper[4:] = 0.0, 1.0
    limited = replace(chain, lower_limit=lower, upper_limit=upper)
    by_hand = (2.0**4 * 1.0**2) ** (1 / 6) / ((4 * 2.0 + 2 * 1.0) / 6)
    assert_allclose(kinematics.compute_isotropy(limited, np.zeros((1, 6))), by_hand, rtol=1e-12)


def test_limit_weights_by_hand():
    """Half at an end, almost 1 in the middle, 3/4 a fortieth of the range inside, the floor outside."""
    chain = chain_of_columns(np.zeros((1, 3)), np.array([[0.0, 0, 1]]), 2.0)
    angles = np.array([[-2.0], [2.0], [0.0], [1.9], [-1.9], [2.1], [-50.0]])
    by_hand = [0.5, 0.5, 1.0 - 0.5**21, 0.75, 0.75, 0.001, 0.001]
    assert_allclose(kinematics.compute_joint_limit_weights(chain, angles)[:, 0], by_hand, rtol=1e-9)


def test_isotropy_is_a_share_and_agrees_with_the_determinant(rng, arm):
    angles = within_ranges(rng, arm)
    found = kinematics.compute_isotropy(arm, angles)
    assert (found >= 0.0).all()
    assert (found <= 1.0).all()
    _, _, j = kinematics.compute_jacobian(arm, angles)
    square = (j * kinematics.compute_joint_limit_weights(arm, angles)[:, None]) @ j.swapaxes(-1, -2)
    by_numpy = np.linalg.det(square) ** (1 / 6) / (np.trace(square, axis1=-2, axis2=-1) / 6)
    assert_allclose(found, by_numpy, rtol=1e-6)


def test_a_singular_arm_has_no_isotropy():
    """Hinges that all turn about one axis."""
    chain = chain_of_columns(np.zeros((7, 3)), np.tile([0.0, 0.0, 1.0], (7, 1)), 2.0)
    assert_allclose(kinematics.compute_isotropy(chain, np.zeros((1, 7))), 0.0, atol=1e-3)


def test_isotropy_has_the_same_bits_alone_and_among_others(rng, arm):
    angles = within_ranges(rng, arm, 40)
    together = kinematics.compute_isotropy(arm, angles)
    assert_array_equal(
        np.concatenate([kinematics.compute_isotropy(arm, row[None]) for row in angles]), together
    )
