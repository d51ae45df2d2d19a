"""The memory-based expert for feeding keeps its distance while the mouth moves."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.safety.limits import QUASI_STATIC_LIMIT_N
from avrgym.safety.region_forces import RegionLoadRecorder
from avrgym.tasks.experts.filtered_expert import filter_tremor
from avrgym.tasks.feeding.memory_expert import (
    MAX_RESTING_MOUTH_SPEED_M_S,
    MAX_STANDOFF_M,
    FeedingMemoryExpert,
    compute_standoff_from_mouth_m,
)
from avrgym.tasks.task import Expert
from helpers.learning.experts import assert_matches_feedback_expert
from helpers.simulation.initial_states import reset_episodes

WORLDS = 12
FEEDING = "avrgym/FeedingPR2-v1"


def test_the_standoff_grows_with_the_mouth_speed():
    speeds = np.linspace(0.0, 0.5, 101)
    off = compute_standoff_from_mouth_m(speeds)
    assert (np.diff(off) >= 0.0).all()
    assert not off[speeds <= MAX_RESTING_MOUTH_SPEED_M_S].any()
    assert_array_equal(off[speeds >= 2.0 * MAX_RESTING_MOUTH_SPEED_M_S + 1e-9], MAX_STANDOFF_M)


@pytest.mark.slow
def test_resting_people_are_fed_like_the_feedback_expert():
    assert_matches_feedback_expert(FeedingMemoryExpert, reset_episodes(FEEDING, WORLDS), 30)


def fed(expert: Expert) -> tuple[float, float]:
    """People who come to meet the spoon: the share of them that it feeds, and the mean force on them."""
    episodes = reset_episodes(FEEDING, WORLDS, "participants", by_region=True)
    feeds, watch, force_n = filter_tremor(expert)(episodes), RegionLoadRecorder(WORLDS), 0.0
    for _ in range(100):
        step = episodes.step(np.clip(feeds(episodes.observe()), -1.0, 1.0), watch)
        force_n += float(step.force_on_person_n.mean()) / 100
    largest = (watch.compute_loads().peak_force_n / QUASI_STATIC_LIMIT_N).max(axis=-1)
    assert step.success.all()
    return float(np.median(largest)), force_n


@pytest.mark.slow
def test_people_who_lean_forward_feel_less_force():
    task = reset_episodes(FEEDING, 1).task
    assert task.memory_expert is not None
    reactive, patient = fed(task.feedback_expert), fed(task.memory_expert)
    assert patient[0] < 0.5 * reactive[0]
    assert patient[1] < 0.5 * reactive[1]
