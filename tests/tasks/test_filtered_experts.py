import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.experts.filtered_expert import (
    FILTERED_POSITION_FIELDS,
    FILTERED_ROTATION_FIELDS,
    filter_tremor,
)


class Recorder:
    """An expert that keeps what it sees."""

    def __init__(self, episodes):
        self.episodes, self.seen = episodes, []

    def __call__(self, observation):
        self.seen.append(self.episodes.get_state())
        return np.zeros((self.episodes.simulation.num_worlds, len(self.episodes.scene.arm.joints)))


def watched(impairment: str, steps: int):
    """What a steadied expert saw of people at each step, and what there was to see."""
    episodes = Episodes("avrgym/FeedingJaco-v1", 4, impairment=impairment, num_threads=1)
    episodes.reset(np.arange(4), [np.random.default_rng([3, i]) for i in range(4)])
    recorders = []

    def expert(running):
        recorders.append(Recorder(running))
        return recorders[0]

    controller, there = filter_tremor(expert)(episodes), []
    for _ in range(steps):
        there.append(episodes.get_state())
        episodes.step(controller(episodes.observe()))
    return recorders[0].seen, there


def test_resting_people_are_observed_unchanged():
    seen, there = watched("none", 4)
    for saw, was in zip(seen, there, strict=True):
        for name in (*FILTERED_POSITION_FIELDS, *FILTERED_ROTATION_FIELDS):
            assert_allclose(getattr(saw, name), getattr(was, name), atol=1e-12)


def test_tremor_is_filtered_out():
    seen, there = watched("tremor", 12)

    def extra_clearance_m(states):
        mouths = np.array([state.mouth_pos_w for state in states[6:]])
        return np.ptp(mouths, axis=0).max()

    assert extra_clearance_m(there) > 0.003
    assert extra_clearance_m(seen) < 0.2 * extra_clearance_m(there)


def test_the_tool_is_not_filtered():
    seen, there = watched("tremor", 3)
    assert_allclose(seen[-1].tool_pos_w, there[-1].tool_pos_w, atol=0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "impairment", "share"),
    [
        ("FeedingJaco", "tremor", 0.6),
        ("DrinkingPR2", "none", 0.35),
        ("ScratchItchJaco", "weakness", 0.6),
        ("BedBathingPR2", "tremor", 0.6),
    ],
)
def test_a_filtered_expert_often_succeeds(environment, impairment, share):
    """With the PR2's cup in 61 % of many episodes, in the others oftener."""
    episodes = Episodes(
        f"avrgym/{environment}-v1", 24, people="zoo/train", impairment=impairment, num_threads=1
    )
    episodes.reset(np.arange(24), [np.random.default_rng([6, i]) for i in range(24)])
    expert, success = filter_tremor(episodes.task.feedback_expert)(episodes), np.zeros(24, dtype=bool)
    for _ in range(EPISODE_STEPS):
        success = episodes.step(expert(episodes.observe())).success
    assert success.mean() >= share
