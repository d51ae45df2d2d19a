"""Measures of the real seat and mattress of participants in VR."""

from collections.abc import Mapping
from math import atan2, cos, degrees, hypot, radians, sin
from typing import Literal

import msgspec

from avrgym.models.furniture.bed import MATTRESS_TOP_HEIGHT_M
from avrgym.models.furniture.wheelchair import SEAT_DEPTH_M, SEAT_HEIGHT_M
from avrgym.models.human import RECLINED_POSTURE, SEATED_POSTURE, Posture

HIPS_TO_BACKREST_DISTANCE_M = 0.13
"""Distance of the centre of the hips from the backrest: about the radius of the hips."""
FurniturePoint = Literal["front", "rear", "top", "headrest"]
"""Points that measure a seat: its front edge, its rear edge at the backrest, the top of the backrest, and the front of
the headrest. Points of a mattress are the surface below the thighs, both ends of the raised back, and the pillow.
"""
REQUIRED_FURNITURE_POINTS: tuple[FurniturePoint, ...] = ("front", "rear", "top")
"""The points that a measurement of furniture needs."""
LocalFloorPosition = tuple[float, float, float]
"""A position in metres in ``local-floor``: x and z are horizontal, y is the height above the floor."""
FURNITURE_MEASURE_RANGES: Mapping[str, tuple[float, float]] = {
    "seat_height_m": (0.30, 0.70),
    "seat_depth_m": (0.30, 0.80),
    "seat_back_deg": (45.0, 100.0),
    "seat_tilt_deg": (-10.0, 45.0),
    "headrest_m": (0.0, 0.15),
    "mattress_height_m": (0.05, 1.00),
    "mattress_back_deg": (20.0, 90.0),
}


class RealFurniture(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A real seat and mattress. The defaults are the virtual wheelchair and bed.

    Heights above the floor and seat depth are in metres. ``*_back_deg`` are the backrest angles from the horizontal
    during calibration. ``seat_tilt_deg`` is the backward tilt of the seat. The seat height is that of the front edge;
    with a tilt, the hips are lower. ``headrest_m`` is the distance of the resting head in front of the line of the
    backrest.

    Raises:
        ValueError: for a value out of range.
    """

    seat_height_m: float = SEAT_HEIGHT_M
    seat_depth_m: float = SEAT_DEPTH_M
    seat_back_deg: float = 90.0 + SEATED_POSTURE.hips_deg
    seat_tilt_deg: float = 0.0
    headrest_m: float = 0.0
    mattress_height_m: float = MATTRESS_TOP_HEIGHT_M
    mattress_back_deg: float = 90.0 + RECLINED_POSTURE.hips_deg

    def __post_init__(self) -> None:
        for name, (low, high) in FURNITURE_MEASURE_RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} is {value:g}; allowed: {low:g} to {high:g}")

    def compute_height_offset_m(self, posture: Posture) -> float:
        """Returns the height of the real seat or mattress above the virtual one, in metres."""
        lower_m = (self.seat_depth_m - HIPS_TO_BACKREST_DISTANCE_M) * sin(radians(self.seat_tilt_deg))
        real_m = self.seat_height_m - lower_m if posture.is_seated else self.mattress_height_m
        virtual_m = SEAT_HEIGHT_M if posture.is_seated else MATTRESS_TOP_HEIGHT_M
        return real_m - virtual_m - posture.height_offset_m

    def compute_head_height_offset_m(self, posture: Posture, torso_height_m: float) -> float:
        """Returns the height difference of a resting head in metres: on real furniture minus on virtual furniture."""
        real, virtual = (
            sin(radians(deg)) for deg in (self.get_backrest_angle_deg(posture), 90.0 + posture.hips_deg)
        )
        return (
            self.compute_height_offset_m(posture)
            + torso_height_m * (real - virtual)
            + self.compute_head_rise_m(posture)
        )

    def compute_head_rise_m(self, posture: Posture) -> float:
        """Returns the height difference of the head with and without headrest, in metres; 0 for an upright back."""
        return self.headrest_m * cos(radians(self.get_backrest_angle_deg(posture)))

    def compute_head_forward_offset_m(self, posture: Posture) -> float:
        """Returns the forward displacement of the head by the headrest, in metres."""
        return self.headrest_m * sin(radians(self.get_backrest_angle_deg(posture)))

    def describe(self, *, seated: bool) -> str:
        """Returns the measures of the seat, or of the mattress, in one line of English."""
        headrest = f", headrest {round(self.headrest_m, 3):g} m in front" if self.headrest_m else ""
        if not seated:
            return (
                f"{round(self.mattress_height_m, 3):g} m high, back at {round(self.mattress_back_deg, 1):g}°"
                f"{headrest}"
            )
        measures = f"{round(self.seat_height_m, 3):g} m high, {round(self.seat_depth_m, 3):g} m deep"
        tilt = f", tilted by {round(self.seat_tilt_deg, 1):g}°" if self.seat_tilt_deg else ""
        return f"{measures}, back at {round(self.seat_back_deg, 1):g}°{tilt}{headrest}"

    def get_backrest_angle_deg(self, posture: Posture) -> float:
        """Returns the backrest angle of the real furniture from the horizontal, in degrees."""
        return self.seat_back_deg if posture.is_seated else self.mattress_back_deg


DEFAULT_FURNITURE = RealFurniture()
"""Real furniture with the sizes of the virtual wheelchair and bed."""


def change_furniture(defaults: RealFurniture, **values: float | None) -> RealFurniture:
    """Returns a copy of ``defaults`` with changed fields. Fields with the value ``None`` do not change.

    Raises:
        ValueError: for a value out of range.
    """
    changed = {name: value for name, value in values.items() if value is not None}
    return RealFurniture(**msgspec.structs.asdict(defaults) | changed)


def measure_furniture(
    before: RealFurniture, points: Mapping[FurniturePoint, LocalFloorPosition], *, seated: bool
) -> RealFurniture:
    """Returns the furniture with the measures of a seat, or of a mattress.

    ``points``: the positions of ``REQUIRED_FURNITURE_POINTS``, and optionally of the headrest. Other measures are
    copied from ``before``.

    Raises:
        ValueError: for a value out of range, which means that a point was not touched.
    """
    (front_x, front_m, front_z), rear, top = (points[name] for name in REQUIRED_FURNITURE_POINTS)
    run_x, run_z = rear[0] - front_x, rear[2] - front_z
    run_m = max(hypot(run_x, run_z), 1e-6)

    def behind_and_above_m(point: LocalFloorPosition) -> tuple[float, float]:
        """Returns the horizontal and the vertical distance of a point from the rear point, in metres. Behind and above
        are positive.
        """
        return ((point[0] - rear[0]) * run_x + (point[2] - rear[2]) * run_z) / run_m, point[1] - rear[1]

    top_behind_m, top_above_m = behind_and_above_m(top)
    back_rad = atan2(top_above_m, top_behind_m)
    back_deg, headrest_m = degrees(back_rad), None
    if "headrest" in points:
        behind_m, above_m = behind_and_above_m(points["headrest"])
        headrest_m = max(0.0, above_m * cos(back_rad) - behind_m * sin(back_rad))
    if not seated:
        return change_furniture(
            before, mattress_height_m=rear[1], mattress_back_deg=back_deg, headrest_m=headrest_m
        )
    return change_furniture(
        before,
        seat_height_m=front_m,
        seat_depth_m=hypot(run_m, rear[1] - front_m),
        seat_tilt_deg=degrees(atan2(front_m - rear[1], run_m)),
        seat_back_deg=back_deg,
        headrest_m=headrest_m,
    )
