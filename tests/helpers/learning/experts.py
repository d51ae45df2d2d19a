"""Comparison of experts."""

from numpy.testing import assert_array_equal

from avrgym.tasks.episodes import Episodes
from avrgym.tasks.task import Expert


def assert_matches_feedback_expert(expert: Expert, episodes: Episodes, steps: int) -> None:
    """Assert that an expert returns the actions of the task's feedback expert."""
    act, feedback = expert(episodes), episodes.task.feedback_expert(episodes)
    for _ in range(steps):
        observation = episodes.observe()
        action = act(observation)
        assert_array_equal(action, feedback(observation))
        episodes.step(action)
