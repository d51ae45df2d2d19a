"""Contact forces on people by region of the body: sensors, loads over episodes, and statistics."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry.transforms import norm
from avrgym.models.scene import PHYSICS_STEP_S, SceneConfig, add_geom_force_sensor
from avrgym.safety.limits import (
    BODY_REGIONS,
    MAX_TRANSIENT_DURATION_S,
    QUASI_STATIC_LIMIT_N,
    REGION_INDEX_OF_GEOM,
    TRANSIENT_LIMIT_N,
)

MAX_GEOM_CONTACTS, MAX_CLOTH_GEOM_CONTACTS = 8, 64
"""Maximum number of contacts that a sensor measures for one geom of the person, without and with cloth. A grasp with
three fingers has fewer than 8 contacts; a sleeve around an arm has up to 40.
"""


def add_region_sensors(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Add sensors of the contact forces of robot and cloth on each geom of the person.

    The sensors do not change the simulation, but they slow it down a little.
    """
    contacts = MAX_GEOM_CONTACTS if scene.tool.cloth is None else MAX_CLOTH_GEOM_CONTACTS
    for geom in REGION_INDEX_OF_GEOM:
        add_geom_force_sensor(spec, scene, _sensor(geom), geom, contacts)


def _sensor(geom: str) -> str:
    return f"robot_contacts_with_{geom}"


class RegionForceSensors:
    """Reads the sensors of ``add_region_sensors`` from the sensor data (N, S) of N worlds."""

    def __init__(self, model: mujoco.MjModel, sensordata: FloatArray) -> None:
        self._sensordata = sensordata
        sensors = [model.sensor(_sensor(geom)) for geom in REGION_INDEX_OF_GEOM]
        first, size = int(sensors[0].adr[0]), int(sensors[0].dim[0])
        self._columns = slice(first, first + len(sensors) * size)
        self._shape = len(sensors), size // 3, 3
        self._first_of_region = np.searchsorted(
            [*REGION_INDEX_OF_GEOM.values()], np.arange(len(BODY_REGIONS))
        )

    def read_forces_n(self) -> FloatArray:
        """Returns the contact forces (N, R) by region, in newtons: sums of the magnitudes of all contact forces."""
        contacts_n = self._sensordata[:, self._columns]
        force_n = np.zeros((len(contacts_n), len(BODY_REGIONS)))
        touched = np.flatnonzero(contacts_n.any(axis=-1))
        if len(touched):
            on_geoms = norm(contacts_n[touched].reshape(-1, *self._shape)).cumsum(axis=-1)[..., -1]
            force_n[touched] = np.add.reduceat(on_geoms, self._first_of_region, axis=-1)
        return force_n


@dataclass(frozen=True)
class RegionLoads:
    """Contact forces on the body regions of n people in one episode each. All arrays are (n, R).

    Attributes:
        mean_force_n: mean force over all physics steps, newtons.
        peak_force_n: maximum force over all physics steps, newtons.
        contact_time_fraction: share of physics steps with a force.
        max_overload_duration_s: longest continuous time above the quasi-static limit.
    """

    mean_force_n: FloatArray
    peak_force_n: FloatArray
    contact_time_fraction: FloatArray
    max_overload_duration_s: FloatArray

    @property
    def over_quasi_static_limit_mask(self) -> BoolArray:
        """Boolean mask (n, R): a force was above the quasi-static limit for longer than
        ``MAX_TRANSIENT_DURATION_S``.
        """
        return self.max_overload_duration_s > MAX_TRANSIENT_DURATION_S

    @property
    def over_transient_limit_mask(self) -> BoolArray:
        """Boolean mask (n, R): a force was above the transient limit in any physics step."""
        return self.peak_force_n > TRANSIENT_LIMIT_N

    @property
    def over_limit_mask(self) -> BoolArray:
        """Boolean mask (n, R): a force exceeded either limit."""
        return self.over_quasi_static_limit_mask | self.over_transient_limit_mask

    @classmethod
    def concatenate(cls, parts: Sequence["RegionLoads"]) -> "RegionLoads":
        """Returns the loads of the people of all ``parts``, in order."""
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))


@dataclass(frozen=True)
class RegionStatistics:
    """Contact forces on one body region over several episodes, in newtons.

    Attributes:
        mean_n: mean force over time and episodes.
        peak_n: maximum force over time and episodes.
        contact_share: share of physics steps with a force.
        quasi_static_limit_n: the region's quasi-static limit.
        transient_limit_n: the region's transient limit.
        over_quasi_static: number of episodes above the quasi-static limit.
        over_transient: number of episodes above the transient limit.
        exceedances: number of episodes above either limit.
    """

    mean_n: float
    peak_n: float
    contact_share: float
    quasi_static_limit_n: float
    transient_limit_n: float
    over_quasi_static: int
    over_transient: int
    exceedances: int


def compute_region_statistics(loads: RegionLoads) -> dict[str, RegionStatistics]:
    """Returns the statistics of every region, by region name."""
    return {
        region.name: RegionStatistics(
            mean_n=float(loads.mean_force_n[:, index].mean()),
            peak_n=float(loads.peak_force_n[:, index].max()),
            contact_share=float(loads.contact_time_fraction[:, index].mean()),
            quasi_static_limit_n=region.quasi_static_limit_n,
            transient_limit_n=region.transient_limit_n,
            over_quasi_static=int(loads.over_quasi_static_limit_mask[:, index].sum()),
            over_transient=int(loads.over_transient_limit_mask[:, index].sum()),
            exceedances=int(loads.over_limit_mask[:, index].sum()),
        )
        for index, region in enumerate(BODY_REGIONS)
    }


class RegionLoadRecorder:
    """Accumulates the contact forces on N people over the physics steps of an episode."""

    def __init__(self, worlds: int) -> None:
        shape = worlds, len(BODY_REGIONS)
        self._steps = 0
        self._sum_n, self._peak_n = np.zeros(shape), np.zeros(shape)
        self._contact_steps, self._over_limit_steps, self._longest_steps = (
            np.zeros(shape, dtype=int) for _ in range(3)
        )

    def add_forces(self, force_n: FloatArray) -> None:
        """Add the forces (N, R) of one physics step, in newtons."""
        self._steps += 1
        self._sum_n += force_n
        self._peak_n = np.maximum(self._peak_n, force_n)
        self._contact_steps += force_n > 0.0
        self._over_limit_steps = np.where(force_n > QUASI_STATIC_LIMIT_N, self._over_limit_steps + 1, 0)
        self._longest_steps = np.maximum(self._longest_steps, self._over_limit_steps)

    def compute_loads(self) -> RegionLoads:
        """Returns the loads (N, R) of the body regions over all physics steps until now."""
        steps = max(1, self._steps)
        return RegionLoads(
            mean_force_n=self._sum_n / steps,
            peak_force_n=self._peak_n,
            contact_time_fraction=self._contact_steps / steps,
            max_overload_duration_s=self._longest_steps * PHYSICS_STEP_S,
        )
