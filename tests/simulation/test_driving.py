"""Robots that drive while they work."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.geometry.kinematics import compute_action_jacobian
from avrgym.policies.cartesian_control import HAND_SPEED_LIMIT_M_S, CartesianController
from avrgym.robots.registry import ROBOTS
from avrgym.tasks.episodes import Episodes

DRIVING = [name for name, robot in ROBOTS.items() if robot.drive is not None]
WORLDS = 3


@pytest.fixture(params=DRIVING)
def episodes(request) -> Episodes:
    made = Episodes(f"avrgym/Feeding{request.param}-v1", WORLDS, num_threads=1)
    made.reset(np.arange(WORLDS), [np.random.default_rng(world) for world in range(WORLDS)])
    return made


def driving(episodes: Episodes, forward: float, turn: float) -> np.ndarray:
    actions = np.zeros((WORLDS, episodes.action_size))
    actions[:, -2:] = forward, turn
    return actions


def test_the_base_never_moves_sideways(episodes, rng):
    """Less than 3 mm in 2 s of changing commands."""
    simulation, sideways = episodes.simulation, np.zeros(WORLDS)
    before = simulation.get_base_displacement()
    for step in range(200):
        if step % 20 == 0:
            simulation.command_robot(driving(episodes, *rng.uniform(-1.0, 1.0, 2)))
        simulation.step(1)
        now = simulation.get_base_displacement()
        moved, yaw = now - before, 0.5 * (now + before)[:, 2]
        sideways += np.cos(yaw) * moved[:, 1] - np.sin(yaw) * moved[:, 0]
        before = now
    assert np.abs(simulation.get_base_displacement()).max() > 0.05
    assert np.abs(sideways).max() < 3e-3


@pytest.mark.parametrize(("forward", "turn"), [(1.0, 0.0), (-0.5, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0)])
def test_speeds_are_those_of_the_action_within_the_limit_of_each_wheel(episodes, forward, turn):
    drive, simulation = episodes.scene.robot.drive, episodes.simulation
    for _ in range(8):
        before = simulation.get_base_displacement()
        episodes.step(driving(episodes, forward, turn))
    moved = simulation.get_base_displacement() - before
    speed, rate = np.hypot(moved[:, 0], moved[:, 1]) / 0.1, moved[:, 2] / 0.1
    share = min(
        1.0,
        drive.speed_limit_m_s
        / (
            abs(forward) * drive.speed_limit_m_s
            + 0.5 * drive.track_width_m * drive.turn_limit_rad_s * abs(turn)
        ),
    )
    assert_allclose(speed, share * abs(forward) * drive.speed_limit_m_s, atol=2e-3)
    assert_allclose(rate, share * turn * drive.turn_limit_rad_s, atol=5e-3)
    assert (speed + 0.5 * drive.track_width_m * np.abs(rate) < drive.speed_limit_m_s + 3e-3).all()


def test_brakes_hold_the_base_under_load(episodes):
    simulation = episodes.simulation
    simulation.brake_robot()
    before = simulation.get_base_displacement()
    hand = simulation.model.body("robot/" + episodes.scene.arm.end_effector).id
    simulation.batch.bind("xfrc_applied")[:, hand, :3] = 8.0, -8.0, 0.0
    simulation.step(100)
    assert np.abs(simulation.get_base_displacement() - before).max() < 3e-3


def test_furniture_stops_it(episodes):
    """A base that turns to the person and drives 1.5 m presses against them or their chair, and does not pass."""
    simulation = episodes.simulation
    for step in range(80):
        episodes.step(driving(episodes, 0.0, -1.0) if step < 30 else driving(episodes, 1.0, 0.0))
    base_w, _ = simulation.get_base_pose()
    assert (base_w[:, 0] < -0.1).all()


def test_a_saved_state_continues_with_the_same_bits(episodes, rng):
    simulation, actions = episodes.simulation, rng.uniform(-1.0, 1.0, (10, WORLDS, episodes.action_size))
    episodes.step(actions[0])
    saved, ends = simulation.snapshot(), []
    for _ in range(2):
        simulation.restore(saved)
        for action in actions:
            simulation.command_robot(action)
            simulation.step()
        ends.append([simulation.get_integration_state(world) for world in range(WORLDS)])
    assert_array_equal(*ends)


def test_an_operator_moves_the_hand_in_every_direction(episodes):
    """The base drives where the arm alone cannot move the hand."""
    simulation, hand = episodes.simulation, CartesianController(episodes.simulation)
    base_q_w = simulation.get_base_pose()[1][:1]
    j = compute_action_jacobian(hand.arm_chain, simulation.get_joint_positions()[:1], drives=True)[0]
    for direction in np.concatenate([np.eye(3), -np.eye(3)]):
        velocity_b = j[:3] @ (hand.compute_action(direction, np.zeros(3)) * episodes.scene.speed_limit)
        velocity_w = transforms.rotate(base_q_w, velocity_b[None])[0]
        assert velocity_w @ direction > 0.3 * HAND_SPEED_LIMIT_M_S
        assert np.linalg.norm(velocity_w - velocity_w @ direction * direction) < 0.1 * HAND_SPEED_LIMIT_M_S
