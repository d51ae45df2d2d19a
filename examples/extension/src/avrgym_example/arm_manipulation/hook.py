"""A hook that carries a forearm: a padded bar across, a stop at each end of it, a thin handle."""

import mujoco

from avrgym.models import collision_bits
from avrgym.models.geoms import CAPSULE, add_collision, add_material, add_visual
from avrgym.models.tools import Tool

RADIUS_M, HALF_WIDTH_M, STOP_M = 0.010, 0.060, 0.050
HANDLE_RADIUS_M = 0.005
GRIP_M = -(HALF_WIDTH_M + 0.06)
"""Where the hand holds the handle, as it does a scratcher's."""


def build(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """Four capsules in the x-z plane; the arm glides on them without friction."""
    foam = add_material(spec, "hook_foam", (0.20, 0.45, 0.60), roughness=0.9)
    near, far = -HALF_WIDTH_M, HALF_WIDTH_M
    for name, ends, radius in (
        ("bar", [near, 0, 0, far, 0, 0], RADIUS_M),
        ("far_stop", [far, 0, 0, far, 0, STOP_M], RADIUS_M),
        ("near_stop", [near, 0, 0, near, 0, STOP_M], RADIUS_M),
        ("handle", [near, 0, 0, GRIP_M - 0.03, 0, 0], HANDLE_RADIUS_M),
    ):
        size = [radius, 0, 0]
        add_collision(
            body,
            f"hook_{name}",
            CAPSULE,
            collision_bits.TOOL,
            fromto=ends,
            size=size,
            mass=0.02,
            condim=1,
            priority=1,
        )
        if appearance:
            add_visual(body, CAPSULE, foam, fromto=ends, size=size)


HOOK = Tool("hook", build, grip_pos=(GRIP_M, 0.0, 0.0), particles=None)
