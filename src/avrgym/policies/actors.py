"""Actors compute the actions of one policy in N worlds. An actor stores the memory state of a recurrent policy for each
world.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import get_namespace, to_device_of
from avrgym.policies.trained_policies import Policy, PolicyError


class Actor:
    """A feed-forward or recurrent policy in N worlds. Call ``reset`` for a world when its episode starts."""

    def __init__(self, policy: Policy, worlds: int) -> None:
        """Create an actor for the number of ``worlds``, each at the start of an episode."""
        self._policy = policy
        self._memory = np.zeros((worlds, policy.memory_size))

    def reset(self, worlds: ArrayLike) -> None:
        """Clear the memory of some worlds, given by their indices or a mask (N,)."""
        self._memory[np.asarray(worlds)] = 0.0

    def act(
        self,
        observations: FloatArray,
        generators: Sequence[np.random.Generator],
        image: FloatArray | None = None,
    ) -> FloatArray:
        """Returns actions (N, A) for observations (N, O), with noise from a generator per world: float32 in [-1, 1].

        ``image`` (N, H, W, C) is the additional input of a policy with vision.
        """
        return self._policy.add_noise(self.compute_mean_actions(observations, image), generators)

    def compute_mean_actions(self, observations: FloatArray, image: FloatArray | None = None) -> FloatArray:
        """Returns mean actions (N, A) for observations (N, O), and updates the memory. Call it once per control step.

        A policy with vision also needs the ``image`` (N, H, W, C), from ``networks.vision.make_vision_input``.

        Raises:
            PolicyError: for observations of a wrong shape. The memory is then unchanged.
        """
        if len(observations) != len(self._memory):
            raise PolicyError(
                f"there are {len(observations)} observations for {len(self._memory)} worlds; allowed: one observation "
                "for each world"
            )
        means, self._memory = self._policy.forward(observations, self._memory, image)
        return means


class DeviceActor:
    """A feed-forward policy that computes on a device, such as a GPU.

    The array library determines the order of sums. Results can therefore differ from those of ``Actor`` by rounding.
    """

    def __init__(self, policy: Policy, example_array: Any) -> None:
        """Convert the parameters of the policy to the library, device and precision of ``example_array``."""
        self._mean = to_device_of(policy.observation_mean, example_array)
        self._deviation = to_device_of(policy.observation_std, example_array)
        self._clip = policy.observation_clip
        self._weights = [to_device_of(weight, example_array) for weight in policy.weights]
        self._biases = [to_device_of(bias, example_array) for bias in policy.biases]

    def compute_mean_actions(self, observations: Any) -> Any:
        """Returns mean actions (N, A) before noise and clipping for observations (N, O), as arrays on the device."""
        xp = get_namespace(observations)
        rows = xp.clip((observations - self._mean) / self._deviation, -self._clip, self._clip)
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            rows = xp.tanh(rows @ weight + bias)
        return rows @ self._weights[-1] + self._biases[-1]
