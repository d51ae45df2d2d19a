"""Steps that stay on Warp's device, in every scene: `make test-engines`."""

from typing import Any

import numpy as np
import pytest

from avrgym.envs import benchmark
from avrgym.simulation.engines.warp import libraries
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.no_host_copies import forbid_host_copies
from helpers.simulation.two_engines import WARP

WORLDS = 3


def reset_episodes(environment: str, **how: Any) -> Episodes:
    """Partners of the zoo, who look and move, and have just been met."""
    episodes = Episodes(environment, WORLDS, people="zoo/train", num_threads=1, **how)
    episodes.reset(np.arange(WORLDS), [np.random.default_rng([5, world]) for world in range(WORLDS)])
    return episodes


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_steps_with_people_who_move_go_the_way_of_those_on_threads_and_copy_nothing(environment: str) -> None:
    threads, there = reset_episodes(environment), reset_episodes(environment, engine=WARP, on_device=True)
    expert, torch = threads.task.expert(threads), libraries().torch
    for number in range(12):
        action = np.clip(np.asarray(expert(threads.observe()), float), -1.0, 1.0)
        given, wanted = torch.as_tensor(action, dtype=torch.float32), threads.step(action)
        if number == 0:  # when kernels and constants are brought there
            there.step(given)
            continue
        with forbid_host_copies():
            found = there.step(given)
        np.testing.assert_allclose(found.distance_m, wanted.distance_m, atol=2e-3)
        np.testing.assert_allclose(
            there.simulation.person_angles_rad(), threads.simulation.person_angles_rad(), atol=2e-3
        )
    there.check()


def test_the_bench_measures_steps_that_stay_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "EPISODE_STEPS", 4)
    monkeypatch.setattr(benchmark, "RUNS", 1)
    benchmark.measure_simulation("avrgym/ScratchItchJaco-v1", 2, engine=WARP)  # kernels are there from now on
    step = Episodes.step

    def watched(episodes: Episodes, action: Any) -> Any:
        with forbid_host_copies():
            return step(episodes, action)

    monkeypatch.setattr(Episodes, "step", watched)
    row = benchmark.measure_simulation("avrgym/ScratchItchJaco-v1", 2, engine=WARP)
    assert (row.engine, row.device) == ("warp", "CPU")
    assert row.steps_per_second > 0.0
