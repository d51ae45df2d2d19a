"""Measures of the real seat and mattress of participants in VR."""

from collections.abc import Mapping
from math import radians, sin

import msgspec

from avrgym.models.furniture.bed import MATTRESS_TOP_M
from avrgym.models.furniture.wheelchair import SEAT_DEPTH_M, SEAT_HEIGHT_M
from avrgym.models.human import RECLINED, SEATED, Posture

ALLOWED_RANGES: Mapping[str, tuple[float, float]] = {
    "seat_height_m": (0.30, 0.70),
    "seat_depth_m": (0.30, 0.80),
    "seat_back_deg": (45.0, 100.0),
    "mattress_height_m": (0.05, 1.00),
    "mattress_back_deg": (20.0, 90.0),
}


class RealFurniture(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A real seat and mattress. The defaults are the virtual wheelchair and bed.

    Heights above the floor and seat depth are in metres. ``*_back_deg`` are the backrest angles from the horizontal
    during calibration. The seat depth is only recorded, because calibration uses the position of the head.

    Raises:
        ValueError: for a value out of range.
    """

    seat_height_m: float = SEAT_HEIGHT_M
    seat_depth_m: float = SEAT_DEPTH_M
    seat_back_deg: float = 90.0 + SEATED.hips_deg
    mattress_height_m: float = MATTRESS_TOP_M
    mattress_back_deg: float = 90.0 + RECLINED.hips_deg

    def __post_init__(self) -> None:
        for name, (low, high) in ALLOWED_RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} is {value:g}; allowed: {low:g} to {high:g}")

    def height_offset_m(self, posture: Posture) -> float:
        """Returns the height of the real seat or mattress above the virtual one, in metres."""
        real_m = self.seat_height_m if posture.seated else self.mattress_height_m
        virtual_m = SEAT_HEIGHT_M if posture.seated else MATTRESS_TOP_M
        return real_m - virtual_m - posture.rise_m

    def head_height_offset_m(self, posture: Posture, torso_height_m: float) -> float:
        """Returns the height difference of a resting head in metres: on real furniture minus on virtual furniture."""
        real, virtual = (sin(radians(deg)) for deg in (self.backrest_deg(posture), 90.0 + posture.hips_deg))
        return self.height_offset_m(posture) + torso_height_m * (real - virtual)

    def backrest_deg(self, posture: Posture) -> float:
        """Returns the backrest angle of the real furniture from the horizontal, in degrees."""
        return self.seat_back_deg if posture.seated else self.mattress_back_deg


DEFAULT_FURNITURE = RealFurniture()
"""Real furniture with the sizes of the virtual wheelchair and bed."""


def change_furniture(defaults: RealFurniture, **values: float | None) -> RealFurniture:
    """Returns a copy of ``defaults`` with changed fields. Fields with the value ``None`` do not change.

    Raises:
        ValueError: for a value out of range.
    """
    changed = {name: value for name, value in values.items() if value is not None}
    return RealFurniture(**msgspec.structs.asdict(defaults) | changed)
