"""A controller that does not move the arm."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.tasks.registry import get_observation_and_action_size


class HoldStill:
    """Returns zero actions for a robot with any number of joints."""

    def reset(self, seed: int, environment: str) -> None:
        """Reset for an environment. The controller is deterministic."""
        _, self._joints = get_observation_and_action_size(environment)

    def act(self, observation: FloatArray) -> FloatArray:
        """Zeros (A,)."""
        return np.zeros(self._joints)
