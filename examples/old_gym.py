"""AVR Gym's environments for programs that use ``gym`` 0.26, such as robomimic.

``gym.make("old_gym:avrgym/FeedingJaco-v1")`` imports this file, if its folder is on the Python path, and the file
registers the environments. ``reset`` returns the observation alone; ``step`` returns four values.

Needs ``pip install avrgym gym==0.26.2``.
"""

from typing import Any

import gym
import gymnasium
import numpy as np
from gym.envs.registration import register

from avrgym.array_types import FloatArray, NumpyArray
from avrgym.tasks.registry import ENVIRONMENTS


class OldEnvironment(gym.Env):
    """One environment with the methods of ``gym``; ``arguments`` are those of ``gymnasium.make``."""

    metadata = {"render_modes": ("rgb_array",)}  # noqa: RUF012

    def __init__(self, environment_id: str, **arguments: Any) -> None:
        self._env = gymnasium.make(environment_id, **{"render_mode": "rgb_array", **arguments})
        self._seed: int | None = None
        self._success = False
        observations, actions = self._env.observation_space, self._env.action_space
        assert isinstance(observations, gymnasium.spaces.Box)
        assert isinstance(actions, gymnasium.spaces.Box)
        self.observation_space = gym.spaces.Box(observations.low, observations.high, dtype=np.float64)
        self.action_space = gym.spaces.Box(actions.low, actions.high, dtype=np.float32)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the next episode."""
        self._seed = seed
        return [seed]

    def reset(self) -> FloatArray:
        """Start an episode and return its first observation."""
        observation, _ = self._env.reset(seed=self._seed)
        self._seed, self._success = None, False
        return observation

    def step(self, action: NumpyArray) -> tuple[FloatArray, float, bool, dict[str, Any]]:
        """Return observation, reward, whether the episode is over, and the info."""
        observation, reward, terminated, truncated, info = self._env.step(np.asarray(action, np.float32))
        self._success = bool(info["success"])
        return observation, float(reward), terminated or truncated, info

    def _check_success(self) -> dict[str, bool]:
        """Return whether the robot has succeeded so far; robomimic calls this method."""
        return {"task": self._success}

    def render(self, mode: str = "rgb_array", **_size: Any) -> Any:
        """Return an image."""
        return self._env.render()

    def close(self) -> None:
        """Close the environment."""
        self._env.close()


for _environment in ENVIRONMENTS:
    register(
        _environment,
        entry_point=OldEnvironment,
        kwargs={"environment_id": _environment},
        disable_env_checker=True,
    )
