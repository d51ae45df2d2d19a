"""The environments for programs that still use Gymnasium's forerunner ``gym``, such as robomimic's.

``gym.make("avrgym.envs.old_gym:avrgym/FeedingJaco-v1")`` imports this module, which registers them. They have the calls
of that time: ``reset`` gives the observation alone, ``step`` four values.
"""

# gym has no types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportMissingImports=false
# pyright: reportUntypedBaseClass=false

from typing import Any

import gym
import gymnasium
import numpy as np
from gym.envs.registration import register

from avrgym.array_types import FloatArray, NumpyArray
from avrgym.tasks.registry import ENVIRONMENTS


class OldEnvironment(gym.Env):
    """An environment with the old calls; ``arguments`` are those of the new one."""

    metadata = {"render_modes": ("rgb_array",)}  # noqa: RUF012

    def __init__(self, environment_id: str, **arguments: Any) -> None:
        given: dict[str, Any] = {"render_mode": "rgb_array", **arguments}
        self._env = gymnasium.make(environment_id, **given)
        self._seed: int | None = None
        self._success = False
        seen, acted = self._env.observation_space, self._env.action_space
        assert isinstance(seen, gymnasium.spaces.Box)
        assert isinstance(acted, gymnasium.spaces.Box)
        self.observation_space = gym.spaces.Box(seen.low, seen.high, dtype=np.float64)
        self.action_space = gym.spaces.Box(acted.low, acted.high, dtype=np.float32)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Let the next episode begin with a seed."""
        self._seed = seed
        return [seed]

    def reset(self) -> FloatArray:
        """Begin an episode."""
        observation, _ = self._env.reset(seed=self._seed)
        self._seed, self._success = None, False
        return observation

    def step(self, action: NumpyArray) -> tuple[FloatArray, float, bool, dict[str, Any]]:
        """Do an action; the third value says that the episode is over."""
        observation, reward, terminated, truncated, info = self._env.step(np.asarray(action, np.float32))
        self._success = bool(info["success"])
        return observation, float(reward), terminated or truncated, info

    def _check_success(self) -> dict[str, bool]:
        """Whether the robot has succeeded so far, as robomimic asks for it."""
        return {"task": self._success}

    def render(self, mode: str = "rgb_array", **_size: Any) -> Any:
        """A picture."""
        return self._env.render()

    def close(self) -> None:
        """Let it go."""
        self._env.close()


for _environment in ENVIRONMENTS:
    register(
        _environment,
        entry_point=OldEnvironment,
        kwargs={"environment_id": _environment},
        disable_env_checker=True,
    )
