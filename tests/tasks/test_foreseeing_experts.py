from dataclasses import fields

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.tasks.episodes import Episodes
from avrgym.tasks.experts.foreseeing import AHEAD_STEPS, PLACES, ROTATIONS, foreseeing
from avrgym.tasks.known import ENVIRONMENTS

COUNT = 6
PERSON = (*PLACES, *ROTATIONS)


class Recorder:
    """An expert that does nothing, and keeps what it sees."""

    def __init__(self, episodes):
        self.episodes, self.seen = episodes, []

    def __call__(self, observation):
        self.seen.append(self.episodes.state())
        return np.zeros((COUNT, len(self.episodes.scene.arm.joints)))


def watched(environment: str, people: str, steps: int, impairment: str = "none"):
    """What a foreseeing expert saw at each step, and what there was to see."""
    episodes = Episodes(environment, COUNT, distribution=people, impairment=impairment, num_threads=1)
    episodes.begin(np.arange(COUNT), [np.random.default_rng([3, i]) for i in range(COUNT)])
    recorders = []

    def expert(running):
        recorders.append(Recorder(running))
        return recorders[0]

    controller, there = foreseeing(expert)(episodes), []
    for _ in range(steps):
        there.append(episodes.state())
        episodes.step(controller(episodes.observe()))
    return recorders[0].seen, there


def mouths(states) -> np.ndarray:
    return np.array([state.mouth_pos_w for state in states])


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_who_rests_is_seen_as_they_are(environment):
    seen, there = watched(environment, "revised", 4)
    for saw, was in zip(seen, there, strict=True):
        for name in PERSON:
            assert_allclose(getattr(saw, name), getattr(was, name), atol=1e-6)


def test_all_but_the_person_is_seen_as_it_is():
    seen, there = watched("avrgym/FeedingJaco-v1", "zoo/train/talking", 4)
    for name in {field.name for field in fields(there[-1])} - {*PERSON, "placed_pos_w"}:
        assert_array_equal(getattr(seen[-1], name), getattr(there[-1], name))


def test_a_tremor_is_hardly_seen():
    seen, there = watched("avrgym/FeedingJaco-v1", "revised", 12, "tremor")

    def swing_m(states):
        return np.ptp(mouths(states[6:]), axis=0).max()

    assert swing_m(there) > 0.005
    assert swing_m(seen) < 0.2 * swing_m(there)


@pytest.mark.parametrize("people", ["zoo/train/distracted", "zoo/train/talking", "zoo/train/restless"])
def test_who_moves_is_seen_where_they_will_be(people):
    """Who looks about comes to less than half as far from where they are seen as from where they are."""
    seen, there = watched("avrgym/FeedingJaco-v1", people, 100)
    come, was, saw = mouths(there[AHEAD_STEPS:]), mouths(there[:-AHEAD_STEPS]), mouths(seen[:-AHEAD_STEPS])
    moved_m, missed_m = (np.linalg.norm(come - each, axis=-1) for each in (was, saw))
    moves = moved_m > 0.01
    assert moves.sum() > 50
    assert missed_m[moves].mean() < 0.5 * moved_m[moves].mean()


def test_a_body_is_seen_whole():
    """Whatever moves, segments keep their lengths, and the mouth its distance from the head."""
    seen, there = watched("avrgym/ScratchItchJaco-v1", "zoo/train", 30)
    for saw, was in zip(seen, there, strict=True):
        for of in (
            lambda state: state.person_segment_w[:, :, 1] - state.person_segment_w[:, :, 0],
            lambda state: state.mouth_pos_w - state.head_pos_w,
        ):
            lengths = [np.linalg.norm(of(state), axis=-1) for state in (saw, was)]
            assert_allclose(*lengths, atol=2e-3)


def test_looking_ahead_changes_nothing():
    def lived(looks: bool) -> np.ndarray:
        episodes = Episodes("avrgym/DrinkingJaco-v1", 4, distribution="zoo/train", num_threads=1)
        episodes.begin(np.arange(4), [np.random.default_rng([5, i]) for i in range(4)])
        for _ in range(30):
            if looks:
                episodes.people_ahead(3)
            episodes.step(np.zeros((4, 7)))
        return episodes.observe()

    assert_array_equal(lived(True), lived(False))
