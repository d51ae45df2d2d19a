"""The remote control that is handed over: one capsule, held by its end with the grip of the scratcher."""

import mujoco

from avrgym.models import collision_bits
from avrgym.models.geoms import CAPSULE, add_collision_geom, add_material, add_visual_geom
from avrgym.models.tools import Tool

RADIUS_M, LENGTH_M = 0.006, 0.14
GRIP_M = -0.10
"""Where the hand holds it, from the end that the person takes."""


def build(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """The collision geom, and a visible one of the same shape."""
    black = add_material(spec, "remote_black", (0.08, 0.08, 0.10), roughness=0.5)
    shape = {"fromto": [-RADIUS_M, 0, 0, RADIUS_M - LENGTH_M, 0, 0], "size": [RADIUS_M, 0, 0]}
    add_collision_geom(body, "remote", CAPSULE, collision_bits.TOOL, mass=0.05, condim=1, priority=1, **shape)
    if appearance:
        add_visual_geom(body, CAPSULE, black, **shape)


REMOTE = Tool("remote", build, grip_pos=(GRIP_M, 0.0, 0.0), particles=None, grip_tool_name="scratcher")
