"""Environments are copied and pickled in the middle of an episode: the copy continues with the same bits."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.vector_environments import assert_same_pair

HOW = {"deep copy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}
PEOPLE = ("revised", "participants", "zoo/train")
CASES = [
    (environment, [*HOW][i % 2], PEOPLE[i % 3], list(AutoresetMode)[i % 2])
    for i, environment in enumerate(ENVIRONMENTS)
]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("environment", "how", "people", "mode"), CASES)
def test_a_copy_of_many_worlds_goes_on_to_the_same_bits(environment, how, people, mode, rng) -> None:
    """Through the rest of the episode and into the next, whatever the first one does meanwhile."""
    kept = gym.make_vec(
        environment, num_envs=2, people=people, impairment="tremor", autoreset_mode=mode, max_episode_steps=9
    )
    kept.reset(seed=3)
    shape = kept.action_space.shape
    assert shape is not None
    actions = rng.uniform(-1, 1, (12, *shape)).astype(np.float32)
    for action in actions[:5]:
        kept.step(action)
    copied = HOW[how](kept)
    assert copied.np_random_seed == kept.np_random_seed
    for number, action in enumerate(actions[5:]):
        assert_same_pair(copied.step(action), kept.step(action), f"step {number}")
    assert_same_pair(copied.reset(), kept.reset(), "reset")


@pytest.mark.parametrize("how", HOW)
def test_a_copy_of_one_world_goes_on_to_the_same_bits(how, rng) -> None:
    kept = gym.make("avrgym/DrinkingJaco-v1", people="participants")
    kept.reset(seed=3)
    actions = rng.uniform(-1, 1, (8, 7)).astype(np.float32)
    for action in actions[:4]:
        kept.step(action)
    copied = HOW[how](kept)
    for action in actions[4:]:
        one, other = copied.step(action), kept.step(action)
        assert (one[0] == other[0]).all()
        assert one[1:] == other[1:]
    assert (copied.reset()[0] == kept.reset()[0]).all()


def test_an_environment_that_never_began_is_copied_too() -> None:
    fresh = gym.make_vec("avrgym/FeedingJaco-v1", num_envs=2)
    assert_same_pair(copy.deepcopy(fresh).reset(seed=1), fresh.reset(seed=1), "reset")
