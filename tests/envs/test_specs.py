"""`spec` contains plain data; an environment from its JSON has the same episodes."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_array_equal

import avrgym
from avrgym.envs.specs import to_json_types
from avrgym.models.human import SEATED_POSE_RAD, Person

FEEDING = "avrgym/FeedingJaco-v1"
TALL = Person("man", 0.63, SEATED_POSE_RAD + np.linspace(0.0, 0.01, 20), "olive", 1.02)
PLAIN = json.loads(json.dumps(to_json_types(TALL)))
ARGUMENTS: list[dict[str, Any]] = [
    {},
    {"people": "zoo/train/startled", "impairment": "tremor", "render_mode": "rgb_array"},
    {"person": TALL, "max_episode_steps": 7},
    {"person": PLAIN},
    {"person": {"sex": "man"}},
]
OF_MANY = [
    {"num_envs": 2, "autoreset_mode": mode, "num_threads": 1, "engine": "threads"} for mode in AutoresetMode
] + [{"num_envs": np.int64(2), "autoreset_mode": "Disabled", "max_episode_steps": np.int32(9)}]


def assert_same_episode(one: Any, other: Any) -> None:
    first, _ = one.reset(seed=5)
    assert_array_equal(first, other.reset(seed=5)[0])
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (5, *one.action_space.shape)).astype(np.float32)
    for action in actions:
        for mine, theirs in zip(one.step(action)[:4], other.step(action)[:4], strict=True):
            assert_array_equal(mine, theirs)


@pytest.mark.parametrize("how", ARGUMENTS, ids=str)
def test_a_spec_as_json_makes_the_same_episodes(how: Mapping[str, Any]) -> None:
    env = gym.make(FEEDING, **how)
    assert env.spec is not None
    text = env.spec.to_json()
    made_again = gym.make(EnvSpec.from_json(text))
    assert made_again.spec is not None
    assert made_again.spec.to_json() == text
    assert_same_episode(env, made_again)


@pytest.mark.parametrize("how", OF_MANY, ids=str)
@pytest.mark.parametrize("person", [None, TALL, PLAIN], ids=["", "person", "plain"])
@pytest.mark.fast_cases(4)
def test_a_spec_of_many_worlds_as_json_makes_the_same_episodes(how: Mapping[str, Any], person: Any) -> None:
    env = gym.make_vec(FEEDING, person=person, **how)
    assert env.spec is not None
    text = env.spec.to_json()
    made_again = gym.make_vec(EnvSpec.from_json(text))
    assert made_again.spec is not None
    assert made_again.spec.to_json() == text
    assert made_again.metadata["autoreset_mode"] is env.metadata["autoreset_mode"]
    assert_same_episode(env, made_again)


def test_a_person_in_plain_values_is_that_person() -> None:
    assert_same_episode(gym.make(FEEDING, person=TALL), gym.make(FEEDING, person=PLAIN))
    many = (gym.make_vec(FEEDING, num_envs=2, num_threads=1, person=each) for each in (TALL, PLAIN))
    assert_same_episode(*many)
    pair = [avrgym.parallel_env(FEEDING, person=each).reset(seed=1)[0] for each in (TALL, PLAIN)]
    assert_array_equal(pair[0]["robot"], pair[1]["robot"])


@pytest.mark.parametrize("make", [gym.make, gym.make_vec, avrgym.parallel_env])
@pytest.mark.parametrize(
    ("person", "message"),
    [
        (
            {"sex": "man", "height": 1.8},
            "unknown field height of a person; allowed: sex, torso_height_m, joint_angles_rad",
        ),
        ({"sex": "child"}, "unknown sex 'child'; allowed: man, woman"),
        ({"torso_height_m": 2.0}, "the torso height is 2.000 m; allowed: "),
        ({"joint_angles_rad": [0.0]}, r"joint_angles_rad has the shape"),
    ],
)
def test_values_that_nobody_has_are_refused(make: Any, person: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(FEEDING, person=person)


def test_whatever_is_given_becomes_plain() -> None:
    given = {
        "path": Path("a/b"),
        "mode": AutoresetMode.DISABLED,
        "count": np.int8(3),
        "two": (np.ones(2), None),
    }
    assert to_json_types(given) == {"path": "a/b", "mode": "Disabled", "count": 3, "two": [[1.0, 1.0], None]}
    assert json.dumps(to_json_types(given))
