"""The controller WaveArm: it turns the first joint to and fro, whatever it sees."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.tasks.registry import sizes

TURN_RAD = 0.2
"""How much farther a step is in the swing than the one before."""
TREMBLING = 0.05
"""The standard deviation of what chance adds to each joint's share of its speed."""


class WaveArm:
    """Drives one robot, ten times a second; every world has one of its own."""

    def reset(self, seed: int, environment: str) -> None:
        """Begin an episode of an environment such as "avrgym/FeedingJaco-v1"; all chance is drawn from the seed."""
        _, self._joints = sizes(environment)
        self._random = np.random.default_rng(seed)
        self._steps = 0

    def act(self, observation: FloatArray) -> FloatArray:
        """From an observation (O,) to an action (A,): each joint's speed as a share, -1 to 1, of its limit."""
        self._steps += 1
        action = self._random.normal(0.0, TREMBLING, self._joints)
        action[0] += np.sin(TURN_RAD * self._steps)
        return np.clip(action, -1.0, 1.0)
