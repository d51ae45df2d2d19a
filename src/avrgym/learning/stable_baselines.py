"""The native vector environment for Stable-Baselines3."""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv

from avrgym.array_types import FloatArray, NumpyArray
from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.envs.vector_conventions import NO_END


class Normaliser(Protocol):
    """What scales observations and rewards: ``VecNormalize``, or what stands in its place where worlds are shared.

    ``obs_rms`` and ``ret_rms`` are running moments of observations and of discounted returns.
    """

    obs_rms: Any
    ret_rms: Any
    clip_obs: float
    epsilon: float

    def normalize_obs(self, obs: Any) -> Any:
        """Observations in standard deviations from the mean, single precision."""
        ...


N_co = TypeVar("N_co", bound=Normaliser, covariant=True)


class Trainee(NamedTuple, Generic[N_co]):
    """What learns: a model, and the normaliser of its observations and rewards."""

    model: PPO
    normaliser: N_co


class SB3VectorEnv(VecEnv):
    """The native vector environment as Stable-Baselines3 wants it.

    The infos of a finished episode contain ``success``, ``episode_return``, the sum of its rewards, and
    ``episode_force_n``, the mean force on the person in newtons.
    """

    def __init__(self, env: AssistiveVectorEnv) -> None:
        """Raise ``ValueError`` for episodes that begin in another step than the last one's end, or never end."""
        if env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"Stable-Baselines3 would learn from jumps in autoreset mode {env.autoreset_mode.name}; allowed: "
                "gym.make_vec(..., autoreset_mode=AutoresetMode.SAME_STEP)"
            )
        if env.max_episode_steps == NO_END:
            raise ValueError(
                "Stable-Baselines3 needs episodes that end; allowed: max_episode_steps of 1 or more"
            )
        self.env = env  # the base class asks it for its render mode
        self._returns: NumpyArray = np.zeros(env.num_envs)
        self._forces_n: NumpyArray = np.zeros(env.num_envs)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: NumpyArray = np.zeros((env.num_envs, env.episodes.action_size))
        self._seed: int | None = None

    def seed(self, seed: int | None = None) -> list[int | None]:
        self._seed = seed
        return [None if seed is None else seed + i for i in range(self.num_envs)]

    def reset(self) -> NumpyArray:
        observation, _ = self.env.reset(seed=self._seed)
        self._seed = None
        self._returns[:], self._forces_n[:] = 0.0, 0.0
        return observation

    def step_async(self, actions: NumpyArray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[NumpyArray, NumpyArray, NumpyArray, list[dict[str, Any]]]:
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
        raise NotImplementedError("the worlds share their attributes")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError("the worlds share their methods")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))


class Scaled(Protocol):
    """An observation: how many numbers it has, and their fixed scales, not a number where there is none."""

    @property
    def size(self) -> int:
        """How many numbers it has, O."""
        ...

    @property
    def scale(self) -> FloatArray:
        """The fixed scales, (O,)."""
        ...


class ObservationScale(RunningMeanStd):
    """Mean and variance of observations as they come, but mean 0 and the scale of those that have a fixed one."""

    def __init__(self, observation: Scaled) -> None:
        """Begin without having seen any observations."""
        super().__init__(shape=(observation.size,))
        self._fixed = np.isfinite(observation.scale)
        self._variance = observation.scale[self._fixed] ** 2
        self._fix()

    def update_from_moments(self, batch_mean: np.ndarray, batch_var: np.ndarray, batch_count: float) -> None:
        """Take in what a batch of observations was like."""
        super().update_from_moments(batch_mean, batch_var, batch_count)
        self._fix()

    def _fix(self) -> None:
        self.mean[self._fixed], self.var[self._fixed] = 0.0, self._variance
