"""Every scene on Warp beside threads: `make test-engines`. Compiling the kernels takes most of the time, once."""

import numpy as np
import pytest

from avrgym.tasks.registry import ENVIRONMENTS
from engines import on_both, step_both

WORLDS, STEPS = 4, 40


@pytest.mark.parametrize("people", ["revised", "participants", "zoo/train"])
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_worlds_go_the_same_way(environment: str, people: str) -> None:
    """Until tools touch people who move, from where single precision leads apart; nothing overflows on the way."""
    both = on_both(environment, WORLDS, people)
    threads = both[0]
    apart = [step.angles_rad for step in step_both(both, threads.task.expert(threads), STEPS)]
    assert max(apart[:10]) < 1e-3
    assert max(apart) < 2e-2


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_experts_who_see_the_worlds_succeed_on_both(environment: str) -> None:
    rates: list[float] = []
    for episodes in on_both(environment, 16):
        expert = episodes.task.expert(episodes)
        steps = [episodes.step(np.asarray(expert(episodes.observe()), float)) for _ in range(200)]
        rates.append(float(steps[-1].success.mean()))
    assert abs(rates[0] - rates[1]) <= 0.25
