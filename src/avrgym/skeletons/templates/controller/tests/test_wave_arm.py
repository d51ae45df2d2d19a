"""Tests of the controller: it is registered, and the same seed gives the same episode."""

from avrgym.learning.evaluation import evaluate_all

ENVIRONMENT = "avrgym/FeedingJaco-v1"


def test_same_seed_gives_same_episode() -> None:
    first, again = (evaluate_all([ENVIRONMENT], "wave-arm", "revised", 1, 0, jobs=1) for _ in range(2))
    assert first == again
