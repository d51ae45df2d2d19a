"""The controller is registered, and drives a whole episode, the same way for the same seed."""

from avrgym.learning.evaluation import evaluate_all

ENVIRONMENT = "avrgym/FeedingJaco-v1"


def test_it_drives_an_episode() -> None:
    first, again = (evaluate_all([ENVIRONMENT], "wave-arm", "revised", 1, 0, jobs=1) for _ in range(2))
    assert first == again
