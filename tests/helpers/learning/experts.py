"""Experts side by side."""

from numpy.testing import assert_array_equal

from avrgym.tasks.episodes import Episodes
from avrgym.tasks.task import Expert


def assert_matches_feedback_expert(expert: Expert, episodes: Episodes, steps: int) -> None:
    """The expert does what the task's reactive one would, step by step."""
    acts, reactive = expert(episodes), episodes.task.feedback_expert(episodes)
    for _ in range(steps):
        observation = episodes.observe()
        action = acts(observation)
        assert_array_equal(action, reactive(observation))
        episodes.step(action)
