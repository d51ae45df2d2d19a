"""A guard between whoever drives robots and their arms: one that presses a person too hard draws back."""

import numpy as np
from numpy.typing import NDArray

from avrgym.models.body_regions import BODY_REGIONS, QUASI_STATIC_LIMIT_N
from avrgym.models.scene import PHYSICS_STEP_S
from avrgym.simulation.worlds import Simulation

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

GUARD_SHARE = 0.5
"""Above this share of a region's quasi-static limit the arm draws back."""
RELEASE_SHARE = 0.25
"""Below this share on every region it is driven again. So far apart, that it does not chatter."""
WAYPOINT_RAD = 0.01
"""How far some joint moves from one remembered pose of the way to the next."""
WAYPOINTS = 150
ACTS, RESTS = "force_guard_acts", "force_guard_rests"
"""The events of a recording at which an arm begins to draw back, and is driven again."""


class ForceGuard:
    """Lets the arms of N worlds draw back along the way that they came, where a region of a person bears too much.

    It sees the forces of each physics step before the next one, and does all that it does by actions, so that whoever
    records actions has its own among them. Where nobody is pressed it changes no bit.

    ``given`` (N, A) is what the arms are told now. ``yielding`` (N,) says which draw back; ``region`` and ``force_n``
    (N,) are what was borne most, by its limit, when they began to, and ``interventions`` (N,) is how often they did.
    """

    def __init__(self, simulation: Simulation) -> None:
        """Guard the arms of a simulation that measures forces by region, from where they stand now."""
        self._simulation = simulation
        self._travel_rad = PHYSICS_STEP_S * simulation.scene.arm.speed_limit_rad_s
        self.begin()

    def begin(self) -> None:
        """Guard the episodes that have begun in all worlds."""
        angles = self._simulation.arm_angles_rad()
        worlds = len(angles)
        self.given = np.zeros_like(angles)
        self.yielding = np.zeros(worlds, dtype=bool)
        self.region, self.interventions = (np.zeros(worlds, dtype=np.intp) for _ in range(2))
        self.force_n = np.zeros(worlds)
        self._asked = self.given
        self._way_rad = np.repeat(angles[:, None], WAYPOINTS, axis=1)
        self._count, self._forgotten = np.ones(worlds, dtype=np.intp), np.zeros(worlds, dtype=np.intp)

    def act(self, asked: Array) -> Array:
        """The actions (N, A) with which a control step begins, in place of those that were asked for."""
        self._asked = asked
        self.given = self._decide()
        return self.given

    def amend(self, asked: Array | None = None) -> Bools:
        """In which worlds (N,) ``given`` is another one from the coming physics step on, maybe ``asked`` for."""
        before, self._asked = self.given, self._asked if asked is None else asked
        self.given = self._decide()
        return (self.given != before).any(axis=-1)

    def borne(self, world: int) -> str:
        """What was borne most in a world when its arm began to draw back, in words."""
        region = BODY_REGIONS[int(self.region[world])]
        return f"{region.name} {self.force_n[world]:.1f} N, limit {region.quasi_static_limit_n:g} N"

    def _decide(self) -> Array:
        """What the arms are to do in the coming physics step; called once for each."""
        force_n = self._simulation.region_force_n()
        share = force_n / QUASI_STATIC_LIMIT_N
        most = share.max(axis=-1)
        begins = ~self.yielding & (most > GUARD_SHARE)
        region = share.argmax(axis=-1)
        self.region = np.where(begins, region, self.region)
        self.force_n = np.where(
            begins, np.take_along_axis(force_n, region[:, None], axis=-1)[:, 0], self.force_n
        )
        self.interventions = self.interventions + begins
        self.yielding = begins | (self.yielding & (most >= RELEASE_SHARE))
        self._remember()
        return np.where(self.yielding[:, None], self._retreat(), self._asked)

    def _remember(self) -> None:
        """Note where the arms are that do not draw back, unless they are still where they were noted last."""
        angles = self._simulation.arm_angles_rad()
        rows = np.arange(len(angles))
        latest = self._way_rad[rows, (self._count - 1) % WAYPOINTS]
        moved = ~self.yielding & (np.abs(angles - latest).max(axis=-1) >= WAYPOINT_RAD)
        self._way_rad[rows[moved], self._count[moved] % WAYPOINTS] = angles[moved]
        self._count = self._count + moved
        self._forgotten = np.maximum(self._forgotten, self._count - WAYPOINTS)

    def _retreat(self) -> Array:
        """Actions (N, A) back along the way, as fast as the joints go; a pose that is reached is forgotten."""
        waypoint = self._way_rad[np.arange(len(self._count)), (self._count - 1) % WAYPOINTS]
        steps = (waypoint - self._simulation.arm_targets_rad()) / self._travel_rad
        most = np.abs(steps).max(axis=-1)
        reached = self.yielding & (most <= 1.0) & (self._count - 1 > self._forgotten)
        self._count = self._count - reached
        return steps / np.maximum(most, 1.0)[:, None]
