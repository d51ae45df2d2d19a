"""The same names and numbers give the same random stream, and no two splits share an episode."""

import numpy as np
import pytest

from avrgym.learning.evaluation import evaluate
from avrgym.system import random_streams
from avrgym.system.random_streams import SPLITS, TEST, VALIDATION, Split, make_evaluation_rngs, parse_split
from helpers.system.paths import ROOT

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"


def first_bytes(split: Split, seed: int, count: int = 300) -> set[bytes]:
    return {each.bytes(16) for each in make_evaluation_rngs(split, seed, range(count))}


def test_splits_and_seeds_share_no_episode() -> None:
    drawn = [first_bytes(split, seed) for split in SPLITS for seed in (0, 1, 7, 2**31)]
    assert len(set.union(*drawn)) == 8 * 300


def test_training_shares_no_episode_with_a_split(rng: np.random.Generator) -> None:
    """Whatever its seeds: only the splits have a spawn key."""
    of_splits = first_bytes(VALIDATION, 0) | first_bytes(TEST, 0)
    seeds = [
        *range(2000),
        *([0, number] for number in range(300)),
        *([0, number, 2] for number in range(300)),
    ]
    trained_on = {
        np.random.default_rng(seed).bytes(16) for seed in [*seeds, *rng.integers(2**31, size=2000).tolist()]
    }
    assert not of_splits & trained_on


def test_an_episode_follows_from_split_seed_and_number() -> None:
    (alone,) = make_evaluation_rngs(TEST, 5, [17])
    assert alone.bytes(16) == make_evaluation_rngs(TEST, 5, range(20))[17].bytes(16)


@pytest.mark.slow
def test_results_name_their_split() -> None:
    test, validation = (
        evaluate(ENVIRONMENT, "zero", "revised", 2, 0, split=split) for split in (TEST, VALIDATION)
    )
    assert (test.split, validation.split) == ("test", "validation")
    assert test.reward_mean != validation.reward_mean
    assert evaluate(ENVIRONMENT, "zero", "revised", 2, 0) == test


def test_an_unknown_split_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown split 'shown'; allowed: validation, test"):
        parse_split("shown")


def test_all_random_streams_are_in_one_module() -> None:
    module = "system/random_streams.py"
    folder = ROOT / "src" / "avrgym"
    others = [
        path for path in folder.rglob("*.py") if "skeletons" not in path.parts and path != folder / module
    ]
    found = [path for path in others if "default_rng(" in path.read_text(encoding="utf-8")]
    assert found == []


def test_streams_of_a_training_differ() -> None:
    streams = (
        random_streams.make_training_episode_rng(4),
        random_streams.make_episode_seed_rng(4, 0),
        random_streams.make_imitation_rng(4, 0),
        random_streams.make_failed_episode_rng(4, 0),
        random_streams.make_robot_noise_rng(4, 0, 0),
        random_streams.make_human_noise_rng(4, 0, 0),
    )
    assert len({stream.bytes(16) for stream in streams}) == len(streams)
