"""Normalisation of observations and rewards by running mean and variance. Each training update changes them once."""

# Stable-Baselines3's attributes and PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from typing import Any, Protocol

import numpy as np
import torch
from stable_baselines3.common.running_mean_std import RunningMeanStd

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import get_namespace, to_device_of, to_numpy
from avrgym.learning.rollouts import Rollout
from avrgym.tasks.observation import ObservationSpec
from avrgym.tasks.registry import find_task_and_scene

OBSERVATION_CLIP, REWARD_CLIP = 5.0, 10.0


class ObservationScales(Protocol):
    """Interface of an observation's size O and its fixed scales (O,). The scale is NaN for values without a fixed
    scale.
    """

    @property
    def size(self) -> int: ...

    @property
    def scale(self) -> FloatArray: ...


def make_observation_description(environment: str) -> ObservationSpec:
    """Returns the size and the fixed scales of the observation in an environment."""
    task, scene = find_task_and_scene(environment)
    return task.make_observation_spec(scene)


class ObservationMoments(RunningMeanStd):
    """Running mean and variance of observations. For values with a fixed scale, the mean is 0 and the standard
    deviation is this scale."""

    def __init__(self, observation: ObservationScales) -> None:
        super().__init__(shape=(observation.size,))
        self._fixed = np.isfinite(observation.scale)
        self._variance = observation.scale[self._fixed] ** 2
        self._fix()

    def update_from_moments(self, batch_mean: np.ndarray, batch_var: np.ndarray, batch_count: float) -> None:
        super().update_from_moments(batch_mean, batch_var, batch_count)
        self._fix()

    def _fix(self) -> None:
        self.mean[self._fixed], self.var[self._fixed] = 0.0, self._variance


class Normaliser:
    """Normalises observations and rewards. Attributes have the names of Stable-Baselines3's ``VecNormalize``."""

    def __init__(self, observation: ObservationScales, gamma: float) -> None:
        self.obs_rms = ObservationMoments(observation)
        self.ret_rms = RunningMeanStd()
        self.clip_obs, self.epsilon = OBSERVATION_CLIP, 1e-8
        self._gamma = gamma

    def normalize_obs(self, obs: Any) -> Any:
        """Returns normalised observations (…, O): mean 0, standard deviation 1, clipped, single precision."""
        xp = get_namespace(obs)
        deviation = np.sqrt(self.obs_rms.var + self.epsilon)
        scaled = (obs - to_device_of(self.obs_rms.mean, obs)) / to_device_of(deviation, obs)
        return xp.astype(xp.clip(scaled, -self.clip_obs, self.clip_obs), xp.float32)

    def update_observations(self, rollout: Rollout) -> None:
        """Update mean and variance of observations with the observations of a rollout."""
        observations, xp = rollout.observations, get_namespace(rollout.observations)
        _update(self.obs_rms, xp.astype(observations.reshape(-1, observations.shape[-1]), xp.float64))

    def normalize_rewards(self, rollout: Rollout) -> Any:
        """Update mean and variance of the discounted returns. Returns the rewards (T, n), divided by the standard
        deviation of the returns, and clipped."""
        rewards, xp = rollout.rewards, get_namespace(rollout.rewards)
        discounted = xp.zeros(rewards.shape[1], dtype=xp.float64, device=rewards.device)
        returns: list[Any] = []
        for reward in rewards:
            discounted = discounted * self._gamma + reward
            returns.append(discounted)
        _update(self.ret_rms, xp.stack(returns).reshape(-1))
        scaled = rewards / to_device_of(np.sqrt(self.ret_rms.var + self.epsilon), rewards)
        return xp.astype(xp.clip(scaled, -REWARD_CLIP, REWARD_CLIP), xp.float32)

    def checkpoint_state(self) -> dict[str, Any]:
        """Returns the running means and variances of observations and returns, for a checkpoint."""
        return {"observations": _moments(self.obs_rms), "returns": _moments(self.ret_rms)}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the running means and variances from ``state``, the state in a checkpoint."""
        for moments, name in ((self.obs_rms, "observations"), (self.ret_rms, "returns")):
            stored = state[name]
            moments.mean, moments.var = stored["mean"].numpy(), stored["variance"].numpy()
            moments.count = stored["count"]


def _update(moments: RunningMeanStd, samples: Any) -> None:
    """Update mean and variance with samples (S, …). From a device, only mean and variance are copied to the host."""
    xp = get_namespace(samples)
    mean, variance = (to_numpy(moment(samples, axis=0)) for moment in (xp.mean, xp.var))
    moments.update_from_moments(mean, variance, len(samples))


def _moments(moments: RunningMeanStd) -> dict[str, Any]:
    return {
        "mean": torch.as_tensor(np.asarray(moments.mean)),
        "variance": torch.as_tensor(np.asarray(moments.var)),
        "count": float(moments.count),
    }
