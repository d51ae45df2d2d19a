import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import xacro
from avrgym import kinematics, transforms
from avrgym.models.robots import JACO, robot_spec
from avrgym.models.scene import TOOL_BODY, robot_with_tool
from avrgym.tasks.places import arm_chain

COUNT = 1000


@pytest.fixture(scope="module")
def arm(feeding_stage) -> kinematics.Chain:
    """From the Jaco's base to the spoon."""
    return arm_chain(feeding_stage)


@pytest.fixture(scope="module")
def hand() -> kinematics.Chain:
    """From the Jaco's base to its end effector."""
    model = robot_spec(JACO, JACO.arms["right"], appearance=False).compile()
    return kinematics.chain_of(model, JACO.arms["right"].joints, JACO.base, JACO.arms["right"].end_effector)


def within_ranges(rng: np.random.Generator, chain: kinematics.Chain, count: int = COUNT) -> np.ndarray:
    return rng.uniform(chain.lower_rad, chain.upper_rad, (count, len(chain.pos)))


def rotation_error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(transforms.to_matrix(a) - transforms.to_matrix(b)).max(axis=(-1, -2))


# Forward


def test_forward_is_that_of_mujoco(rng, feeding_stage, arm):
    model = robot_with_tool(feeding_stage, appearance=False).compile()
    data = mujoco.MjData(model)
    angles = within_ranges(rng, arm)
    pos, q = np.empty((COUNT, 3)), np.empty((COUNT, 4))
    for i in range(COUNT):
        data.qpos[:7] = angles[i]
        mujoco.mj_kinematics(model, data)
        pos[i], q[i] = data.body(TOOL_BODY).xpos, data.body(TOOL_BODY).xquat
    found_pos, found_q = kinematics.forward(arm, angles)
    assert_allclose(found_pos, pos, atol=1e-9)
    assert rotation_error(found_q, q).max() < 1e-9


def test_the_end_effector_is_where_the_public_description_has_it(rng, hand):
    angles = within_ranges(rng, hand)
    found_pos, found_q = kinematics.forward(hand, angles)
    pos, q = xacro.forward(angles)
    assert_allclose(found_pos, pos, atol=1e-6)
    assert rotation_error(found_q, q).max() < 1e-6


def test_the_jacobian_is_the_derivative(rng, arm):
    angles, step = within_ranges(rng, arm, 50), 1e-6
    _, _, jacobian = kinematics.jacobian(arm, angles)
    for joint in range(7):
        nudge = step * np.eye(7)[joint]
        above_pos, above_q = kinematics.forward(arm, angles + nudge)
        below_pos, below_q = kinematics.forward(arm, angles - nudge)
        turn = transforms.multiply(above_q, transforms.conjugate(below_q))
        assert_allclose((above_pos - below_pos) / (2 * step), jacobian[:, :3, joint], atol=1e-8)
        assert_allclose(transforms.to_rotation_vector(turn) / (2 * step), jacobian[:, 3:, joint], atol=1e-8)


def test_a_chain_needs_its_joints_in_order():
    model = robot_spec(JACO, JACO.arms["right"], appearance=False).compile()
    swapped = ("joint_2", "joint_1", *JACO.arms["right"].joints[2:])
    with pytest.raises(ValueError, match=r"are \('joint_1', 'joint_2', .*not \('joint_2', 'joint_1'"):
        kinematics.chain_of(model, swapped, JACO.base, JACO.arms["right"].end_effector)


def test_a_chain_needs_a_tip_that_the_base_carries():
    model = robot_spec(JACO, JACO.arms["right"], appearance=False).compile()
    with pytest.raises(ValueError, match="'base' is not carried by 'link_3'"):
        kinematics.chain_of(model, JACO.arms["right"].joints, "link_3", "base")


# Inverse


def test_the_inverse_finds_back(rng, arm):
    """From up to 0.2 rad away in every joint: 19 of 20 within 0.1 mm, all as accurately as restarts ask for.

    Near a singular pose the damping makes it slow.
    """
    angles = within_ranges(rng, arm, 400)
    pos, q = kinematics.forward(arm, angles)
    solution = kinematics.solve(arm, pos, q, angles + rng.uniform(-0.2, 0.2, angles.shape))
    assert np.quantile(solution.position_error_m, 0.95) < 1e-4
    assert solution.position_error_m.max() < kinematics.ACCURACY_M
    assert solution.rotation_error_rad.max() < kinematics.ACCURACY_RAD


def test_the_inverse_stays_where_it_already_is(rng, arm):
    angles = within_ranges(rng, arm, 100)
    solution = kinematics.solve(arm, *kinematics.forward(arm, angles), angles)
    assert_array_equal(solution.angles_rad, angles)


def test_the_errors_it_tells_are_those_of_its_angles(rng, arm):
    pos, q = kinematics.forward(arm, within_ranges(rng, arm, 100))
    solution = kinematics.solve(arm, pos, q, within_ranges(rng, arm, 100), iterations=10)
    found_pos, found_q = kinematics.forward(arm, solution.angles_rad)
    assert_allclose(np.linalg.norm(found_pos - pos, axis=-1), solution.position_error_m)
    assert_allclose(transforms.angle_between(found_q, q), solution.rotation_error_rad)


def test_angles_stay_within_the_ranges(rng, arm):
    """Whatever is asked for, and wherever the search begins."""
    pos, q = rng.uniform(-2, 2, (200, 3)), transforms.normalize(rng.standard_normal((200, 4)))
    start = rng.uniform(-10, 10, (200, 7))
    uniforms = rng.random((200, kinematics.RESTART_UNIFORMS))
    for angles in (
        kinematics.solve(arm, pos, q, start).angles_rad,
        kinematics.solve_with_restarts(arm, pos, q, JACO.arms["right"].seed_pose_rad, uniforms),
    ):
        assert (angles >= arm.lower_rad).all()
        assert (angles <= arm.upper_rad).all()
        assert np.isfinite(angles).all()


def test_a_row_has_the_same_bits_alone_and_among_others(rng, arm):
    pos, q = kinematics.forward(arm, within_ranges(rng, arm, 64))
    uniforms = rng.random((64, kinematics.RESTART_UNIFORMS))
    together = kinematics.solve_with_restarts(arm, pos, q, JACO.arms["right"].seed_pose_rad, uniforms)
    for row in range(0, 64, 5):
        only = slice(row, row + 1)
        alone = kinematics.solve_with_restarts(arm, pos[only], q[only], JACO.arms["right"].seed_pose_rad, uniforms[only])
        assert_array_equal(alone, together[only])


def reached(chain: kinematics.Chain, angles: np.ndarray, pos: np.ndarray, q: np.ndarray) -> np.ndarray:
    found_pos, found_q = kinematics.forward(chain, angles)
    near = np.linalg.norm(found_pos - pos, axis=-1) < kinematics.ACCURACY_M
    return near & (transforms.angle_between(found_q, q) < kinematics.ACCURACY_RAD)


def test_restarts_help_and_never_harm(rng, arm):
    """Whatever one search from the seed pose reaches, the search with restarts does; and it reaches more."""
    angles = JACO.arms["right"].seed_pose_rad + rng.uniform(-1.5, 1.5, (300, 7))
    pos, q = kinematics.forward(arm, np.clip(angles, arm.lower_rad, arm.upper_rad))
    once = kinematics.solve(arm, pos, q, np.tile(JACO.arms["right"].seed_pose_rad, (300, 1))).angles_rad
    uniforms = rng.random((300, kinematics.RESTART_UNIFORMS))
    with_restarts = kinematics.solve_with_restarts(arm, pos, q, JACO.arms["right"].seed_pose_rad, uniforms)
    before, after = reached(arm, once, pos, q), reached(arm, with_restarts, pos, q)
    assert (after | ~before).all()
    assert after.mean() > before.mean() + 0.05
    assert after.mean() > 0.98
