"""The controller WaveArm: turns the first joint to and fro, independent of the observation."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.tasks.registry import get_observation_and_action_size

PHASE_STEP_RAD = 0.2
"""Phase increase of the sine wave in one control step, in radians."""
NOISE_STD = 0.05
"""Standard deviation of the noise that is added to actions."""


class WaveArm:
    """Controls one robot at 10 Hz. Each world has its own instance."""

    def reset(self, seed: int, environment: str) -> None:
        """Reset for an environment such as "avrgym/FeedingJaco-v1". The seed determines all random numbers."""
        _, self._joints = get_observation_and_action_size(environment)
        self._random = np.random.default_rng(seed)
        self._steps = 0

    def act(self, observation: FloatArray) -> FloatArray:
        """Action (A,) for an observation (O,): joint speeds relative to their limits, −1 to 1."""
        self._steps += 1
        action = self._random.normal(0.0, NOISE_STD, self._joints)
        action[0] += np.sin(PHASE_STEP_RAD * self._steps)
        return np.clip(action, -1.0, 1.0)
