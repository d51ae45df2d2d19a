"""Whether tools and people come together faster than a blow may be."""

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry.capsules import point_distance
from avrgym.models import robot
from avrgym.models.human import GEOMS
from avrgym.models.scene import CONTROL_STEP_S, TOOL
from avrgym.safety.limits import BODY_REGIONS, REGION_OF_GEOM, blow_speed_m_s
from avrgym.simulation.worlds import Simulation

NEAR_M = 0.10
"""From so near on speeds count: people lean and turn by less while an arm comes to rest and goes back."""

_REGIONS = np.array([REGION_OF_GEOM[geom] for geom in GEOMS])


class Approach:
    """Watches the tools of N worlds, and the regions of people's bodies that they are near.

    A tool is the point at its pad's origin; nothing else of the robot is watched. ``by_person`` and ``together`` (N,)
    say whether a region has come to where the tool is, and whether both have come together, too fast since the control
    step before; ``region`` and ``speed_m_s`` (N,) are the region that did so fastest, by what is allowed, and its
    speed.
    """

    def __init__(self, simulation: Simulation, force_n: FloatArray) -> None:
        """Watch for what would bring regions forces (R,), from where people and tools rest now."""
        self._simulation = simulation
        self.allowed_m_s = blow_speed_m_s(force_n, effective_mass_kg(simulation))
        state = simulation.state()
        self._pad_w, self._segment_w = state.pad_pos_w, state.person_segment_w
        worlds = len(self._pad_w)
        self.by_person: BoolArray = np.zeros(worlds, dtype=bool)
        self.together: BoolArray = self.by_person
        self.region, self.speed_m_s = np.zeros(worlds, dtype=np.intp), np.zeros(worlds)

    def look(self) -> None:
        """See what a control step has brought."""
        state = self._simulation.state()
        pad_w, segment_w = state.pad_pos_w, state.person_segment_w
        now_m = _from_axes_m(pad_w, segment_w)
        gap_m = now_m - state.person_radius_m
        limit_m = CONTROL_STEP_S * self.allowed_m_s[_REGIONS]
        person, both = (
            _closed_m(_from_axes_m(before_w, self._segment_w) - now_m, gap_m) / limit_m
            for before_w in (pad_w, self._pad_w)
        )
        self._pad_w, self._segment_w = pad_w, segment_w
        self.by_person, self.together = np.any(person > 1.0, axis=-1), np.any(both > 1.0, axis=-1)
        share = np.where(self.by_person[:, None], person, both)
        fastest = share.argmax(axis=-1)
        self.region = _REGIONS[fastest]
        self.speed_m_s = share.max(axis=-1) * self.allowed_m_s[self.region]

    def words(self, world: int) -> str:
        """What came together fastest in a world."""
        region = int(self.region[world])
        what = "comes" if self.by_person[world] else "and tool come together"
        allowed = self.allowed_m_s[region]
        return (
            f"{BODY_REGIONS[region].name} {what} at {self.speed_m_s[world]:.2f} m/s, limit {allowed:.2f} m/s"
        )


def effective_mass_kg(simulation: Simulation) -> float:
    """What an arm with its tool brings into a blow: half of all that its joints move, and the whole of the tool.

    ISO/TS 15066:2016, A.3.4.
    """
    model = simulation.model
    first = model.joint(robot.PREFIX + simulation.scene.arm.joints[0])
    moved_kg, tool_kg = (
        float(model.body_subtreemass[int(body)]) for body in (first.bodyid[0], model.body(TOOL).id)
    )
    return 0.5 * (moved_kg - tool_kg) + tool_kg


def _closed_m(closed_m: FloatArray, gap_m: FloatArray) -> FloatArray:
    """By how much gaps (N, G) have closed, of those that will be near if they close once more by as much."""
    return np.where(gap_m - closed_m < NEAR_M, closed_m, 0.0)


def _from_axes_m(point_w: FloatArray, segment_w: FloatArray) -> FloatArray:
    """How far (N, G) points (N, 3) are from the axes (N, G, 2, 3) of capsules."""
    return point_distance(point_w[:, None], segment_w[:, :, 0], segment_w[:, :, 1])
