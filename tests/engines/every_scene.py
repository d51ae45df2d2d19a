"""Every scene on Warp compared with threads: `make test-engines`."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.simulation.state import State
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.two_engines import copy_state, episodes_on_both, step_both

WORLDS, STEPS = 4, 40


@pytest.mark.parametrize("people", ["revised", "participants", "zoo/train"])
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_trajectories_agree(environment: str, people: str) -> None:
    """Trajectories agree until contact; single precision then makes them diverge slowly."""
    both = episodes_on_both(environment, WORLDS, people)
    threads = both[0]
    apart = [step.joint_positions for step in step_both(both, threads.task.expert(threads), STEPS)]
    assert max(apart[:10]) < 1e-3
    assert max(apart) < 2e-2


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_oracles_succeed_on_both_engines(environment: str) -> None:
    rates: list[float] = []
    for episodes in episodes_on_both(environment, 16):
        expert = episodes.task.expert(episodes)
        steps = [episodes.step(np.asarray(expert(episodes.observe()), float)) for _ in range(200)]
        rates.append(float(steps[-1].success.mean()))
    assert abs(rates[0] - rates[1]) <= 0.25


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_contact_forces_agree_in_the_same_state(environment: str) -> None:
    """Compares one physics step from the same state, with contacts of tool, food and water.

    Water has a larger tolerance: its solver stops before every drop has converged.
    """
    both = episodes_on_both(environment, 8)
    task = both[0].task
    expert, contacts = task.expert(both[0]), 0
    for _ in range(60):
        both[0].step(np.asarray(expert(both[0].observe()), float))
        copy_state(both)
        threads, warp = (next_state(episodes) for episodes in both)
        assert_allclose(warp.total_force_n, threads.total_force_n, rtol=0.01, atol=0.02)
        assert_allclose(warp.tool_velocity_w, threads.tool_velocity_w, atol=1e-3)
        apart = warp.particle_velocity_w - threads.particle_velocity_w
        most = 0.01 if task.name == "Drinking" else 1e-4
        assert not apart.size or np.sqrt(np.mean(np.square(apart))) < most, apart
        contacts += int((threads.total_force_n > 0.0).sum())
    assert contacts or task.offered_body_part == "mouth"


def next_state(episodes: Episodes) -> State:
    """Return the state after one physics step."""
    episodes.simulation.step(1)
    return episodes.get_state()
