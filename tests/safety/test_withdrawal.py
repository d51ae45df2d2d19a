"""Robots withdraw their tools after success where going on helps nobody, and only there."""

from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.array_types import BoolArray
from avrgym.policies import registry
from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.safety.retreat import RETREAT_TOOL_SPEED_M_S
from avrgym.safety.withdrawal import FINAL_MOUTH_DISTANCE_M, SETTLING_TIME_S
from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, TASKS, find_environment

SEEDS = (0, 3)
STEPS = 190
WITHDRAWN_STEPS = 40
"""So many control steps after its beginning each withdrawal is over."""
BRAKED_STEPS = 3
"""Control steps within which an arm goes from the policy's speed to that of the withdrawal."""
FEEDING = "avrgym/FeedingJaco-v1"
WITH_POLICIES = [name for name in ENVIRONMENTS if "revised" in find_packaged_policies(name)]
ENDING = [name for name in WITH_POLICIES if TASKS[find_environment(name)[0]].withdraws_tool_after_success]
GOING_ON = [name for name in WITH_POLICIES if name not in ENDING]


def reset_episodes(environment: str, *, withdraws: bool, engine: str = "threads") -> Episodes:
    episodes = Episodes(
        environment,
        len(SEEDS),
        people="revised",
        num_threads=1,
        withdraw_after_success=withdraws,
        engine=engine,
    )
    episodes.reset(np.arange(len(SEEDS)), generators())
    return episodes


def generators() -> list[np.random.Generator]:
    return [np.random.default_rng(seed) for seed in SEEDS]


@dataclass
class Course:
    """Whole episodes: each step, and in which worlds (N,) the withdrawal drove it."""

    steps: list[StepOutcome]
    driven: list[BoolArray]


def course(environment: str, policy: str, *, withdraws: bool, steps: int = STEPS) -> Course:
    episodes = reset_episodes(environment, withdraws=withdraws)
    found = Course([], [])
    with registry.open_policy(registry.resolve_policy(policy, environment), episodes, generators()) as act:
        for _ in range(steps):
            found.driven.append(episodes.control_loop.withdrawing_mask)
            found.steps.append(episodes.step(act(episodes.observe()).astype(float)))
    return found


def assert_withdraws(environment: str, policy: str) -> None:
    """Law: after success the tool leaves slowly, to where it touches nobody, and nothing is rewarded any more."""
    found = course(environment, policy, withdraws=True)
    success = np.stack([step.success for step in found.steps])
    driven = np.stack(found.driven)
    settled_steps = np.argmax(driven, axis=0) - np.argmax(success, axis=0)
    over = driven.sum(axis=0) > WITHDRAWN_STEPS
    assert over.any()
    assert (settled_steps[over] > 10 * SETTLING_TIME_S).all()
    slowed = np.zeros_like(driven)
    slowed[BRAKED_STEPS:] = driven[:-BRAKED_STEPS]
    for step, withdrawing, steady in zip(found.steps, found.driven, slowed, strict=True):
        assert (step.reward[withdrawing] == 0.0).all()
        assert (step.tool_speed_m_s[steady] < RETREAT_TOOL_SPEED_M_S + 0.02).all()
    last = found.steps[-1]
    assert (last.force_on_person_n[over] == 0.0).all()
    assert (last.distance_m[over] > FINAL_MOUTH_DISTANCE_M - 0.02).all()
    assert (last.tool_speed_m_s[over] < 0.01).all()


def test_the_feeding_robot_withdraws_after_success() -> None:
    assert_withdraws(FEEDING, "revised")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "policy"),
    [
        (name, kind)
        for name in ENDING
        for kind in ("revised", "adaptive")
        if kind in find_packaged_policies(name)
    ],
)
def test_every_robot_withdraws_in_tasks_that_end_with_success(environment: str, policy: str) -> None:
    assert_withdraws(environment, policy)


def test_only_feeding_and_drinking_end_with_success() -> None:
    assert {name for name, task in TASKS.items() if task.withdraws_tool_after_success} == {
        "Feeding",
        "Drinking",
    }


@pytest.mark.slow
@pytest.mark.parametrize("environment", GOING_ON)
def test_other_tasks_go_on_to_the_same_bits(environment: str) -> None:
    with_it, without = (course(environment, "revised", withdraws=choice) for choice in (True, False))
    for one, other in zip(with_it.steps, without.steps, strict=True):
        assert_array_equal(one.observation, other.observation)
        assert_array_equal(one.reward, other.reward)


def test_until_then_no_bit_differs() -> None:
    with_it, without = (course(FEEDING, "revised", withdraws=choice, steps=60) for choice in (True, False))
    first = int(np.argmax(np.stack(with_it.driven).any(axis=1)))
    assert first > 0
    for one, other in zip(with_it.steps[:first], without.steps[:first], strict=True):
        assert_array_equal(one.observation, other.observation)
        assert_array_equal(one.reward, other.reward)


def test_a_copy_goes_on_withdrawing_to_the_same_bits() -> None:
    episodes = reset_episodes(FEEDING, withdraws=True)
    with registry.open_policy(registry.resolve_policy("revised", FEEDING), episodes, generators()) as act:
        while not episodes.control_loop.withdrawing_mask.all():
            episodes.step(act(episodes.observe()).astype(float))
        for _ in range(3):
            episodes.step(act(episodes.observe()).astype(float))
    copy, nothing = deepcopy(episodes), np.zeros((len(SEEDS), episodes.action_size))
    for _ in range(20):
        assert_array_equal(copy.step(nothing).observation, episodes.step(nothing).observation)


def test_a_new_episode_is_driven_by_its_policy() -> None:
    episodes = reset_episodes(FEEDING, withdraws=True)
    with registry.open_policy(registry.resolve_policy("revised", FEEDING), episodes, generators()) as act:
        while not episodes.control_loop.withdrawing_mask.all():
            episodes.step(act(episodes.observe()).astype(float))
    episodes.reset(np.array([1]), [np.random.default_rng(8)])
    assert episodes.control_loop.withdrawing_mask.tolist() == [True, False]


def test_other_engines_refuse_it() -> None:
    with pytest.raises(ValueError, match="withdraw_after_success is not possible with engine 'warp:cpu'"):
        reset_episodes(FEEDING, withdraws=True, engine="warp:cpu")
