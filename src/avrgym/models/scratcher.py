"""The scratcher: a round rod with a blunt tip. The robot holds it lengthwise, like a pen."""

import mujoco
import numpy as np

from avrgym.models import collision_bits
from avrgym.models.geoms import CAPSULE, add_collision_geom, add_material, add_visual_mesh
from avrgym.models.shapes import CrossSection, make_loft
from avrgym.models.tools import Tool

FINGERTIPS_TO_TIP_DISTANCE_M = 0.05
"""Distance from the fingertips to the tip of the scratcher (paper's code)."""
ROD_RADIUS_M, ROD_LENGTH_M = 0.005, 0.12
FINGERTIPS_TO_GRIP_DISTANCE_M = 0.039
"""Distance from the end of the fingertips back to the contact point of fingers and rod."""


def _build_scratcher(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """Build one capsule; its round end is the tip.

    The capsule has no friction, because friction causes stick-slip vibration that interrupts the contact.
    """
    add_collision_geom(
        body,
        "scratcher",
        CAPSULE,
        collision_bits.TOOL,
        fromto=[-ROD_RADIUS_M, 0, 0, ROD_RADIUS_M - ROD_LENGTH_M, 0, 0],
        size=[ROD_RADIUS_M, 0, 0],
        mass=0.02,
        condim=1,
        priority=1,
    )
    if appearance:
        _add_skin(spec, body)


def _add_skin(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Add the appearance: a knob, a slimmer neck and a handle, all inside the capsule."""
    wood = add_material(spec, "scratcher_wood", (0.74, 0.53, 0.31), roughness=0.5)
    rubber = add_material(spec, "scratcher_grip", (0.13, 0.30, 0.38), roughness=0.85)
    along_x = [0.5**0.5, 0.0, 0.5**0.5, 0.0]
    knob = [(-ROD_RADIUS_M * (1.0 - np.cos(a)), ROD_RADIUS_M * np.sin(a)) for a in np.linspace(0.2, 2.4, 9)]
    neck = [(-0.0120, 0.0031), (-0.0200, 0.0033), (-0.0350, 0.0038), (-0.0360, 0.0038)]
    handle = [(-0.0340, 0.0039), (-0.0352, 0.0049), (-0.0365, 0.0050), (0.0040 - ROD_LENGTH_M, 0.0050),
              (0.0012 - ROD_LENGTH_M, 0.0042), (0.0002 - ROD_LENGTH_M, 0.0020)]  # fmt: skip
    for name, material, profile in (("head", wood, knob + neck), ("handle", rubber, handle)):
        mesh = make_loft([CrossSection(x, radius, radius) for x, radius in profile], segments=24)
        add_visual_mesh(spec, body, f"scratcher_{name}", material, mesh, quat=along_x)


SCRATCHER = Tool(
    "scratcher",
    _build_scratcher,
    grip_pos=(-(FINGERTIPS_TO_TIP_DISTANCE_M + FINGERTIPS_TO_GRIP_DISTANCE_M), 0.0, 0.0),
    particles=None,
)
