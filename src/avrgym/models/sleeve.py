"""The sleeve of a gown. A hoop with a gap and a handle holds the sleeve open.

The origin of the tool's frame is the centre of the opening. The y axis points along the arm to the shoulder: the robot
moves the sleeve in this direction. Robots hold the handle with the same grip as the washcloth.
"""

from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray
from avrgym.models import collision_bits
from avrgym.models.cloth import Cloth, add_attachment_sites
from avrgym.models.geoms import BOX, CAPSULE, add_collision_geom, add_material, add_visual_geom
from avrgym.models.tools import Tool
from avrgym.models.washcloth import WASHCLOTH

VERTICES_PER_RING, RING_COUNT = 8, 5
"""Number of vertices around the sleeve, and of rings along it."""
OPENING_RADIUS_M, FAR_END_RADIUS_M, SLEEVE_LENGTH_M = 0.095, 0.085, 0.28
"""Radii at the opening and at the far end, and length: a short sleeve that leaves the hand free."""
ATTACHED_VERTICES = (5, 6, 7, 0, 1, 2)
"""Vertices of the opening that are fixed to the hoop. The gap of the hoop is wider than an arm, and is on the side
opposite to the robot's hand."""
_HOOP_RADIUS_M, _HANDLE_M = 0.005, 0.05
_HANDLE_HALF_WIDTH_M, _HANDLE_HALF_THICKNESS_M = 0.043, 0.006
_GRIP_ON_HANDLE_M = 0.042
"""Distance of the robot's fingers from the rim of the opening, along the handle."""
_HOOP_RGB, _GOWN_RGB = (0.92, 0.92, 0.90), (0.36, 0.62, 0.72)


def _vertices() -> FloatArray:
    """Returns the stress-free positions (V, 3) of the vertices, ring by ring from the opening."""
    angle = 2.0 * np.pi * (np.arange(VERTICES_PER_RING) + 0.5) / VERTICES_PER_RING
    share = np.linspace(0.0, 1.0, RING_COUNT)
    radius = OPENING_RADIUS_M + share * (FAR_END_RADIUS_M - OPENING_RADIUS_M)
    x, z = (-np.outer(radius, part) for part in (np.cos(angle), np.sin(angle)))
    y = np.tile(-SLEEVE_LENGTH_M * share[:, None], (1, VERTICES_PER_RING))
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def _faces() -> NDArray[np.int64]:
    """Returns the triangles (F, 3). Their diagonals alternate, because parallel diagonals would twist the sleeve."""
    found: list[tuple[int, int, int]] = []
    for ring in range(RING_COUNT - 1):
        for place in range(VERTICES_PER_RING):
            a, b = (
                ring * VERTICES_PER_RING + place,
                ring * VERTICES_PER_RING + (place + 1) % VERTICES_PER_RING,
            )
            c, d = a + VERTICES_PER_RING, b + VERTICES_PER_RING
            found += [(a, b, d), (a, d, c)] if (ring + place) % 2 else [(a, b, c), (b, d, c)]
    return np.array(found)


SLEEVE_CLOTH = Cloth(
    name="sleeve",
    initial_pos=_vertices(),
    faces=_faces(),
    attached_vertices=ATTACHED_VERTICES,
    mass_kg=0.06,
    thickness_m=0.003,
    young_modulus_pa=5e4,
    poisson_ratio=0.1,
    damping_s=0.02,
    contact_radius_m=0.006,
    friction=0.2,
    rgb=_GOWN_RGB,
)
"""The cloth of the sleeve. Assumptions: the mass per area of terry cloth (0.35 kg/m²), and the stiffness of a padded
garment. Finer folds need more vertices."""


def _build(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """Build a hoop of rods along the attached vertices, and a handle."""
    add_attachment_sites(body, SLEEVE_CLOTH)
    rim = SLEEVE_CLOTH.initial_pos[list(ATTACHED_VERTICES)]
    for number, (begin, end) in enumerate(pairwise(rim)):
        add_collision_geom(
            body, f"hoop_{number}", CAPSULE, collision_bits.TOOL,
            fromto=[*begin, *end], size=[_HOOP_RADIUS_M, 0, 0], mass=0.01,
        )  # fmt: skip
    nearest = float(rim[:, 0].min())
    middle = [nearest - 0.5 * _HANDLE_M, 0.0, 0.0]
    size = [0.5 * _HANDLE_M, _HANDLE_HALF_WIDTH_M, _HANDLE_HALF_THICKNESS_M]
    add_collision_geom(body, "handle", BOX, collision_bits.TOOL, pos=middle, size=size, mass=0.03)
    if appearance:
        plastic = add_material(spec, "hoop", _HOOP_RGB, roughness=0.4)
        add_visual_geom(body, BOX, plastic, pos=middle, size=size)
        for begin, end in pairwise(rim):
            add_visual_geom(body, CAPSULE, plastic, fromto=[*begin, *end], size=[_HOOP_RADIUS_M, 0, 0])


SLEEVE = Tool(
    "sleeve",
    _build,
    grip_pos=(
        float(SLEEVE_CLOTH.initial_pos[list(ATTACHED_VERTICES), 0].min()) - _GRIP_ON_HANDLE_M,
        0.0,
        0.0,
    ),
    particles=None,
    cloth=SLEEVE_CLOTH,
    grip_tool_name=WASHCLOTH.name,
    mirror_axis=2,
)
