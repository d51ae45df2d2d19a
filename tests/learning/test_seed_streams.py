"""Laws of the streams: the same names give the same bits, and no episode belongs to two of them."""

import numpy as np
import pytest

from avrgym.learning.evaluation import evaluate
from avrgym.learning.seed_streams import CHOOSING, SHOWING, Stream, episode_generators, stream_of

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"


def beginnings(stream: Stream, seed: int, count: int = 300) -> set[bytes]:
    return {each.bytes(16) for each in episode_generators(stream, seed, range(count))}


def test_no_episode_belongs_to_two_streams_or_seeds() -> None:
    drawn = [beginnings(stream, seed) for stream in (CHOOSING, SHOWING) for seed in (0, 1, 7, 2**31)]
    assert len(set.union(*drawn)) == 8 * 300


def test_no_training_meets_an_episode_of_either(rng: np.random.Generator) -> None:
    """Whatever seeds it draws: it has no spawn key."""
    of_streams = beginnings(CHOOSING, 0) | beginnings(SHOWING, 0)
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
    (alone,) = episode_generators(SHOWING, 5, [17])
    assert alone.bytes(16) == episode_generators(SHOWING, 5, range(20))[17].bytes(16)


def test_figures_are_of_the_stream_that_they_name() -> None:
    shown, chosen = (
        evaluate(ENVIRONMENT, "zero", "revised", 2, 0, stream=stream) for stream in (SHOWING, CHOOSING)
    )
    assert (shown.stream, chosen.stream) == ("showing", "choosing")
    assert shown.reward_mean != chosen.reward_mean
    assert evaluate(ENVIRONMENT, "zero", "revised", 2, 0) == shown


def test_an_unknown_stream_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown stream 'shown'; allowed: choosing, showing"):
        stream_of("shown")
