"""Failed episodes that training repeats."""

import numpy as np

from avrgym.learning.failed_episodes import FAILURE_FORCE_N, MAX_STORED_EPISODES, FailedEpisodeSampler

WORLDS = 8


def run(hard: FailedEpisodeSampler, steps: int, good) -> list[int]:
    """Choose episodes, and update with no force; those in ``good`` succeed. Returns the seeds."""
    seeds = hard.choose_seeds(steps)
    hard.store_failures([good(seed) for seed in seeds], [0.0] * len(seeds))
    return seeds


def always(seed: int) -> bool:
    return True


def never(seed: int) -> bool:
    return False


def test_without_failures_every_episode_is_new():
    hard = FailedEpisodeSampler(WORLDS, 0.5, 0)
    seeds = [seed for update in range(20) for seed in run(hard, update, always)]
    assert len(set(seeds)) == 20 * WORLDS
    assert hard.failed_seeds == []


def test_failed_episodes_are_repeated_until_they_succeed():
    hard = FailedEpisodeSampler(WORLDS, 0.5, 0)
    bad = run(hard, 0, never)
    assert hard.failed_seeds == bad
    came: list[int] = []
    for update in range(1, 4):
        chosen = run(hard, update, always)
        came += chosen[: hard.num_repeated_episodes]
        assert set(chosen[hard.num_repeated_episodes :]).isdisjoint(bad)
    assert sorted(came) == sorted(bad)
    assert hard.failed_seeds == []


def test_an_episode_with_large_forces_counts_as_failed():
    hard = FailedEpisodeSampler(2, 0.5, 0)
    seeds = hard.choose_seeds(0)
    hard.store_failures([True, True], [FAILURE_FORCE_N, FAILURE_FORCE_N + 0.1])
    assert hard.failed_seeds == seeds[1:]


def test_repeated_and_stored_episodes_are_limited():
    hard = FailedEpisodeSampler(WORLDS, 0.25, 0)
    for update in range(100):
        seeds = run(hard, update, never)
        assert hard.num_repeated_episodes == (2 if update else 0)
        assert len(seeds) == len(set(seeds)) == WORLDS
        assert hard.failed_seeds[-WORLDS:] == seeds
        assert len(hard.failed_seeds) == len(set(hard.failed_seeds)) <= MAX_STORED_EPISODES
    assert len(hard.failed_seeds) == MAX_STORED_EPISODES


def test_choices_follow_from_seed_and_steps():
    first, second, other = (
        FailedEpisodeSampler(WORLDS, 0.5, 1),
        FailedEpisodeSampler(WORLDS, 0.5, 1),
        FailedEpisodeSampler(WORLDS, 0.5, 2),
    )
    for hard in (first, second):
        run(hard, 0, never)
    second.choose_seeds(1600)
    assert first.choose_seeds(1600) == second.choose_seeds(1600)
    assert not np.isin(first.choose_seeds(0), other.choose_seeds(0)).any()
