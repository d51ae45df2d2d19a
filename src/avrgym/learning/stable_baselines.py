"""Adapter of the native vector environment to the interface ``VecEnv`` of Stable-Baselines3."""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from avrgym.array_types import NumpyArray
from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.envs.vector_conventions import NO_TIME_LIMIT


class SB3VectorEnv(VecEnv):
    """The native vector environment for Stable-Baselines3.

    The infos of a finished episode contain ``success``, ``episode_return`` (the sum of its rewards) and
    ``episode_force_n``: the mean force on the person, in newtons.
    """

    def __init__(self, env: AssistiveVectorEnv) -> None:
        """Wrap the vector environment ``env``. Raises ``ValueError`` if its autoreset mode is not SAME_STEP, or if its
        episodes never end.
        """
        if env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"autoreset mode {env.autoreset_mode.name} does not fit Stable-Baselines3; allowed: "
                "gym.make_vec(..., autoreset_mode=AutoresetMode.SAME_STEP)"
            )
        if env.max_episode_steps == NO_TIME_LIMIT:
            raise ValueError(
                "Stable-Baselines3 needs episodes that end; allowed: max_episode_steps of 1 or more"
            )
        self.env = env  # the base class reads its render mode
        self._returns: NumpyArray = np.zeros(env.num_envs)
        self._forces_n: NumpyArray = np.zeros(env.num_envs)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: NumpyArray = np.zeros((env.num_envs, env.episodes.action_size))
        self._seed: int | None = None

    def seed(self, seed: int | None = None) -> list[int | None]:
        self._seed = seed
        return [None if seed is None else seed + i for i in range(self.num_envs)]

    def reset(self) -> Any:
        observation, _ = self.env.reset(seed=self._seed)
        self._seed = None
        self._returns[:], self._forces_n[:] = 0.0, 0.0
        return observation

    def step_async(self, actions: NumpyArray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Any, NumpyArray, NumpyArray, list[dict[str, Any]]]:
        observation, reward, _, truncated, info = self.env.step(self._actions)
        force_n: NumpyArray = info["force_on_person"]
        if truncated.any():
            final_n: NumpyArray = info["final_info"]["force_on_person"]
            force_n = np.where(truncated, final_n, force_n)
        self._returns += reward
        self._forces_n += force_n / self.env.max_episode_steps
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.nonzero(truncated)[0]:
            infos[i] = {
                "terminal_observation": info["final_obs"][i],
                "TimeLimit.truncated": True,
                "success": bool(info["final_info"]["success"][i]),
                "episode_return": float(self._returns[i]),
                "episode_force_n": float(self._forces_n[i]),
            }
        self._returns[truncated], self._forces_n[truncated] = 0.0, 0.0
        return observation, reward, truncated, infos

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError(
            "set_attr is not supported, because all worlds are one environment; set the attribute of `vec_env.env`"
        )

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError(
            "env_method is not supported, because all worlds are one environment; call the method of `vec_env.env`"
        )

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))
