"""What participants really sit and lie on while they see the virtual wheelchair and bed."""

from collections.abc import Mapping
from math import radians, sin

import msgspec

from avrgym.models.furniture.bed import MATTRESS_TOP_M
from avrgym.models.furniture.wheelchair import SEAT_DEPTH_M, SEAT_HEIGHT_M
from avrgym.models.human import RECLINED, SEATED, Posture

RANGES: Mapping[str, tuple[float, float]] = {
    "seat_height_m": (0.30, 0.70),
    "seat_depth_m": (0.30, 0.80),
    "seat_back_deg": (45.0, 100.0),
    "mattress_height_m": (0.05, 1.00),
    "mattress_back_deg": (20.0, 90.0),
}


class RealFurniture(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A real seat and a real mattress, as those of the virtual wheelchair and bed unless given.

    Heights above the floor and depth in metres; ``*_back_deg`` are the angles of the backs that participants lean on
    while they are measured, from the horizontal. The depth of a seat changes no measure, since people are placed by
    their heads; it is kept with the recordings.

    Raises:
        ValueError: for what no such furniture has, naming what is allowed.
    """

    seat_height_m: float = SEAT_HEIGHT_M
    seat_depth_m: float = SEAT_DEPTH_M
    seat_back_deg: float = 90.0 + SEATED.hips_deg
    mattress_height_m: float = MATTRESS_TOP_M
    mattress_back_deg: float = 90.0 + RECLINED.hips_deg

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} is {value:g}; allowed: {low:g} to {high:g}")

    def rise_m(self, posture: Posture) -> float:
        """How much higher the real seat or mattress is than the virtual one."""
        if posture is SEATED:
            return self.seat_height_m - SEAT_HEIGHT_M
        return self.mattress_height_m - MATTRESS_TOP_M

    def head_rise_m(self, posture: Posture, torso_height_m: float) -> float:
        """How much higher the head of somebody at rest is here than on the virtual seat or mattress."""
        real, virtual = (sin(radians(deg)) for deg in (self.back_deg(posture), 90.0 + posture.hips_deg))
        return self.rise_m(posture) + torso_height_m * (real - virtual)

    def back_deg(self, posture: Posture) -> float:
        """The angle of the back that is leant on, from the horizontal."""
        return self.seat_back_deg if posture is SEATED else self.mattress_back_deg


REAL_AS_VIRTUAL = RealFurniture()


def real_furniture(otherwise: RealFurniture, **given: float | None) -> RealFurniture:
    """What is given, in the names and units of ``RealFurniture``, and ``otherwise`` where that is ``None``.

    Raises:
        ValueError: for what no such furniture has, naming what is allowed.
    """
    changed = {name: value for name, value in given.items() if value is not None}
    return RealFurniture(**msgspec.structs.asdict(otherwise) | changed)
