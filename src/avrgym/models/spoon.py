"""Spoons with food, for feeding."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.geoms import BOX, CAPSULE, add_collision_geom, add_material, add_visual_mesh
from avrgym.models.shapes import CrossSection, make_loft, make_tube
from avrgym.models.tools import CollisionHull, Particles, Tool


def _grid(x: list[float], y: list[float], z: float) -> FloatArray:
    return np.array([[px, py, z] for px in x for py in y])


SPOON_SCALES: Mapping[str, float] = {"small": 0.85, "medium": 1.0, "large": 1.25}
"""Scale of the bowl's length and width, by the size of the spoon."""
_PITCH_M, _FOOD_Z = 0.0102, -0.0028

SPOON_LENGTH_M = 0.17
_BOWL = (0.0260, 0.0195)  # half length, half width of the bowl at its rim
_FLOOR = (0.0206, 0.0108)  # half length, half width of its level floor
_LEAN = (0.003, 0.006)  # outward tilt of its walls: front and back, sides
_WALL = 0.003
_FLOOR_Z, _RIM_Z = -0.008, 0.005


@lru_cache
def make_spoon(size: str = "medium", pieces: int | None = None) -> Tool:
    """Returns a spoon with ``pieces`` pieces of food.

    Each piece is a sphere of radius 5 mm and 1 g. The pieces are in one layer, in the middle of the spoon.

    Raises:
        ValueError: for an unknown size, or too many pieces for the spoon.
    """
    if size not in SPOON_SCALES:
        raise ValueError(f"unknown size of spoon {size!r}; allowed: {', '.join(SPOON_SCALES)}")
    bowl, floor = (tuple(SPOON_SCALES[size] * each for each in half) for half in (_BOWL, _FLOOR))
    places = _places(floor)
    count = min(len(FOOD.initial_pos), len(places)) if pieces is None else pieces
    if count > len(places):
        raise ValueError(f"particles is {pieces}; allowed on a {size} spoon: 1 to {len(places)}")
    middle = np.argsort(np.hypot(*places[:, :2].T), kind="stable")[:count]
    rim = tuple(half + lean + _WALL for half, lean in zip(floor, _LEAN, strict=True))
    bottom_z = _FLOOR_Z - _WALL
    return Tool(
        "spoon",
        partial(_build_spoon, bowl, floor),
        grip_pos=(0.02 + bowl[0] - SPOON_LENGTH_M, 0.0, 0.0),
        particles=replace(FOOD, initial_pos=places[np.sort(middle)]),
        hull=CollisionHull(
            ("spoon_floor", "spoon_left", "spoon_right", "spoon_front", "spoon_back"),
            BOX,
            pos=(0.0, 0.0, 0.5 * (bottom_z + _RIM_Z)),
            size=(rim[0], rim[1], 0.5 * (_RIM_Z - bottom_z)),
        ),
        mouth_part_outline=np.concatenate(
            [
                _grid(
                    [share * rim[0] for share in (-1.0, -0.5, 0.0, 0.5, 1.0)], [-rim[1], 0.0, rim[1]], _RIM_Z
                ),
                _grid([-floor[0], floor[0]], [-floor[1], floor[1]], bottom_z),
            ]
        ),
    )


def _places(floor: tuple[float, ...]) -> FloatArray:
    """Returns the centres (K, 3) of food pieces in one layer on the floor of the spoon's bowl."""
    along, across = (
        [round(_PITCH_M * (i - 0.5 * (count - 1)), 4) for i in range(count)]
        for count in (int(2.0 * half / _PITCH_M) for half in floor)
    )
    return _grid(along, across, _FOOD_Z)


FOOD = Particles(
    name="food", initial_pos=_places(_FLOOR), radius_m=0.005, mass_kg=0.001, rgb=(0.86, 0.45, 0.16)
)
"""Food on the default spoon: eight spheres of radius 5 mm and 1 g (paper, section IV, and its code)."""


def _build_spoon(
    bowl: tuple[float, ...],
    floor: tuple[float, ...],
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    appearance: bool,
) -> None:
    """Build a level bowl of boxes with tilted walls, and a handle towards the hand."""
    _add_bowl_walls(body, floor)
    handle_end = -(SPOON_LENGTH_M - bowl[0])
    add_collision_geom(
        body,
        "spoon_handle",
        CAPSULE,
        collision_bits.TOOL,
        fromto=[-bowl[0], 0, _RIM_Z, handle_end, 0, _RIM_Z],
        size=[0.004, 0, 0],
        mass=0.02,
    )
    if appearance:
        _add_spoon_skin(spec, body, bowl, handle_end)


def _add_bowl_walls(body: mujoco.MjsBody, floor: tuple[float, ...]) -> None:
    half_wall, height = 0.5 * _WALL, _RIM_Z - _FLOOR_Z
    add_collision_geom(
        body, "spoon_floor", BOX, collision_bits.TOOL,
        pos=[0, 0, _FLOOR_Z - half_wall], size=[*floor, half_wall], mass=0.01,
    )  # fmt: skip
    for name, axis, sign in (("left", 1, 1.0), ("right", 1, -1.0), ("front", 0, 1.0), ("back", 0, -1.0)):
        lean = _LEAN[axis]
        out = np.eye(3)[axis] * sign
        turn = transforms.from_axis_angle(np.cross([0.0, 0.0, 1.0], out), math.atan2(lean, height))
        normal = transforms.rotate(turn, out)
        centre = out * (floor[axis] + 0.5 * lean) + [0, 0, _FLOOR_Z + 0.5 * height] + normal * half_wall
        along = floor[1 - axis] + _LEAN[1 - axis]
        size = np.where(np.eye(3)[axis] == 1.0, half_wall, [along, along, 0.5 * np.hypot(lean, height)])
        add_collision_geom(
            body, f"spoon_{name}", BOX, collision_bits.TOOL, pos=centre, quat=turn, size=size, mass=0.002
        )


def _add_spoon_skin(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, half_size: tuple[float, ...], handle_end: float
) -> None:
    steel = add_material(spec, "steel", (0.80, 0.81, 0.83), metallic=0.4, roughness=0.3)
    a, b = half_size
    outside = [(-0.0108, 0.35), (-0.0098, 0.70), (-0.006, 0.88), (0.0, 0.97), (_RIM_Z, 1.03)]
    inside = [(_RIM_Z, 0.97), (0.0, 0.90), (-0.005, 0.80), (-0.0082, 0.62), (-0.0088, 0.30)]
    bowl = make_loft([CrossSection(z, a * s, b * s, exponent=2.3) for z, s in outside + inside], segments=40)
    add_visual_mesh(spec, body, "spoon_bowl_skin", steel, bowl)
    x = np.linspace(-0.96 * a, handle_end, 14)
    bend = _RIM_Z + 0.006 * np.sin(np.pi * (x + a) / (handle_end + a))
    add_visual_mesh(
        spec, body, "spoon_handle_skin", steel, make_tube(np.stack([x, 0 * x, bend], axis=-1), 0.0038)
    )


SPOON = make_spoon()
"""The default spoon, with eight pieces of food."""
