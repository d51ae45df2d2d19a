"""Policies at work: what each remembers of the present episodes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import moved_to, namespace
from avrgym.policies.trained import Policy, PolicyError


class Actor:
    """A policy in N worlds. A policy without memory is one that remembers nothing.

    Where an episode begins, also by itself after another, ``forget`` must be called for its world.
    """

    def __init__(self, policy: Policy, worlds: int) -> None:
        """Begin an episode in every world."""
        self._policy = policy
        self._remembered = np.zeros((worlds, policy.memory_size))

    def forget(self, worlds: ArrayLike) -> None:
        """Begin new episodes in some worlds: their numbers, or which (N,) of all."""
        self._remembered[np.asarray(worlds)] = 0.0

    def act(self, observations: FloatArray, generators: Sequence[np.random.Generator]) -> FloatArray:
        """Actions (N, A) float32 in [-1, 1], one control step on; observations (N, O), a generator for each."""
        return self._policy.drawn(self.mean(observations), generators)

    def mean(self, observations: FloatArray) -> FloatArray:
        """The means (N, A) that actions are drawn about, one control step on.

        Raises:
            PolicyError: for observations of another shape; nothing is remembered of them.
        """
        if len(observations) != len(self._remembered):
            raise PolicyError(f"{len(observations)} observations for {len(self._remembered)} worlds")
        means, self._remembered = self._policy.step(observations, self._remembered)
        return means


class DeviceActor:
    """A policy without memory at work where an array is, such as a tensor on a GPU, in that array's precision.

    There the order of sums is the library's.
    """

    def __init__(self, policy: Policy, beside: Any) -> None:
        """Bring the policy there."""
        deviation = np.sqrt(policy.observation_variance + policy.observation_epsilon)
        self._mean, self._deviation = moved_to(policy.observation_mean, beside), moved_to(deviation, beside)
        self._clip = policy.observation_clip
        self._weights = [moved_to(weight, beside) for weight in policy.weights]
        self._biases = [moved_to(bias, beside) for bias in policy.biases]

    def mean(self, observations: Any) -> Any:
        """The means (N, A) that actions are drawn about; observations (N, O)."""
        xp = namespace(observations)
        rows = xp.clip((observations - self._mean) / self._deviation, -self._clip, self._clip)
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            rows = xp.tanh(rows @ weight + bias)
        return rows @ self._weights[-1] + self._biases[-1]
