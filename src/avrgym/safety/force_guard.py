"""The force guard overrides actions if contact forces are too high, or the robot moves too fast near a person.

If a force is too high, the arm retracts. An impact ends before a controller can react to the measured force. The guard
therefore also limits the approach speed, see ``approach_speed``: If a person approaches the tool too fast, the arm
retracts. If the tool itself is too fast, the arm stops. ``tasks.control_loop`` applies the guard in each control step.
"""

from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.commands.preferences import DEFAULT_FORCE_LIMIT_FRACTION
from avrgym.models.scene import PHYSICS_STEP_S
from avrgym.safety.approach_speed import ApproachSpeedMonitor
from avrgym.safety.limits import BODY_REGIONS, QUASI_STATIC_LIMIT_N
from avrgym.safety.per_world_state import PerWorldState
from avrgym.simulation.worlds import Simulation

INTERVENTION_FORCE_LIMIT_FRACTION = DEFAULT_FORCE_LIMIT_FRACTION
"""The arm retracts if a force exceeds this share of a region's quasi-static limit. The speed limits allow impact forces
up to the same share.
"""
RELEASE_FORCE_LIMIT_FRACTION = 0.25
"""The arm stops retracting when forces on all regions are below this share. The hysteresis prevents chattering."""
WAYPOINT_SPACING_RAD = 0.01
"""Joint motion since the latest waypoint after which a new waypoint of the retraction path is stored."""
MAX_WAYPOINTS = 150
"""Maximum number of stored waypoints of the retraction path."""
INTERVENTION_EVENT, RELEASE_EVENT = "force_guard_acts", "force_guard_rests"
"""Names of recorded events: the guard starts to override commands, and it stops overriding them."""


class ForceGuard(PerWorldState):
    """Overrides the actions in worlds in which a contact force or an approach speed exceeds its limit.

    The guard reads the contact forces before each physics step, and the approach speeds before each control step.

    Attributes:
        executed_action: the actions (N, A) that the arms execute.
        retracting_mask: boolean mask (N,): arms that move back along their path.
        stopped_mask: boolean mask (N,): arms that the guard stops.
        num_interventions: number (N,) of interventions of both kinds in the episode.
    """

    STATE_FIELDS = (
        "executed_action", "retracting_mask", "stopped_mask", "num_interventions", "_pressed", "_commanded", "_force_n",
        "_path", "_path_end", "_path_start",
    )  # fmt: skip

    def __init__(self, simulation: Simulation, share: float = INTERVENTION_FORCE_LIMIT_FRACTION) -> None:
        """Guard the arms of a simulation that measures forces by region (``by_region``).

        The arm retracts if a force exceeds ``share`` times the quasi-static limit. The maximum of ``share`` is
        ``INTERVENTION_FORCE_LIMIT_FRACTION``.
        """
        self._simulation, self._share = simulation, min(share, INTERVENTION_FORCE_LIMIT_FRACTION)
        self._approach = ApproachSpeedMonitor(simulation, self._share * QUASI_STATIC_LIMIT_N)
        configuration = simulation.get_configuration()
        worlds = len(configuration)
        self.executed_action = np.zeros((worlds, len(simulation.scene.action_names)))
        self.retracting_mask, self.stopped_mask, self._pressed = (
            np.zeros(worlds, dtype=bool) for _ in range(3)
        )
        self.num_interventions = np.zeros(worlds, dtype=np.intp)
        self._commanded, self._force_n = self.executed_action, np.zeros((worlds, len(BODY_REGIONS)))
        self._path = np.repeat(configuration[:, None], MAX_WAYPOINTS, axis=1)
        self._path_end, self._path_start = np.ones(worlds, dtype=np.intp), np.zeros(worlds, dtype=np.intp)

    def reset(self, ids: IntArray) -> None:
        """Start episodes in worlds ``ids`` (n,) from their current physical state."""
        self._approach.reset(ids)
        self._clear(ids)
        self._path[ids] = self._simulation.get_configuration()[ids, None]
        self._path_end[ids] = 1

    @property
    def override_mask(self) -> BoolArray:
        """Boolean mask (N,): worlds in which the guard overrides the command."""
        return self.retracting_mask | self.stopped_mask

    def begin_step(self, commanded: FloatArray) -> FloatArray:
        """Returns the actions (N, A) to execute at the start of a control step, given the commanded actions (N, A)."""
        self._approach.update()
        self._commanded = commanded
        self.executed_action = self._decide()
        return self.executed_action

    def update(self, commanded: FloatArray | None = None) -> BoolArray:
        """Updates ``executed_action`` before each physics step after the first of a control step.

        Args:
            commanded: new commanded actions (N, A), if they change within the control step.

        Returns:
            Boolean mask (N,): worlds in which ``executed_action`` has changed.
        """
        before = self.executed_action
        if commanded is not None:
            self._commanded = commanded
        self.executed_action = self._decide()
        return (self.executed_action != before).any(axis=-1)

    def describe_override(self, world: int) -> str:
        """Returns the reason why the guard overrides the command in a world, with the measured value and its limit."""
        if not self._pressed[world]:
            return self._approach.describe_fastest_approach(world)
        force_n = self._force_n[world]
        most = int((force_n / QUASI_STATIC_LIMIT_N).argmax())
        region = BODY_REGIONS[most]
        return f"{region.name} {force_n[most]:.1f} N, limit {region.quasi_static_limit_n:g} N"

    def snapshot(self) -> dict[str, Any]:
        """Returns the state of the guard: all data on which its next actions depend."""
        return super().snapshot() | {"approach": self._approach.snapshot()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restores the state of the guard from the result of ``snapshot``."""
        super().restore(snapshot)
        self._approach.restore(snapshot["approach"])

    def _decide(self) -> FloatArray:
        """Returns the actions (N, A) for the next physics step. Called once per step."""
        was_retracting, was_overriding = self.retracting_mask, self.override_mask
        self._force_n = self._simulation.compute_region_force_n()
        most = (self._force_n / QUASI_STATIC_LIMIT_N).max(axis=-1)
        released = RELEASE_FORCE_LIMIT_FRACTION * self._share / INTERVENTION_FORCE_LIMIT_FRACTION
        self._pressed = (most > self._share) | (self._pressed & (most >= released))
        self.retracting_mask = self._pressed | self._approach.person_too_fast_mask
        self.stopped_mask = self._approach.closing_too_fast_mask & ~self.retracting_mask
        begins = (self.retracting_mask & ~was_retracting) | (self.override_mask & ~was_overriding)
        self.num_interventions = self.num_interventions + begins
        self._store_waypoints()
        if not self.override_mask.any():
            return self._commanded.copy()
        return np.where(
            self.retracting_mask[:, None],
            self._retract(),
            np.where(self.stopped_mask[:, None], 0.0, self._commanded),
        )

    def _store_waypoints(self) -> None:
        """Stores a waypoint for each robot that does not retract and is not near its latest waypoint."""
        now = self._simulation.get_configuration()
        rows = np.arange(len(now))
        latest = self._path[rows, (self._path_end - 1) % MAX_WAYPOINTS]
        distance = np.abs((now - latest) / self._simulation.configuration_scales).max(axis=-1)
        moved = ~self.retracting_mask & (distance >= WAYPOINT_SPACING_RAD)
        self._path[rows[moved], self._path_end[moved] % MAX_WAYPOINTS] = now[moved]
        self._path_end = self._path_end + moved
        self._path_start = np.maximum(self._path_start, self._path_end - MAX_WAYPOINTS)

    def _retract(self) -> FloatArray:
        """Returns actions (N, A) to the latest waypoint, at the joints' speed limits. Deletes reached waypoints."""
        waypoint = self._path[np.arange(len(self._path_end)), (self._path_end - 1) % MAX_WAYPOINTS]
        steps = self._simulation.compute_action_to_configuration(waypoint, PHYSICS_STEP_S)
        most = np.abs(steps).max(axis=-1)
        reached = self.retracting_mask & (most <= 1.0) & (self._path_end - 1 > self._path_start)
        self._path_end = self._path_end - reached
        return steps / np.maximum(most, 1.0)[:, None]
