"""Moves the wheelchair mount of the Jaco."""

from dataclasses import replace

import pytest

from avrgym.robots import registry
from avrgym.robots.jaco.robot import JACO
from avrgym.tasks import placement_check


def offset_mount(patch: pytest.MonkeyPatch, *offset_m: float) -> None:
    """Move the Jaco's wheelchair mount by (x, y, z), m."""
    mount = JACO.mounts["wheelchair"]
    x, y, z = (float(pos + offset) for pos, offset in zip(mount.pos_w, offset_m, strict=True))
    changed = replace(JACO, mounts={**JACO.mounts, "wheelchair": replace(mount, pos_w=(x, y, z))})
    patch.setitem(registry._robots, "Jaco", changed)
    placement_check.count_samples_by_body.cache_clear()
