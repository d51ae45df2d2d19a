"""The scooper: a padded trough that lifts a forearm. Its handle has the thickness of the scratcher."""

import mujoco
import numpy as np

from avrgym.models import collision_bits
from avrgym.models.geoms import CAPSULE, add_collision_geom, add_material, add_visual_geom, add_visual_mesh
from avrgym.models.scratcher import ROD_RADIUS_M as HANDLE_RADIUS_M
from avrgym.models.scratcher import SCRATCHER
from avrgym.models.shapes import make_tube, round_polyline_corners
from avrgym.models.tools import Tool

PADDING_RADIUS_M, TROUGH_HALF_WIDTH_M, TROUGH_HALF_LENGTH_M, TROUGH_RIM_HEIGHT_M = 0.010, 0.060, 0.025, 0.050
"""Sizes of the trough. Along x it is 14 cm wide outside and 10 cm inside. Along y it is 7 cm long. Along z its rims are
5 cm above its floor."""
GRIP_X_M = -(TROUGH_HALF_WIDTH_M + 0.06)
"""x coordinate of the grip point in the scooper's frame, in metres."""
_HANDLE_END_M = GRIP_X_M - 0.03
_RIBS_Y_M = np.linspace(-TROUGH_HALF_LENGTH_M, TROUGH_HALF_LENGTH_M, 4)


def _build_scooper(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """Build two bars below the forearm, a rim on each side, and the handle. Contacts have no friction."""
    x, y, z = TROUGH_HALF_WIDTH_M, TROUGH_HALF_LENGTH_M, TROUGH_RIM_HEIGHT_M
    for name, ends, radius in (
        ("right_bar", [-x, -y, 0, x, -y, 0], PADDING_RADIUS_M),
        ("left_bar", [-x, y, 0, x, y, 0], PADDING_RADIUS_M),
        ("far_rim", [x, 0, 0, x, 0, z], PADDING_RADIUS_M),
        ("near_rim", [-x, 0, 0, -x, 0, z], PADDING_RADIUS_M),
        ("handle", [-x, 0, 0, _HANDLE_END_M, 0, 0], HANDLE_RADIUS_M),
    ):
        add_collision_geom(
            body, f"scooper_{name}", CAPSULE, collision_bits.TOOL,
            fromto=ends, size=[radius, 0, 0], mass=0.02, condim=1, priority=1,
        )  # fmt: skip
    if appearance:
        _add_skin(spec, body)


def _add_skin(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Add the appearance: ribs of foam across the trough, and the handle."""
    foam = add_material(spec, "scooper_foam", (0.20, 0.45, 0.60), roughness=0.9)
    plastic = add_material(spec, "scooper_handle", (0.85, 0.86, 0.84), roughness=0.5)
    x, z = TROUGH_HALF_WIDTH_M, TROUGH_RIM_HEIGHT_M
    for number, y in enumerate(_RIBS_Y_M):
        path = round_polyline_corners([[-x, y, z], [-x, y, 0.0], [x, y, 0.0], [x, y, z]])
        add_visual_mesh(spec, body, f"scooper_rib_{number}", foam, make_tube(path, PADDING_RADIUS_M))
    add_visual_geom(
        body, CAPSULE, plastic, fromto=[-x, 0, 0, _HANDLE_END_M, 0, 0], size=[HANDLE_RADIUS_M, 0, 0]
    )


SCOOPER = Tool(
    "scooper", _build_scooper, grip_pos=(GRIP_X_M, 0.0, 0.0), particles=None, grip_tool_name=SCRATCHER.name
)
