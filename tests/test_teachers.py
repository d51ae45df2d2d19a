import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.episodes import EPISODE_STEPS, Episodes
from avrgym.tasks import ENVIRONMENTS, TASKS
from avrgym.teachers import TEACHERS


def begun(environment: str, count: int) -> Episodes:
    """Episodes with revised people."""
    episodes = Episodes(environment, count, distribution="revised", num_threads=1)
    episodes.begin(np.arange(count), [np.random.default_rng([6, i]) for i in range(count)])
    return episodes


def test_every_task_has_a_teacher():
    assert set(TEACHERS) == set(TASKS)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_what_a_teacher_does_depends_on_nothing_but_the_present(environment):
    """One that saw everything so far and one that comes in now do the same."""
    episodes = begun(environment, 2)
    make = TEACHERS[episodes.task.name]
    teacher = make(episodes)
    for _ in range(30):
        episodes.step(teacher(episodes.observe()))
    expected = make(episodes)(episodes.observe())
    assert_array_equal(teacher(episodes.observe()), expected)
    assert np.abs(expected).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_teacher_brings_the_tool_nearer(environment):
    episodes = begun(environment, 8)
    teacher = TEACHERS[episodes.task.name](episodes)
    distances = [episodes.step(teacher(episodes.observe())).distance_m.mean() for _ in range(60)]
    assert distances[-1] < 0.5 * distances[0]


@pytest.mark.parametrize("task", ["Feeding", "ScratchItch", "BedBathing"])
def test_a_teacher_mostly_succeeds(task):
    episodes = begun(f"avrgym/{task}Jaco-v1", 16)
    teacher = TEACHERS[task](episodes)
    success = np.zeros(16, dtype=bool)
    for _ in range(EPISODE_STEPS):
        success = episodes.step(teacher(episodes.observe())).success
    assert success.mean() >= 0.5
