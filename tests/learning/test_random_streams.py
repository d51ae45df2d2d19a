"""Laws of the streams: the same names give the same bits, and no episode belongs to two of them."""

import numpy as np
import pytest

from avrgym.learning.evaluation import evaluate
from avrgym.system.random_streams import TEST, VALIDATION, Split, evaluation_episodes, split_of

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"


def beginnings(split: Split, seed: int, count: int = 300) -> set[bytes]:
    return {each.bytes(16) for each in evaluation_episodes(split, seed, range(count))}


def test_no_episode_belongs_to_two_streams_or_seeds() -> None:
    drawn = [beginnings(split, seed) for split in (VALIDATION, TEST) for seed in (0, 1, 7, 2**31)]
    assert len(set.union(*drawn)) == 8 * 300


def test_no_training_meets_an_episode_of_either(rng: np.random.Generator) -> None:
    """Whatever seeds it draws: it has no spawn key."""
    of_streams = beginnings(VALIDATION, 0) | beginnings(TEST, 0)
    seeds = [
        *range(2000),
        *([0, number] for number in range(300)),
        *([0, number, 2] for number in range(300)),
    ]
    trained_on = {
        np.random.default_rng(seed).bytes(16) for seed in [*seeds, *rng.integers(2**31, size=2000).tolist()]
    }
    assert not of_streams & trained_on


def test_an_episode_is_known_by_stream_seed_and_number() -> None:
    (alone,) = evaluation_episodes(TEST, 5, [17])
    assert alone.bytes(16) == evaluation_episodes(TEST, 5, range(20))[17].bytes(16)


def test_figures_are_of_the_stream_that_they_name() -> None:
    shown, chosen = (
        evaluate(ENVIRONMENT, "zero", "revised", 2, 0, split=split) for split in (TEST, VALIDATION)
    )
    assert (shown.split, chosen.split) == ("test", "validation")
    assert shown.reward_mean != chosen.reward_mean
    assert evaluate(ENVIRONMENT, "zero", "revised", 2, 0) == shown


def test_an_unknown_stream_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown split 'shown'; allowed: validation, test"):
        split_of("shown")
