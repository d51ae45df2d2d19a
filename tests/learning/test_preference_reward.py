"""The reward of participants' preferences in training."""

import json
from pathlib import Path

import numpy as np
import pytest

from avrgym.learning.preference_reward import REWARD_PER_LOG_ODDS, read_preference_weights
from avrgym.learning.rollouts import RolloutRequest, WorldSettings, roll_out
from avrgym.policies.registry import resolve_policy
from avrgym.policies.trained_policies import Policy
from avrgym.system.transferred_files import TransferredFile

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"


def write(file: Path, task: str, weights: dict[str, float]) -> Path:
    file.write_text(json.dumps([{"task": task, "weights": weights}]))
    return file


def test_files_without_weights_of_the_task_are_refused(tmp_path: Path) -> None:
    weights = {"tool_speed_m_s": -2.0, "force_on_person_n": -0.5}
    file = write(tmp_path / "r.json", "ScratchItch", weights)
    assert read_preference_weights(file, ENVIRONMENT) == weights
    with pytest.raises(
        ValueError,
        match=r"contains weights of ScratchItch; allowed for avrgym/FeedingJaco-v1: weights of Feeding",
    ):
        read_preference_weights(file, "avrgym/FeedingJaco-v1")
    with pytest.raises(ValueError, match=r"unknown reward terms smile; allowed: .*force_on_person_n"):
        read_preference_weights(write(file, "ScratchItch", {"smile": 1.0}), ENVIRONMENT)
    file.write_text("[1]")
    with pytest.raises(ValueError, match="allowed: a file of `avrgym fit-reward`"):
        read_preference_weights(file, "avrgym/FeedingJaco-v1")


def test_training_rewards_contain_the_preferences() -> None:
    policy = resolve_policy("revised", ENVIRONMENT)
    assert isinstance(policy, Policy)
    weights = {"tool_speed_m_s": -2.0, "force_on_person_n": -0.5}
    settings = WorldSettings(ENVIRONMENT, TransferredFile.read("original"), episode_steps=20)
    seeds = np.array([3, 4])
    plain, preferred = (
        roll_out(policy, RolloutRequest(settings, 0, seeds, preference_weights=each))
        for each in ({}, weights)
    )
    np.testing.assert_array_equal(plain.observations, preferred.observations)
    np.testing.assert_array_equal(plain.episode_return, preferred.episode_return)
    halved = {name: weight / 2.0 for name, weight in weights.items()}
    request = RolloutRequest(settings, 0, seeds, preference_weights=halved)
    differences = preferred.rewards - plain.rewards
    assert (differences.sum(axis=0) < -0.01 * REWARD_PER_LOG_ODDS).all()
    np.testing.assert_allclose(
        roll_out(policy, request).rewards - plain.rewards, differences / 2.0, atol=1e-4
    )
