"""Withdrawal after success: the arm moves its tool a little away from the person and waits.

The withdrawal begins when the task has succeeded and there is no event for ``SETTLING_TIME_S``. ``Retreat`` moves the
tool up to ``FINAL_MOUTH_DISTANCE_M`` and ``FINAL_PERSON_DISTANCE_M``. The arm then does not move until the episode
ends.
"""

from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.safety.per_world_state import PerWorldState
from avrgym.safety.retreat import Retreat
from avrgym.simulation.worlds import Simulation

SETTLING_TIME_S = 0.5
"""Time without an event (such as a bite or a sip) between the success and the withdrawal."""
FINAL_MOUTH_DISTANCE_M, FINAL_PERSON_DISTANCE_M = 0.15, 0.06
"""Distances at which the withdrawal ends, in metres: from the mouth to the tool, and from the person to tool and hand.
"""
WITHDRAWAL_DRIVER, WITHDRAWAL_EVENT = "withdrawal", "robot_withdraws"
"""In a recording: the name of the driver in the withdrawal's control steps, and of the event at its beginning."""


class Withdrawal(PerWorldState):
    """Moves the tools away after success. ``active_mask``: boolean mask (N,) of the worlds in which it controls the
    arm.
    """

    STATE_FIELDS = ("active_mask", "_settled_steps", "_moved_steps", "_away", "_awaits_event")

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._settling_steps = round(SETTLING_TIME_S / simulation.scene.control_step_s)
        count = simulation.num_worlds
        self._retreats: dict[int, Retreat] = {}
        self._settled_steps, self._moved_steps = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self.active_mask: BoolArray = np.zeros(count, dtype=bool)
        self._away: BoolArray = np.zeros(count, dtype=bool)
        self._awaits_event: BoolArray = np.zeros(count, dtype=bool)
        self._actions: FloatArray | None = None
        """The withdrawal's actions (N, A) for the coming control step; ``None`` until they are computed."""

    def reset(self, ids: IntArray) -> None:
        """Start episodes in worlds ``ids`` (n,): no withdrawal is active there."""
        self._clear(ids)
        self._actions = None
        for world in ids.tolist():
            self._retreats.pop(world, None)

    def update(self, success: BoolArray, events: IntArray) -> None:
        """Process the results of a control step: the success (N,) and the number of events (N,)."""
        self._awaits_event = self._awaits_event & (events == 0)
        settled = success & (events == 0) & ~self._awaits_event
        self._settled_steps = np.where(settled, self._settled_steps + 1, 0)
        self.active_mask = self.active_mask | (self._settled_steps >= self._settling_steps)
        self._actions = None

    def interrupt(self, worlds: BoolArray) -> None:
        """End the withdrawal in the worlds of a mask (N,). Another withdrawal can start after the next event, such as a
        bite."""
        ended = worlds & self.active_mask
        self.active_mask, self._away = self.active_mask & ~ended, self._away & ~ended
        self._awaits_event = self._awaits_event | ended
        self._settled_steps, self._moved_steps = (
            np.where(ended, 0, steps) for steps in (self._settled_steps, self._moved_steps)
        )
        self._actions = None
        for world in np.flatnonzero(ended).tolist():
            self._retreats.pop(world, None)

    def override(self, commanded: FloatArray) -> FloatArray:
        """Returns the actions (N, A) to execute: the withdrawal's actions where ``active_mask``, otherwise the
        commands.
        """
        if not self.active_mask.any():
            return commanded
        if self._actions is None:
            self._actions = np.zeros_like(commanded)
            for world in np.flatnonzero(self.active_mask & ~self._away).tolist():
                self._actions[world] = self._action(world)
        return np.where(self.active_mask[:, None], self._actions, commanded)

    def _action(self, world: int) -> FloatArray | float:
        """Returns the action (A,) of a world's robot; zero if its tool is far enough away."""
        action = self._retreat(world).compute_next_action()
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
                mouth_distance_m=FINAL_MOUTH_DISTANCE_M,
                person_distance_m=FINAL_PERSON_DISTANCE_M,
                steps=int(self._moved_steps[world]),
                step_s=self._simulation.scene.control_step_s,
            )
        return self._retreats[world]

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restores the state of the withdrawal from the result of ``snapshot``."""
        super().restore(snapshot)
        self._retreats.clear()
        self._actions = None
