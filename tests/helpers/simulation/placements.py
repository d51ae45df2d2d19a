"""Jaco on a mount that leaves too little room."""

from dataclasses import replace

import pytest

from avrgym.robots import registry
from avrgym.robots.jaco.robot import JACO
from avrgym.tasks import placement_check


def place(patch: pytest.MonkeyPatch, *offset_m: float) -> None:
    """Have Jaco's mount on the wheelchair moved by x, y, z."""
    mount = JACO.mounts["wheelchair"]
    x, y, z = (float(place + offset) for place, offset in zip(mount.pos_w, offset_m, strict=True))
    moved = replace(JACO, mounts={**JACO.mounts, "wheelchair": replace(mount, pos_w=(x, y, z))})
    patch.setitem(registry._robots, "Jaco", moved)
    placement_check.draws_by_body.cache_clear()
