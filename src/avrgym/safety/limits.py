"""Limits of contact force and contact speed for each region of the body, after ISO/TS 15066.

Table A.2 of ISO/TS 15066:2016 (since 2025 part of ISO 10218-2) limits the force on each region of the body. The limits
apply to healthy adults at work. At the limits, pain or a slight injury such as a bruise begins. Comfortable forces in
care are much lower: a spoon touches lips with 1 to 3 N. The values are from publications that quote the standard,
because its text is not freely available.

A clamped region must stay below the *quasi-static* limit. If a region can move away, the force may reach the
*transient* limit for ``MAX_TRANSIENT_DURATION_S``. This limit is the quasi-static limit times ``transient_factor``.
The standard allows no transient contact with skull and face. Here, the transient limit of these regions equals their
quasi-static limit.

The maximum contact speed follows from the force: body and arm are two masses with a spring between them. The region has
an *effective mass* and a *spring constant* (table A.3); see ``compute_max_impact_speed_m_s``. Simulated contacts have a
different compliance, see ``models.compliance``.

Bodies consist of capsules. A capsule that covers two regions, such as chest and back, has the lower limit of both. The
standard has no limits for feet; they have the limits of lower legs. The front of the cranium, with eyes and nose, has
the forehead's limit.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import FloatArray

MAX_TRANSIENT_DURATION_S = 0.5
"""Maximum duration of a transient force above the quasi-static limit."""


@dataclass(frozen=True)
class BodyRegion:
    """A region of the body: its force limits, spring constant, effective mass, and geoms in ``human.GEOMS``."""

    name: str
    quasi_static_limit_n: float
    transient_factor: float
    spring_constant_n_mm: float
    effective_mass_kg: float
    geoms: tuple[str, ...]

    @property
    def transient_limit_n(self) -> float:
        """The limit that the force must not exceed at any time, newtons."""
        return self.transient_factor * self.quasi_static_limit_n


def _limbs(*parts: str) -> tuple[str, ...]:
    return tuple(f"{side}_{part}" for part in parts for side in ("right", "left"))


BODY_REGIONS = (
    BodyRegion("skull", 130.0, 1.0, 150.0, 4.4, ("cranium",)),
    BodyRegion("face", 65.0, 1.0, 75.0, 4.4, ("jaw",)),
    BodyRegion("neck", 150.0, 2.0, 50.0, 1.2, ("neck",)),
    BodyRegion("shoulders", 210.0, 2.0, 35.0, 40.0, _limbs("shoulder")),
    BodyRegion("chest", 140.0, 2.0, 25.0, 40.0, ("chest",)),
    BodyRegion("abdomen", 110.0, 2.0, 10.0, 40.0, ("waist",)),
    BodyRegion("pelvis", 180.0, 2.0, 25.0, 40.0, ("hips",)),
    BodyRegion("upper_arms", 150.0, 2.0, 30.0, 3.0, _limbs("upper_arm")),
    BodyRegion("forearms", 160.0, 2.0, 40.0, 2.0, _limbs("forearm")),
    BodyRegion("hands", 140.0, 2.0, 75.0, 0.6, _limbs("hand")),
    BodyRegion("thighs", 220.0, 2.0, 50.0, 75.0, _limbs("thigh")),
    BodyRegion("lower_legs", 130.0, 2.0, 60.0, 75.0, _limbs("shin", "foot")),
)
"""The body regions, in the order of all arrays of forces by region (N, R). Forces on the left and the right part of a
region are added.
"""
REGION_INDEX_OF_GEOM: Mapping[str, int] = {
    geom: index for index, region in enumerate(BODY_REGIONS) for geom in region.geoms
}
"""Index in ``BODY_REGIONS`` of each geom's region, by geom name. The geoms of a region are adjacent."""
QUASI_STATIC_LIMIT_N: FloatArray = np.array([region.quasi_static_limit_n for region in BODY_REGIONS])
"""Quasi-static force limits (R,), newtons."""
TRANSIENT_LIMIT_N: FloatArray = np.array([region.transient_limit_n for region in BODY_REGIONS])
"""Transient force limits (R,), newtons."""


def compute_max_impact_speed_m_s(force_n: FloatArray, arm_mass_kg: float) -> FloatArray:
    """Returns the contact speeds (R,) at which an impact causes the forces (R,) on the body regions.

    ISO/TS 15066:2016, A.3.4: the spring stores the kinetic energy of the two masses. The speed is F / √(k μ), with
    1/μ = 1/m_body + 1/m_arm. ``arm_mass_kg`` is the arm's effective mass.
    """
    springs_n_m = np.array([1000.0 * region.spring_constant_n_mm for region in BODY_REGIONS])
    masses_kg = np.array([region.effective_mass_kg for region in BODY_REGIONS])
    return force_n / np.sqrt(springs_n_m / (1.0 / masses_kg + 1.0 / arm_mass_kg))
