"""A controller that lets the arm be where it is."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.tasks.registry import sizes


class HoldStill:
    """Asks for no movement, of however many joints the robot has."""

    def reset(self, seed: int, environment: str) -> None:
        """Begin an episode of an environment; nothing here is left to chance."""
        _, self._joints = sizes(environment)

    def act(self, observation: FloatArray) -> FloatArray:
        """Zeros (A,)."""
        return np.zeros(self._joints)
