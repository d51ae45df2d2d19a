"""Every scene on Warp beside threads: `make test-engines`. Compiling the kernels takes most of the time, once."""

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
def test_worlds_go_the_same_way(environment: str, people: str) -> None:
    """Until tools touch people who move, from where single precision leads apart; nothing overflows on the way."""
    both = episodes_on_both(environment, WORLDS, people)
    threads = both[0]
    apart = [step.angles_rad for step in step_both(both, threads.task.expert(threads), STEPS)]
    assert max(apart[:10]) < 1e-3
    assert max(apart) < 2e-2


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_experts_who_see_the_worlds_succeed_on_both(environment: str) -> None:
    rates: list[float] = []
    for episodes in episodes_on_both(environment, 16):
        expert = episodes.task.expert(episodes)
        steps = [episodes.step(np.asarray(expert(episodes.observe()), float)) for _ in range(200)]
        rates.append(float(steps[-1].success.mean()))
    assert abs(rates[0] - rates[1]) <= 0.25


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_from_the_same_state_worlds_are_pushed_alike(environment: str) -> None:
    """Also where tool, food or water touch people: from one physics step to the next nothing has led apart yet.

    But for water, whose solver stops before single drops are settled: to them a step of gravity is 0.1 m/s.
    """
    both = episodes_on_both(environment, 8)
    task = both[0].task
    expert, pressed = task.expert(both[0]), 0
    for _ in range(60):
        both[0].step(np.asarray(expert(both[0].observe()), float))
        copy_state(both)
        threads, warp = (stepped(episodes) for episodes in both)
        assert_allclose(warp.total_force_n, threads.total_force_n, rtol=0.01, atol=0.02)
        assert_allclose(warp.tool_velocity_w, threads.tool_velocity_w, atol=1e-3)
        apart = warp.particle_velocity_w - threads.particle_velocity_w
        most = 0.01 if task.name == "Drinking" else 1e-4
        assert not apart.size or np.sqrt(np.mean(np.square(apart))) < most, apart
        pressed += int((threads.total_force_n > 0.0).sum())
    assert pressed or task.offered == "mouth"


def stepped(episodes: Episodes) -> State:
    """After one physics step."""
    episodes.simulation.step(1)
    return episodes.state()
