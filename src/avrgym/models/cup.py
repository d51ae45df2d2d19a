"""Cups with water, for drinking."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.geoms import BOX, CYLINDER, add_collision_geom, add_material, add_visual_mesh
from avrgym.models.shapes import revolve
from avrgym.models.tools import CollisionHull, Particles, Tool

_WALLS, _WALL_M, _FLOOR_M = 8, 0.004, 0.006
_GRIP_HEIGHT_M = 0.05
"""Height of the robot's hand above the cup's foot."""
_FREE_BELOW_RIM_M = 0.02
"""Minimum height of the rim above the water."""


@dataclass(frozen=True)
class CupShape:
    """Shape of a cup: radii of rim and foot, and height, in metres. The origin of the tool's frame is the pouring edge
    of the rim.
    """

    rim_radius_m: float
    foot_radius_m: float
    height_m: float

    @property
    def axis_x_m(self) -> float:
        """Returns the x coordinate of the cup's axis in the tool's frame."""
        return -self.rim_radius_m

    @property
    def taper_rad(self) -> float:
        """Returns the angle between the wall and the axis of the cup."""
        return math.atan2(self.rim_radius_m - self.foot_radius_m, self.height_m)

    def compute_inner_radius_m(self, z: float) -> float:
        """Returns the inner radius at height ``z`` in the tool's frame. The rim is at z = 0."""
        return self.rim_radius_m + z * math.tan(self.taper_rad) - _WALL_M / math.cos(self.taper_rad)


CUP_SHAPES: Mapping[str, CupShape] = {
    "cup": CupShape(0.047, 0.034, 0.125),
    "glass": CupShape(0.040, 0.034, 0.135),
    "mug": CupShape(0.043, 0.038, 0.095),
}
"""Shapes of cups by name. ``cup`` is the cup of the paper's code with a narrower foot, for the robots' hands."""
DEFAULT_CUP_SHAPE = CUP_SHAPES["cup"]


def _packed(shape: CupShape, radius_m: float) -> FloatArray:
    """Returns the centres (K, 3) of a close packing of spheres that fills a cup, the lowest first."""
    pitch = 2.02 * radius_m
    places: list[FloatArray] = []
    layer = 0
    while True:
        z = _FLOOR_M - shape.height_m + radius_m * (1.0 + layer * np.sqrt(8.0 / 3.0) * 1.01)
        if z + radius_m > -_FREE_BELOW_RIM_M:
            return np.array(places)
        reach_m = shape.compute_inner_radius_m(z) - 1.05 * radius_m
        places.extend(_layer(shape.axis_x_m, z, reach_m, pitch, shifted=layer % 2 == 1))
        layer += 1


def _layer(axis_x_m: float, z: float, reach_m: float, pitch: float, *, shifted: bool) -> list[FloatArray]:
    """Returns the sphere centres of one hexagonal layer at height ``z``, sorted by distance from the cup's axis."""
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(-9, 10), np.arange(-9, 10), indexing="ij"))
    x, y = pitch * (i + 0.5 * j), pitch * np.sqrt(0.75) * (j + (2.0 / 3.0 if shifted else 0.0))
    distance = np.hypot(x, y)
    nearest = [k for k in np.argsort(distance, kind="stable") if distance[k] <= reach_m]
    return [np.array([axis_x_m + x[k], y[k], z]) for k in nearest]


WATER = Particles(
    name="water",
    initial_pos=_packed(DEFAULT_CUP_SHAPE, 0.005)[:64],
    radius_m=0.005,
    mass_kg=0.001,
    rgb=(0.35, 0.62, 0.86),
    is_fluid=True,
)
"""Water in the default cup: 64 spheres of radius 5 mm and 1 g (paper, section IV, and its code)."""


@lru_cache
def make_cup(name: str = "cup", particles: int = len(WATER.initial_pos)) -> Tool:
    """Returns a cup with the shape ``name`` and ``particles`` particles of water.

    Raises:
        ValueError: for an unknown shape, or too many particles for the cup.
    """
    if name not in CUP_SHAPES:
        raise ValueError(f"unknown cup {name!r}; allowed: {', '.join(CUP_SHAPES)}")
    shape = CUP_SHAPES[name]
    places = _packed(shape, WATER.radius_m)
    if particles > len(places):
        raise ValueError(f"particles is {particles}; allowed for a {name}: 1 to {len(places)}")
    return Tool(
        "cup",
        partial(_build_cup, shape),
        grip_pos=(shape.axis_x_m, 0.0, _GRIP_HEIGHT_M - shape.height_m),
        particles=replace(WATER, initial_pos=places[:particles]),
        hull=CollisionHull(
            ("cup_floor", *(f"cup_wall_{wall}" for wall in range(_WALLS))),
            CYLINDER,
            pos=(shape.axis_x_m, 0.0, -0.5 * shape.height_m),
            size=(0.5 * (shape.foot_radius_m + shape.rim_radius_m), 0.5 * shape.height_m, 0.0),
        ),
    )


def _build_cup(shape: CupShape, spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """Build a floor and a ring of tilted walls. The pouring edge is between two walls."""
    floor = [shape.axis_x_m, 0.0, 0.5 * _FLOOR_M - shape.height_m]
    size = [shape.foot_radius_m, 0.5 * _FLOOR_M, 0.0]
    add_collision_geom(body, "cup_floor", CYLINDER, collision_bits.TOOL, pos=floor, size=size, mass=0.02)
    for wall in range(_WALLS):
        _add_wall(shape, body, f"cup_wall_{wall}", 2.0 * np.pi * (wall + 0.5) / _WALLS)
    if appearance:
        white = add_material(spec, "cup", (0.94, 0.94, 0.92), roughness=0.35)
        add_visual_mesh(
            spec, body, "cup_skin", white, revolve(_outline(shape)), pos=[shape.axis_x_m, 0.0, 0.0]
        )


def _outline(shape: CupShape) -> list[tuple[float, float]]:
    """Returns points (radius, height) of the visual mesh's profile: the profile of ``DEFAULT_CUP_SHAPE``, scaled to a
    shape.
    """

    def wider(share: float) -> float:
        rim, foot = (1.0 - share) * shape.rim_radius_m, share * shape.foot_radius_m
        return (rim + foot) / (
            (1.0 - share) * DEFAULT_CUP_SHAPE.rim_radius_m + share * DEFAULT_CUP_SHAPE.foot_radius_m
        )

    taller = shape.height_m / DEFAULT_CUP_SHAPE.height_m
    return [(r * wider(-z / DEFAULT_CUP_SHAPE.height_m), z * taller) for r, z in _OUTLINE]


def _add_wall(shape: CupShape, body: mujoco.MjsBody, name: str, angle_rad: float) -> None:
    """Add a box as a wall. Its inner side touches the cup's inner cone at ``angle_rad`` around the cup's axis."""
    around = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(angle_rad))
    lean = transforms.from_axis_angle([0.0, 1.0, 0.0], shape.taper_rad)
    outward = transforms.rotate(around, [1.0, 0.0, 0.0])
    distance = shape.compute_inner_radius_m(-0.5 * shape.height_m) + 0.5 * _WALL_M / math.cos(shape.taper_rad)
    size = [
        0.5 * _WALL_M,
        shape.rim_radius_m * math.tan(np.pi / _WALLS),
        0.5 * shape.height_m / math.cos(shape.taper_rad),
    ]
    add_collision_geom(
        body, name, BOX, collision_bits.TOOL,
        pos=[shape.axis_x_m, 0.0, -0.5 * shape.height_m] + distance * outward,
        quat=transforms.multiply(around, lean), size=size, mass=0.005,
    )  # fmt: skip


_OUTLINE = [
    (0.0, -0.1225), (0.031, -0.1225), (0.032, -0.125), (0.0335, -0.125), (0.0345, -0.123),
    (0.0455, -0.006), (0.0465, -0.005), (0.0478, -0.003), (0.0478, -0.001), (0.0470, 0.0),
    (0.0455, -0.0005), (0.0445, -0.002), (0.0325, -0.117), (0.030, -0.119), (0.0, -0.119),
]  # fmt: skip
"""Points (radius, height) of the profile of the cup's visual mesh, with a rolled rim."""

CUP = make_cup()
"""The default cup, with ``WATER``."""
