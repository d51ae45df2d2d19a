"""Withdrawal after success: the arm moves its tool a little away from the person and waits.

It begins once the task has succeeded and nothing more has reached the person for ``SETTLED_S``. The tool then leaves as
in a ``Retreat``, but only as far as ``FROM_MOUTH_M`` and ``FROM_PERSON_M``. The arm then holds still until the episode
ends.
"""

from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.safety.retreat import Retreat
from avrgym.simulation.worlds import Simulation

SETTLED_S = 0.5
"""Time without an event, such as a bite or a sip, from success to the beginning of the withdrawal."""
SETTLED_STEPS = round(SETTLED_S / CONTROL_STEP_S)
FROM_MOUTH_M, FROM_PERSON_M = 0.15, 0.06
"""Distances at which the withdrawal ends: from the mouth to the tool, and from the person to tool and hand."""
WITHDRAWAL, WITHDRAWS = "withdrawal", "robot_withdraws"
"""The driver in recorded control steps, and the event at which it begins to drive."""
_CHANGING = ("driving", "_settled_steps", "_moved_steps", "_away")
"""What episodes change, an array (N,) each."""


class Withdrawal:
    """Drives the arms of those of N worlds whose episodes are complete; ``driving`` (N,) marks them."""

    def __init__(self, simulation: Simulation) -> None:
        """Begin with running episodes in all worlds."""
        self._simulation = simulation
        count = simulation.num_worlds
        self._retreats: dict[int, Retreat] = {}
        self._settled_steps, self._moved_steps = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self.driving, self._away = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        self._own: FloatArray | None = None
        """Its actions (N, J) for the coming control step, once they are known."""

    def begin(self, ids: IntArray) -> None:
        """Begin episodes in worlds ``ids`` (n,)."""
        for name in _CHANGING:
            getattr(self, name)[ids] = 0
        self._own = None
        for world in ids.tolist():
            self._retreats.pop(world, None)

    def see(self, success: BoolArray, events: IntArray) -> None:
        """Take what a control step gave in each world, (N,) each."""
        settled = success & (events == 0)
        self._settled_steps = np.where(settled, self._settled_steps + 1, 0)
        self.driving = self.driving | (self._settled_steps >= SETTLED_STEPS)
        self._own = None

    def led(self, asked: FloatArray) -> FloatArray:
        """Actions (N, J) for the next control step: ``asked``, or its own where it drives."""
        if not self.driving.any():
            return asked
        if self._own is None:
            self._own = np.zeros_like(asked)
            for world in np.flatnonzero(self.driving & ~self._away).tolist():
                self._own[world] = self._move(world)
        return np.where(self.driving[:, None], self._own, asked)

    def _move(self, world: int) -> FloatArray | float:
        """The action (J,) of a world's arm; zero when its tool is away."""
        action = self._retreat(world).action()
        if action is None:
            self._away[world] = True
            self._retreats.pop(world)
            return 0.0
        self._moved_steps[world] += 1
        return action

    def _retreat(self, world: int) -> Retreat:
        if world not in self._retreats:
            self._retreats[world] = Retreat(
                self._simulation,
                world,
                clear_m=FROM_MOUTH_M,
                free_m=FROM_PERSON_M,
                steps=int(self._moved_steps[world]),
            )
        return self._retreats[world]

    def saved(self) -> dict[str, Any]:
        """All that changes."""
        return {name: getattr(self, name).copy() for name in _CHANGING}

    def go_on_from(self, saved: dict[str, Any]) -> None:
        """Go on from what ``saved`` gave."""
        self._retreats.clear()
        self._own = None
        for name, array in saved.items():
            setattr(self, name, array.copy())
