"""Steps on Warp's device without host copies, in every scene: `make test-engines`."""

from typing import Any

import numpy as np
import pytest

from avrgym.envs import benchmark
from avrgym.simulation.engines.warp import import_libraries
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.no_host_copies import forbid_host_copies
from helpers.simulation.two_engines import WARP

WORLDS = 3


def reset_episodes(environment: str, **options: Any) -> Episodes:
    """Return episodes with moving partners of the zoo, after a reset."""
    episodes = Episodes(environment, WORLDS, people="zoo/train", num_threads=1, **options)
    episodes.reset(np.arange(WORLDS), [np.random.default_rng([5, world]) for world in range(WORLDS)])
    return episodes


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_steps_with_moving_people_agree_with_threads_without_host_copies(environment: str) -> None:
    threads, device = reset_episodes(environment), reset_episodes(environment, engine=WARP, on_device=True)
    expert, torch = threads.task.expert(threads), import_libraries().torch
    for number in range(12):
        action = np.clip(np.asarray(expert(threads.observe()), float), -1.0, 1.0)
        device_action, expected = torch.as_tensor(action, dtype=torch.float32), threads.step(action)
        if number == 0:  # copies kernels and constants to the device
            device.step(device_action)
            continue
        with forbid_host_copies():
            result = device.step(device_action)
        np.testing.assert_allclose(result.distance_m, expected.distance_m, atol=2e-3)
        np.testing.assert_allclose(
            device.simulation.get_person_joint_angles_rad(),
            threads.simulation.get_person_joint_angles_rad(),
            atol=2e-3,
        )
    device.check_device_results()


def test_the_benchmark_measures_steps_without_host_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "EPISODE_STEPS", 4)
    monkeypatch.setattr(benchmark, "NUM_RUNS", 1)
    benchmark.measure_simulation_speed("avrgym/ScratchItchJaco-v1", 2, engine=WARP)  # compiles the kernels
    step = Episodes.step

    def watched(episodes: Episodes, action: Any) -> Any:
        with forbid_host_copies():
            return step(episodes, action)

    monkeypatch.setattr(Episodes, "step", watched)
    row = benchmark.measure_simulation_speed("avrgym/ScratchItchJaco-v1", 2, engine=WARP)
    assert (row.engine, row.device) == ("warp", "CPU")
    assert row.steps_per_second > 0.0
