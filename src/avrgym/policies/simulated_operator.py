"""A simulated operator: delays the intended commands and adds noise, like a person who teleoperates the robot.

The delay is a visual reaction time of about 0.2 s (Woods et al., Front. Hum. Neurosci. 9:131, 2015). The noise grows
with the commanded speed (Harris and Wolpert, Nature 394, 1998), see ``people.motor_model``.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.people.motor_model import SPEED_NOISE_FRACTION

COMMAND_DELAY_S = 0.2
TOUCH_DELAY_S = 0.1
"""Delay of reactions to a force that the operator feels (Pruszynski and Scott, Exp. Brain Res. 218, 2012)."""
NOISE_TIME_CONSTANT_S = 0.3
"""Time constant of the noise, which is a first-order autoregressive process."""


class SimulatedOperator:
    """Delays the commands of N worlds, and adds noise."""

    def __init__(self, generators: Sequence[np.random.Generator], command_size: int, control_hz: int) -> None:
        """Start an episode in each world, with the world's random generator."""
        self._generators = generators
        zero: FloatArray = np.zeros((len(generators), command_size))
        self._control_hz = control_hz
        length = round(COMMAND_DELAY_S * control_hz) + 1
        self._intended: deque[FloatArray] = deque([zero] * length, length)
        self._noise = zero
        self._memory = float(np.exp(-1.0 / (NOISE_TIME_CONSTANT_S * control_hz)))

    def compute_commands(self, intended: FloatArray, delay_s: float = COMMAND_DELAY_S) -> FloatArray:
        """Returns the delayed and noisy commands (N, D) of a control step, given the intended commands (N, D).

        Commands are speeds of the joints, or of the robot's hand, in the unit of ``intended``. ``delay_s``: delay of
        this command, at most ``COMMAND_DELAY_S``.
        """
        self._intended.append(intended)
        fresh = np.array([each.standard_normal(intended.shape[1]) for each in self._generators], float)
        self._noise = self._memory * self._noise + np.sqrt(1.0 - self._memory**2) * fresh
        return self._intended[-1 - round(delay_s * self._control_hz)] * (
            1.0 + SPEED_NOISE_FRACTION * self._noise
        )
