"""The spoon and its food."""

import math

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.geoms import BOX, CAPSULE, add_collision, add_material, add_skin
from avrgym.models.shapes import Section, loft, tube
from avrgym.models.tools import Hull, Particles, Tool


def _grid(x: list[float], y: list[float], z: float) -> FloatArray:
    return np.array([[px, py, z] for px in x for py in y])


FOOD = Particles(
    name="food",
    start=_grid([-0.0153, -0.0051, 0.0051, 0.0153], [-0.0051, 0.0051], -0.0028),
    radius_m=0.005,
    mass_kg=0.001,
    rgb=(0.86, 0.45, 0.16),
)
"""Eight spheres, radius 5 mm, 1 g (paper, section IV; reference)."""

SPOON_LENGTH_M = 0.17
_BOWL = (0.0260, 0.0195)  # half length, half width of the bowl at its rim
_FLOOR = (0.0206, 0.0108)  # the same of its level floor
_LEAN = (0.003, 0.006)  # outward tilt of its walls: front and back, sides
_WALL = 0.003
_FLOOR_Z, _RIM_Z = -0.008, 0.005


def _build_spoon(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """A level bowl of boxes with tilted walls, and a handle towards the hand."""
    _add_bowl_walls(body)
    handle_end = -(SPOON_LENGTH_M - _BOWL[0])
    add_collision(
        body,
        "spoon_handle",
        CAPSULE,
        collision_bits.TOOL,
        fromto=[-_BOWL[0], 0, _RIM_Z, handle_end, 0, _RIM_Z],
        size=[0.004, 0, 0],
        mass=0.02,
    )
    if appearance:
        _add_spoon_skin(spec, body, handle_end)


def _add_bowl_walls(body: mujoco.MjsBody) -> None:
    half_wall, height = 0.5 * _WALL, _RIM_Z - _FLOOR_Z
    add_collision(
        body, "spoon_floor", BOX, collision_bits.TOOL,
        pos=[0, 0, _FLOOR_Z - half_wall], size=[*_FLOOR, half_wall], mass=0.01,
    )  # fmt: skip
    for name, axis, sign in (("left", 1, 1.0), ("right", 1, -1.0), ("front", 0, 1.0), ("back", 0, -1.0)):
        lean = _LEAN[axis]
        out = np.eye(3)[axis] * sign
        turn = transforms.from_axis_angle(np.cross([0.0, 0.0, 1.0], out), math.atan2(lean, height))
        normal = transforms.rotate(turn, out)
        centre = out * (_FLOOR[axis] + 0.5 * lean) + [0, 0, _FLOOR_Z + 0.5 * height] + normal * half_wall
        along = _FLOOR[1 - axis] + _LEAN[1 - axis]
        size = np.where(np.eye(3)[axis] == 1.0, half_wall, [along, along, 0.5 * np.hypot(lean, height)])
        add_collision(
            body, f"spoon_{name}", BOX, collision_bits.TOOL, pos=centre, quat=turn, size=size, mass=0.002
        )


def _add_spoon_skin(spec: mujoco.MjSpec, body: mujoco.MjsBody, handle_end: float) -> None:
    steel = add_material(spec, "steel", (0.80, 0.81, 0.83), metallic=0.4, roughness=0.3)
    a, b = _BOWL
    outside = [(-0.0108, 0.35), (-0.0098, 0.70), (-0.006, 0.88), (0.0, 0.97), (_RIM_Z, 1.03)]
    inside = [(_RIM_Z, 0.97), (0.0, 0.90), (-0.005, 0.80), (-0.0082, 0.62), (-0.0088, 0.30)]
    bowl = loft([Section(z, a * s, b * s, exponent=2.3) for z, s in outside + inside], segments=40)
    add_skin(spec, body, "spoon_bowl_skin", steel, bowl)
    x = np.linspace(-0.96 * a, handle_end, 14)
    bend = _RIM_Z + 0.006 * np.sin(np.pi * (x + a) / (handle_end + a))
    add_skin(spec, body, "spoon_handle_skin", steel, tube(np.stack([x, 0 * x, bend], axis=-1), 0.0038))


_RIM = tuple(floor + lean + _WALL for floor, lean in zip(_FLOOR, _LEAN, strict=True))
_BOTTOM_Z = _FLOOR_Z - _WALL

SPOON = Tool(
    "spoon",
    _build_spoon,
    grip_pos=(0.02 + _BOWL[0] - SPOON_LENGTH_M, 0.0, 0.0),
    particles=FOOD,
    hull=Hull(
        ("spoon_floor", "spoon_left", "spoon_right", "spoon_front", "spoon_back"),
        BOX,
        pos=(0.0, 0.0, 0.5 * (_BOTTOM_Z + _RIM_Z)),
        size=(_RIM[0], _RIM[1], 0.5 * (_RIM_Z - _BOTTOM_Z)),
    ),
)

OUTLINE = np.concatenate(
    [
        _grid([share * _RIM[0] for share in (-1.0, -0.5, 0.0, 0.5, 1.0)], [-_RIM[1], 0.0, _RIM[1]], _RIM_Z),
        _grid([-_FLOOR[0], _FLOOR[0]], [-_FLOOR[1], _FLOOR[1]], _BOTTOM_Z),
    ]
)
"""Points (P, 3) on the outside of the bowl, in the tool's frame."""
