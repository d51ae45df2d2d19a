"""Policies at work: what each remembers of the present episodes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrgym.policies.trained import Policy, PolicyError

Array = NDArray[np.float64]


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

    def act(self, observations: NDArray[np.floating], generators: Sequence[np.random.Generator]) -> Array:
        """Actions (N, A) float32 in [-1, 1], one control step on; observations (N, O), a generator for each."""
        return self._policy.drawn(self.mean(observations), generators)

    def mean(self, observations: NDArray[np.floating]) -> Array:
        """The means (N, A) that actions are drawn about, one control step on.

        Raises:
            PolicyError: for observations of another shape; nothing is remembered of them.
        """
        if len(observations) != len(self._remembered):
            raise PolicyError(f"{len(observations)} observations for {len(self._remembered)} worlds")
        means, self._remembered = self._policy.step(observations, self._remembered)
        return means
