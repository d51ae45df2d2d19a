"""The cup and its water."""

import math

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.geoms import BOX, CYLINDER, add_collision, add_material, add_skin
from avrgym.models.shapes import revolve
from avrgym.models.tools import Hull, Particles, Tool

RIM_RADIUS_M, FOOT_RADIUS_M, HEIGHT_M = 0.047, 0.034, 0.125
"""The cup of the 2020 reference, tapered so that every hand fits around its lower half."""
AXIS_X_M = -RIM_RADIUS_M
"""The cup's axis in the tool's frame. The frame's origin is the pouring edge of the rim."""

_WALLS, _WALL_M, _FLOOR_M = 8, 0.004, 0.006
_TAPER_RAD = math.atan2(RIM_RADIUS_M - FOOT_RADIUS_M, HEIGHT_M)


def inner_radius_m(z: float) -> float:
    """Inner radius at height ``z`` in the tool's frame; the rim is at zero."""
    return RIM_RADIUS_M + z * math.tan(_TAPER_RAD) - _WALL_M / math.cos(_TAPER_RAD)


def _packed(count: int, radius_m: float) -> FloatArray:
    """The lowest ``count`` centres of a close packing of spheres in the cup (count, 3)."""
    pitch = 2.02 * radius_m
    places: list[FloatArray] = []
    layer = 0
    while len(places) < count:
        z = _FLOOR_M - HEIGHT_M + radius_m * (1.0 + layer * np.sqrt(8.0 / 3.0) * 1.01)
        places.extend(_layer(z, inner_radius_m(z) - 1.05 * radius_m, pitch, shifted=layer % 2 == 1))
        layer += 1
    return np.array(places[:count])


def _layer(z: float, reach_m: float, pitch: float, *, shifted: bool) -> list[FloatArray]:
    """A hexagonal layer around the cup's axis, sorted by distance from the axis."""
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(-9, 10), np.arange(-9, 10), indexing="ij"))
    x, y = pitch * (i + 0.5 * j), pitch * np.sqrt(0.75) * (j + (2.0 / 3.0 if shifted else 0.0))
    distance = np.hypot(x, y)
    nearest = [k for k in np.argsort(distance, kind="stable") if distance[k] <= reach_m]
    return [np.array([AXIS_X_M + x[k], y[k], z]) for k in nearest]


WATER = Particles(
    name="water",
    start=_packed(64, radius_m=0.005),
    radius_m=0.005,
    mass_kg=0.001,
    rgb=(0.35, 0.62, 0.86),
    fluid=True,
)
"""64 spheres, radius 5 mm, 1 g (paper, section IV; reference)."""


def _build_cup(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """A floor and a ring of tilted walls. The pouring edge is between two walls."""
    floor = [AXIS_X_M, 0.0, 0.5 * _FLOOR_M - HEIGHT_M]
    size = [FOOT_RADIUS_M, 0.5 * _FLOOR_M, 0.0]
    add_collision(body, "cup_floor", CYLINDER, collision_bits.TOOL, pos=floor, size=size, mass=0.02)
    for wall in range(_WALLS):
        _add_wall(body, f"cup_wall_{wall}", 2.0 * np.pi * (wall + 0.5) / _WALLS)
    if appearance:
        white = add_material(spec, "cup", (0.94, 0.94, 0.92), roughness=0.35)
        add_skin(spec, body, "cup_skin", white, revolve(_OUTLINE), pos=[AXIS_X_M, 0.0, 0.0])


def _add_wall(body: mujoco.MjsBody, name: str, angle_rad: float) -> None:
    """A box whose inner face touches the cone at ``angle_rad`` around the cup's axis."""
    around = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(angle_rad))
    lean = transforms.from_axis_angle([0.0, 1.0, 0.0], _TAPER_RAD)
    outward = transforms.rotate(around, [1.0, 0.0, 0.0])
    distance = inner_radius_m(-0.5 * HEIGHT_M) + 0.5 * _WALL_M / math.cos(_TAPER_RAD)
    size = [0.5 * _WALL_M, RIM_RADIUS_M * math.tan(np.pi / _WALLS), 0.5 * HEIGHT_M / math.cos(_TAPER_RAD)]
    add_collision(
        body, name, BOX, collision_bits.TOOL,
        pos=[AXIS_X_M, 0.0, -0.5 * HEIGHT_M] + distance * outward,
        quat=transforms.multiply(around, lean), size=size, mass=0.005,
    )  # fmt: skip


_OUTLINE = [
    (0.0, -0.1225), (0.031, -0.1225), (0.032, -0.125), (0.0335, -0.125), (0.0345, -0.123),
    (0.0455, -0.006), (0.0465, -0.005), (0.0478, -0.003), (0.0478, -0.001), (0.0470, 0.0),
    (0.0455, -0.0005), (0.0445, -0.002), (0.0325, -0.117), (0.030, -0.119), (0.0, -0.119),
]  # fmt: skip
"""Radius and height of the cup's visual mesh, with a rolled rim."""

CUP = Tool(
    "cup",
    _build_cup,
    grip_pos=(AXIS_X_M, 0.0, -0.075),
    particles=WATER,
    hull=Hull(
        ("cup_floor", *(f"cup_wall_{wall}" for wall in range(_WALLS))),
        CYLINDER,
        pos=(AXIS_X_M, 0.0, -0.5 * HEIGHT_M),
        size=(0.5 * (FOOT_RADIUS_M + RIM_RADIUS_M), 0.5 * HEIGHT_M, 0.0),
    ),
)
