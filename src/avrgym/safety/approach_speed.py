"""Monitors the approach speed between a robot's tool and a person. A limit of this speed also limits impact forces."""

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry.capsules import point_segment_distance
from avrgym.models import robot
from avrgym.models.human import GEOMS
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.safety.limits import BODY_REGIONS, REGION_INDEX_OF_GEOM, compute_max_impact_speed_m_s
from avrgym.safety.per_world_state import PerWorldState
from avrgym.simulation.worlds import Simulation

MONITORED_DISTANCE_M = 0.10
"""Maximum distance between tool and person at which speeds are checked. While an arm retracts, people move less than
this distance.
"""
_REGIONS = np.array([REGION_INDEX_OF_GEOM[geom] for geom in GEOMS])


class ApproachSpeedMonitor(PerWorldState):
    """Compares approach speeds in N worlds with the allowed contact speeds of the body regions.

    The speed of a tool is that of its pad's origin. The pad is the part that touches people. All arrays (N,) describe
    the latest control step.

    Attributes:
        person_too_fast_mask: whether a body region approaches the tool too fast by its own motion.
        closing_too_fast_mask: whether a gap closes too fast by the motion of person and tool together.
        fastest_region: index in ``BODY_REGIONS`` of the region with the highest approach speed, relative to its limit.
        approach_speed_m_s: the approach speed of this region.
        allowed_speed_m_s: the speed limit (R,) of each region.
    """

    STATE_FIELDS = (
        "person_too_fast_mask",
        "closing_too_fast_mask",
        "fastest_region",
        "approach_speed_m_s",
        "_pad_w",
        "_segment_w",
    )

    def __init__(self, simulation: Simulation, force_n: FloatArray) -> None:
        """Compute the speed limit of each body region.

        An impact at this speed causes the force ``force_n`` (R,), in newtons.
        """
        self._simulation = simulation
        self.allowed_speed_m_s = compute_max_impact_speed_m_s(force_n, compute_effective_mass_kg(simulation))
        state = simulation.get_state()
        self._pad_w, self._segment_w = state.tool_pad_pos_w, state.person_capsule_ends_w
        worlds = len(self._pad_w)
        self.person_too_fast_mask: BoolArray = np.zeros(worlds, dtype=bool)
        self.closing_too_fast_mask: BoolArray = np.zeros(worlds, dtype=bool)
        self.fastest_region, self.approach_speed_m_s = np.zeros(worlds, dtype=np.intp), np.zeros(worlds)

    def reset(self, ids: IntArray) -> None:
        """Start episodes in worlds ``ids`` (n,) from their current physical state."""
        state = self._simulation.get_state()
        self._clear(ids)
        self._pad_w[ids], self._segment_w[ids] = state.tool_pad_pos_w[ids], state.person_capsule_ends_w[ids]

    def update(self) -> None:
        """Compute the approach speeds from the current positions and the positions at the previous call."""
        state = self._simulation.get_state()
        pad_w, segment_w = state.tool_pad_pos_w, state.person_capsule_ends_w
        now_m = _axis_distance_m(pad_w, segment_w)
        gap_m = now_m - state.person_radius_m
        limit_m = self._simulation.scene.control_step_s * self.allowed_speed_m_s[_REGIONS]
        person, both = (
            _near_closing_m(_axis_distance_m(before_w, self._segment_w) - now_m, gap_m) / limit_m
            for before_w in (pad_w, self._pad_w)
        )
        self._pad_w, self._segment_w = pad_w, segment_w
        self.person_too_fast_mask, self.closing_too_fast_mask = (
            np.any(person > 1.0, axis=-1),
            np.any(both > 1.0, axis=-1),
        )
        share = np.where(self.person_too_fast_mask[:, None], person, both)
        fastest = share.argmax(axis=-1)
        self.fastest_region = _REGIONS[fastest]
        self.approach_speed_m_s = share.max(axis=-1) * self.allowed_speed_m_s[self.fastest_region]

    def describe_fastest_approach(self, world: int) -> str:
        """Returns a description of the fastest approach in a world: region, speed and limit."""
        region = int(self.fastest_region[world])
        verb = "approaches" if self.person_too_fast_mask[world] else "and tool approach"
        allowed = self.allowed_speed_m_s[region]
        return (
            f"{BODY_REGIONS[region].name} {verb} at {self.approach_speed_m_s[world]:.2f} m/s, limit "
            f"{allowed:.2f} m/s"
        )


def compute_effective_mass_kg(simulation: Simulation) -> float:
    """Returns a robot's effective mass in an impact, after ISO/TS 15066:2016, A.3.4.

    It is half the mass that the joints or the drive move, plus the mass of the tool.
    """
    model = simulation.model
    scene = simulation.scene
    first = model.joint(robot.ROBOT_NAME_PREFIX + scene.robot.get_first_moving_joint(scene.arm))
    moved_kg, tool_kg = (
        float(model.body_subtreemass[int(body)]) for body in (first.bodyid[0], model.body(SCENE_TOOL_BODY).id)
    )
    return 0.5 * (moved_kg - tool_kg) + tool_kg


def _near_closing_m(closed_m: FloatArray, gap_m: FloatArray) -> FloatArray:
    """Returns the decrease (N, G) of each gap in the last step, in metres.

    The decrease is 0 for large gaps: those that exceed ``MONITORED_DISTANCE_M`` even after another such step.
    """
    return np.where(gap_m - closed_m < MONITORED_DISTANCE_M, closed_m, 0.0)


def _axis_distance_m(point_w: FloatArray, segment_w: FloatArray) -> FloatArray:
    """Returns the distances (N, G) of points (N, 3) from the axes (N, G, 2, 3) of capsules, in metres."""
    return point_segment_distance(point_w[:, None], segment_w[:, :, 0], segment_w[:, :, 1])
