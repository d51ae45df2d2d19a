"""The environments in LeRobot's convention."""

import json

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.envs.lerobot_environment import LeRobotEnv
from avrgym.policies.lerobot import split_state_features
from helpers.learning.lerobot_policies import has_modules, lerobot_python, run_lerobot
from helpers.system.paths import ROOT


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", ["avrgym/FeedingJaco-v1", "avrgym/BedBathingPR2-v1"])
def test_observations_contain_the_environments_values(environment: str) -> None:
    converted = LeRobotEnv(environment, people="revised", episode_steps=2)
    original = gym.make(environment, people="revised")
    (found, _), (expected, _) = converted.reset(seed=3), original.reset(seed=3)
    parts = split_state_features(converted.observation_description, expected.astype(np.float32))
    assert_array_equal(found["agent_pos"], parts["observation.state"])
    assert_array_equal(found["environment_state"], parts["observation.environment_state"])
    action = np.full(7, 0.5, np.float32)
    (_, reward, _, first_end, info), (_, same, *_) = converted.step(action), original.step(action)
    assert (reward, first_end, info["is_success"]) == (same, False, False)
    *_, second_end, _ = converted.step(action)
    assert second_end
    assert found in converted.observation_space
    assert converted.task_description.startswith("Help the person: ")
    converted.close()
    original.close()


@pytest.mark.slow
def test_cameras_become_pixels() -> None:
    world = LeRobotEnv("avrgym/FeedingJaco-v1", cameras=["wrist:80x64", "scene"])
    observation, _ = world.reset(seed=0)
    assert {name: image.shape for name, image in observation["pixels"].items()} == {
        "wrist_rgb": (64, 80, 3),
        "scene_rgb": (64, 64, 3),
    }
    assert observation in world.observation_space
    world.close()


ROLLOUT = """
import json
import torch
from avrgym.envs.lerobot import AvrGymEnvConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import env_to_policy_features, preprocess_observation

config = AvrGymEnvConfig(task="FeedingJaco-v1", episode_length=2, cameras=["wrist:80x64"])
worlds = make_env(config, n_envs=2)["avrgym"][0]
observation = preprocess_observation(worlds.reset(seed=[0, 1])[0])
features = {name: list(each.shape) for name, each in env_to_policy_features(config).items()}
for _ in range(2):
    info = worlds.step(worlds.action_space.sample())[4]
print(json.dumps({
    "features": features, "task": list(worlds.call("task_description")), "steps": worlds.call("_max_episode_steps")[0],
    "observation": {name: list(each.shape[1:]) for name, each in observation.items()},
    "success": info["final_info"]["is_success"].tolist(),
}))
"""


@pytest.mark.slow
def test_lerobot_makes_the_environments(monkeypatch: pytest.MonkeyPatch) -> None:
    python = lerobot_python()
    if python is None or not has_modules(python, "mujoco", "msgspec", "rtbdata"):
        pytest.skip("LeRobot and AVR Gym are not in the same environment; AVRGYM_LEROBOT_PYTHON may name one")
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "src"))
    found = json.loads(run_lerobot(python, ROLLOUT, []).splitlines()[-1])
    shapes = {
        "observation.state": [15],
        "observation.environment_state": [10],
        "observation.images.wrist_rgb": [3, 64, 80],
    }
    assert found == {
        "features": {"action": [7], **shapes},
        "task": ["Help the person: eat the food from the spoon."] * 2,
        "steps": 2,
        "observation": shapes,
        "success": [False, False],
    }
