"""A stop is quick and final, whatever the arm was doing."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.models import robot
from avrgym.models.drive import DRIVE_JOINTS
from avrgym.models.scene import PHYSICS_STEP_S
from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.robots.registry import ROBOTS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.random_stops import MAX_REBOUND_M, SLOW_M_S, stop_at_random

STOPS = 8


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", [name for name in ENVIRONMENTS if find_packaged_policies(name)])
def test_a_stopped_arm_is_slow_after_100_ms_and_never_comes_back(environment: str) -> None:
    stops = stop_at_random(environment, STOPS, seed=7)
    assert stops.residual_speed_m_s.max() < SLOW_M_S, stops
    assert stops.rebound_m.max() < MAX_REBOUND_M, stops
    assert stops.drift_m.max() < MAX_REBOUND_M, stops


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_a_brake_holds_more_than_its_motor_gives(robot_name: str) -> None:
    """Also those of a lift and of a drive."""
    episodes = Episodes(f"avrgym/Feeding{robot_name}-v1", 1, moving=True)
    episodes.reset(np.arange(1), [np.random.default_rng(1)])
    simulation, arm, drive = episodes.simulation, episodes.scene.arm, episodes.scene.robot.drive
    joints = (*arm.joints, *(() if drive is None else DRIVE_JOINTS))
    limits = np.concatenate([arm.effort_limit, () if drive is None else drive.effort_limit])
    dofs = [simulation.model.joint(robot.ROBOT_NAME_PREFIX + joint).dofadr[0] for joint in joints]
    simulation.brake_robot()
    stopped = simulation.get_configuration()
    simulation.batch.bind("qfrc_applied")[:, dofs] = 2.0 * limits
    simulation.step(round(1.0 / PHYSICS_STEP_S))
    assert_allclose(simulation.get_configuration(), stopped, rtol=0.0, atol=5e-3)


@pytest.mark.parametrize("environment", ["avrgym/FeedingPR2-v1", "avrgym/DrinkingJaco-v1"])
def test_brakes_that_are_released_leave_no_trace(environment: str) -> None:
    """An arm that stood braked goes on as one that never was."""
    rng, states = np.random.default_rng(1), []
    actions = rng.uniform(-1.0, 1.0, (5, 2, 7))
    for braked in (True, False):
        episodes = Episodes(environment, 2, moving=True)
        episodes.reset(np.arange(2), [np.random.default_rng(world) for world in range(2)])
        if braked:
            episodes.simulation.brake_robot()
        for action in actions:
            episodes.step(action)
        states.append([episodes.simulation.get_integration_state(world) for world in range(2)])
    assert_array_equal(*states)
