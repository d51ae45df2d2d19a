"""Episodes of any length: one world and many end at the requested step, which ``spec`` states."""

from collections.abc import Callable
from itertools import cycle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_array_equal

from avrgym.envs.single import AssistiveEnv
from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.people.population_names import POPULATION_NAMES
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.registry import ENVIRONMENTS

FEEDING = "avrgym/FeedingJaco-v1"
STILL = np.zeros(7, np.float32)


def one(**how: Any) -> gym.Env:
    return gym.make(FEEDING, **how)


def many(**how: Any) -> gym.vector.VectorEnv:
    return gym.make_vec(FEEDING, autoreset_mode=AutoresetMode.DISABLED, num_threads=1, **how)


def again(make: Callable[..., Any]) -> Callable[..., Any]:
    """Made by the spec of what was made so."""
    by = gym.make if make is one else gym.make_vec
    return lambda **how: by(make(**how).spec)


def steps_until_the_end(env: Any, most: int) -> int | None:
    env.reset(seed=0)
    action = np.broadcast_to(STILL, env.action_space.shape)
    for number in range(1, most + 1):
        *_, terminated, truncated, _ = env.step(action)
        assert not np.any(terminated)
        if np.all(truncated):
            return number
    return None


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("steps", [1, 3, EPISODE_STEPS + 5])
@pytest.mark.parametrize(
    "make", [one, many, again(one), again(many)], ids=["make", "make_vec", "spec", "spec of many"]
)
def test_an_episode_is_as_long_as_was_asked_for(make: Callable[..., Any], steps: int) -> None:
    env = make(max_episode_steps=steps)
    assert env.spec.max_episode_steps == steps
    assert steps_until_the_end(env, steps + 1) == steps
    with pytest.raises(ResetNeeded):
        env.step(np.broadcast_to(STILL, env.action_space.shape))
    assert steps_until_the_end(env, steps + 1) == steps


@pytest.mark.parametrize("make", [one, many], ids=["make", "make_vec"])
def test_an_episode_may_have_no_end(make: Callable[..., Any]) -> None:
    assert steps_until_the_end(make(max_episode_steps=-1), EPISODE_STEPS + 5) is None


@pytest.mark.parametrize("make", [one, many], ids=["make", "make_vec"])
@pytest.mark.parametrize("steps", [0, -2, 2.5, "many"])
def test_a_length_that_none_has_is_refused(make: Callable[..., Any], steps: Any) -> None:
    with pytest.raises((ValueError, TypeError), match=r"max_episode_steps"):
        make(max_episode_steps=steps)


@pytest.mark.slow
@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_longer_episode_begins_as_the_usual_one(mode: AutoresetMode) -> None:
    """Two worlds, more steps than usual: the same bits up to the usual end, then the same episode goes on."""
    usual, longer = (
        AssistiveVectorEnv(
            FEEDING, 2, people="participants", num_threads=1, autoreset_mode=mode, max_episode_steps=steps
        )
        for steps in (EPISODE_STEPS, EPISODE_STEPS + 10)
    )
    assert_array_equal(usual.reset(seed=3)[0], longer.reset(seed=3)[0])
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (EPISODE_STEPS, 2, 7)).astype(np.float32)
    for action in actions[:-1]:
        assert_array_equal(usual.step(action)[0], longer.step(action)[0])
    ended, goes_on = usual.step(actions[-1]), longer.step(actions[-1])
    assert ended[3].all()
    assert not goes_on[3].any()
    last = np.stack(ended[4]["final_obs"]) if mode is AutoresetMode.SAME_STEP else ended[0]
    assert_array_equal(last, goes_on[0])


@pytest.mark.slow
@pytest.mark.parametrize(("environment", "people"), list(zip(ENVIRONMENTS, cycle(POPULATION_NAMES))))
def test_everybody_lives_on_for_twice_as_long(environment: str, people: str) -> None:
    env = gym.make_vec(environment, num_envs=2, people=people, max_episode_steps=2 * EPISODE_STEPS)
    env.reset(seed=0)
    for number in range(1, 2 * EPISODE_STEPS + 1):
        observation, reward, _, truncated, _ = env.step(env.action_space.sample())
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
        assert_array_equal(truncated, number == 2 * EPISODE_STEPS)


def test_what_makes_environments_without_gymnasium_has_the_usual_length() -> None:
    assert AssistiveEnv(FEEDING).max_episode_steps == EPISODE_STEPS
    assert AssistiveVectorEnv(FEEDING).max_episode_steps == EPISODE_STEPS
