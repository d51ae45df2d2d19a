"""Mounts of arms next to a person: on furniture, or on a stand for arms that are too heavy for a wheelchair."""

from collections.abc import Mapping
from functools import partial

import mujoco
import numpy as np

from avrgym.models.collision_bits import COLLISION_GROUP
from avrgym.models.furniture import NIGHTSTAND_BODY, NIGHTSTAND_TOP_POS_M, add_bracket, add_nightstand
from avrgym.models.geoms import BOX, CAPSULE, CYLINDER, add_material, add_visual_geom
from avrgym.models.robot import BaseRange, Mount, PersonLocation

STAND_BODY = "stand"
STAND_HALF_WIDTH_M = 0.18
"""Half the width of the square foot of the stand, in metres."""
_COLUMN_RADIUS_M, _FOOT_HALF_HEIGHT_M, _PLATE_M = 0.06, 0.02, 0.02


def make_furniture_mounts(
    base_pos_w: tuple[float, float, float],
    max_shoulder_height_m: float,
    left_pos_w: tuple[float, float, float] | None = None,
) -> Mapping[PersonLocation, Mount]:
    """Returns mounts on a bracket of the wheelchair, and on a nightstand next to the bed.

    Args:
        base_pos_w: position of the arm's base on the wheelchair, world frame.
        max_shoulder_height_m: maximum height of the shoulder above the base.
        left_pos_w: position on the wheelchair's left side. ``None`` means the mirrored position of the right side.
    """
    yaw_rad = -0.5 * np.pi
    bracket = partial(add_bracket, mount_m=base_pos_w, max_shoulder_height_m=max_shoulder_height_m)
    return {
        "wheelchair": Mount(base_pos_w, yaw_rad, carrier_builder=bracket, left_pos_w=left_pos_w),
        "bed": Mount(
            NIGHTSTAND_TOP_POS_M,
            yaw_rad,
            BaseRange((-0.1, 0.1), (-0.1, 0.1), (0.0, 0.0)),
            carrier_builder=add_nightstand,
            carrier_body=NIGHTSTAND_BODY,
        ),
    }


def add_stand(spec: mujoco.MjSpec, base: str, height_m: float, *, appearance: bool) -> None:
    """Add the geoms of a stand to the body ``stand``. Move the body ``base`` of the arm to the top of the stand."""
    body = spec.body(STAND_BODY)
    spec.body(base).pos = [0.0, 0.0, height_m]
    foot = [STAND_HALF_WIDTH_M, STAND_HALF_WIDTH_M, _FOOT_HALF_HEIGHT_M]
    body.add_geom(type=BOX, size=foot, pos=[0, 0, _FOOT_HALF_HEIGHT_M], group=COLLISION_GROUP, mass=0.0)
    column = [0, 0, 0.1, 0, 0, height_m - _COLUMN_RADIUS_M - 0.01]
    body.add_geom(type=CAPSULE, size=[_COLUMN_RADIUS_M, 0, 0], fromto=column, group=COLLISION_GROUP, mass=0.0)
    if appearance:
        paint = add_material(spec, "stand", (0.30, 0.32, 0.35), metallic=0.5, roughness=0.4)
        add_visual_geom(body, BOX, paint, size=foot, pos=[0, 0, _FOOT_HALF_HEIGHT_M])
        top = height_m - _PLATE_M
        for radius, low, high in ((_COLUMN_RADIUS_M, 0.04, top), (0.09, top, height_m)):
            add_visual_geom(body, CYLINDER, paint, size=[radius, 0, 0], fromto=[0, 0, low, 0, 0, high])


def make_stand_mount(x_m: float, y_m: float) -> Mount:
    """Returns the mount of a stand on the person's right side, at the nominal position (x, y).

    At the start of each episode, a search near this position determines the pose of the stand.
    """
    return Mount((x_m, y_m, 0.0), 0.0, BaseRange((-0.2, 0.1), (-0.3, 0.5), (-0.5, 0.5)))
