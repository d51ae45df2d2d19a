"""A guard between whoever drives robots and their arms: one that presses a person too hard draws back.

A blow is over before anybody can react to its force, and a head that moves presses at once against the whole arm. So
the guard keeps to speeds as well, see ``approach``: an arm draws back from who comes to its tool, and holds still where
it comes too fast itself.
"""

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.models.scene import PHYSICS_STEP_S
from avrgym.safety.approach_speed import Approach
from avrgym.safety.limits import BODY_REGIONS, QUASI_STATIC_LIMIT_N
from avrgym.simulation.worlds import Simulation

GUARD_SHARE = 0.5
"""Above this share of a region's quasi-static limit the arm draws back, and no blow may bring more."""
RELEASE_SHARE = 0.25
"""Below this share on every region it is driven again. So far apart, that it does not chatter."""
WAYPOINT_RAD = 0.01
"""How far some joint moves from one remembered pose of the way to the next."""
WAYPOINTS = 150
ACTS, RESTS = "force_guard_acts", "force_guard_rests"
"""The events of a recording at which a guard begins to act, and an arm is driven again."""


class ForceGuard:
    """Lets the arms of N worlds draw back along the way that they came, where a region of a person bears too much.

    So it does where a region comes to the tool faster than a blow may be; where the tool comes so fast, the arm holds
    still. It sees the forces of each physics step before the next one, and speeds once a control step; all that it
    does it does by actions, so that whoever records actions has its own among them. Where nobody is pressed or comes
    too fast it changes no bit.

    ``given`` (N, A) is what the arms are told now. ``yielding`` (N,) says which draw back, ``holding`` (N,) which hold
    still, and ``interventions`` (N,) is how often they began to do either.
    """

    def __init__(self, simulation: Simulation) -> None:
        """Guard the arms of a simulation that measures forces by region, from where they stand now."""
        self._simulation = simulation
        self._travel_rad = PHYSICS_STEP_S * simulation.scene.arm.speed_limit_rad_s
        self.begin()

    def begin(self) -> None:
        """Guard the episodes that have begun in all worlds."""
        self._approach = Approach(self._simulation, GUARD_SHARE * QUASI_STATIC_LIMIT_N)
        angles = self._simulation.arm_angles_rad()
        worlds = len(angles)
        self.given = np.zeros_like(angles)
        self.yielding, self.holding, self._pressed = (np.zeros(worlds, dtype=bool) for _ in range(3))
        self.interventions = np.zeros(worlds, dtype=np.intp)
        self._asked, self._force_n = self.given, np.zeros((worlds, len(BODY_REGIONS)))
        self._way_rad = np.repeat(angles[:, None], WAYPOINTS, axis=1)
        self._count, self._forgotten = np.ones(worlds, dtype=np.intp), np.zeros(worlds, dtype=np.intp)

    @property
    def acting(self) -> BoolArray:
        """In which worlds (N,) the arms do not what was asked for."""
        return self.yielding | self.holding

    def act(self, asked: FloatArray) -> FloatArray:
        """The actions (N, A) with which a control step begins, in place of those that were asked for."""
        self._approach.look()
        self._asked = asked
        self.given = self._decide()
        return self.given

    def amend(self, asked: FloatArray | None = None) -> BoolArray:
        """In which worlds (N,) ``given`` is another one from the coming physics step on, maybe ``asked`` for."""
        before, self._asked = self.given, self._asked if asked is None else asked
        self.given = self._decide()
        return (self.given != before).any(axis=-1)

    def why(self, world: int) -> str:
        """Why it acts in a world, in words: what is borne most, or what comes too fast."""
        if not self._pressed[world]:
            return self._approach.words(world)
        force_n = self._force_n[world]
        most = int((force_n / QUASI_STATIC_LIMIT_N).argmax())
        region = BODY_REGIONS[most]
        return f"{region.name} {force_n[most]:.1f} N, limit {region.quasi_static_limit_n:g} N"

    def _decide(self) -> FloatArray:
        """What the arms are to do in the coming physics step; called once for each."""
        yielded, acted = self.yielding, self.acting
        self._force_n = self._simulation.region_force_n()
        most = (self._force_n / QUASI_STATIC_LIMIT_N).max(axis=-1)
        self._pressed = (most > GUARD_SHARE) | (self._pressed & (most >= RELEASE_SHARE))
        self.yielding = self._pressed | self._approach.by_person
        self.holding = self._approach.together & ~self.yielding
        self.interventions = self.interventions + ((self.yielding & ~yielded) | (self.acting & ~acted))
        self._remember()
        return np.where(
            self.yielding[:, None], self._retreat(), np.where(self.holding[:, None], 0.0, self._asked)
        )

    def _remember(self) -> None:
        """Note where the arms are that do not draw back, unless they are still where they were noted last."""
        angles = self._simulation.arm_angles_rad()
        rows = np.arange(len(angles))
        latest = self._way_rad[rows, (self._count - 1) % WAYPOINTS]
        moved = ~self.yielding & (np.abs(angles - latest).max(axis=-1) >= WAYPOINT_RAD)
        self._way_rad[rows[moved], self._count[moved] % WAYPOINTS] = angles[moved]
        self._count = self._count + moved
        self._forgotten = np.maximum(self._forgotten, self._count - WAYPOINTS)

    def _retreat(self) -> FloatArray:
        """Actions (N, A) back along the way, as fast as the joints go; a pose that is reached is forgotten."""
        waypoint = self._way_rad[np.arange(len(self._count)), (self._count - 1) % WAYPOINTS]
        steps = (waypoint - self._simulation.arm_targets_rad()) / self._travel_rad
        most = np.abs(steps).max(axis=-1)
        reached = self.yielding & (most <= 1.0) & (self._count - 1 > self._forgotten)
        self._count = self._count - reached
        return steps / np.maximum(most, 1.0)[:, None]
