"""The wheelchair, in the world frame. The person sits at the origin and faces −y.

Sizes are from accessibility tables of adult manual wheelchairs. Heights: seat 485 mm, armrests 760 mm, push handles
915 mm (middle of the grip). Seat: 460 × 410 mm. The wheelchair is 658 mm wide (tables: 660 mm) and 1020 mm long
(tables: 1065 mm, with longer footrests).
"""

from collections.abc import Collection

import mujoco
import numpy as np

from avrgym.models import collision_bits
from avrgym.models.furniture.finishes import add_furniture_material
from avrgym.models.geoms import BOX, CAPSULE, CYLINDER, add_collision_geom, add_visual_geom, add_visual_mesh
from avrgym.models.shapes import make_torus, make_tube, round_polyline_corners

WHEELCHAIR_BODY = "wheelchair"
SEAT_HEIGHT_M, SEAT_DEPTH_M = 0.485, 0.41

_BACK_Y = 0.165
_FRONT_Y = _BACK_Y - SEAT_DEPTH_M
_HALF_SEAT = 0.23
_WHEEL_RADIUS, _WHEEL_X, _AXLE_Y = 0.305, 0.305, 0.10
_CASTER_RADIUS, _CASTER_Y = 0.09, -0.32
_FRAME_X = 0.245
ARMREST_X_M, ARMREST_HALF_WIDTH_M, ARMREST_FRONT_Y_M, ARMREST_TOP_HEIGHT_M = 0.265, 0.03, -0.19, 0.76
_SIGNS = {"right": -1.0, "left": 1.0}
_OTHER_SIDE = {"right": "left", "left": "right"}


def add_wheelchair(
    spec: mujoco.MjSpec,
    appearance: bool,
    *,
    armrests: Collection[str] = ("right", "left"),
    mirrored: bool = False,
    rise_m: float = 0.0,
) -> None:
    """Add the wheelchair. The hips of a seated person are on its cushion.

    ``armrests`` are the sides with an armrest. If ``mirrored`` is true, the armrests are on the opposite sides.
    ``rise_m`` is the height of seat, armrests and footplates above their default height.
    """
    if mirrored:
        armrests = [_OTHER_SIDE[side] for side in armrests]
    body = spec.worldbody.add_body(name=WHEELCHAIR_BODY)
    _add_wheelchair_collision(body, armrests, rise_m)
    if appearance:
        _add_upholstery(spec, body, rise_m)
        _add_frame(spec, body, rise_m)
        _add_wheels(spec, body)
        for side in armrests:
            _add_armrest(spec, body, side, rise_m)


def _add_wheelchair_collision(body: mujoco.MjsBody, armrests: Collection[str], rise_m: float) -> None:
    back_half = 0.5 * (0.90 - SEAT_HEIGHT_M)
    boxes = {
        "seat": ([0, 0.5 * (_BACK_Y + _FRONT_Y), SEAT_HEIGHT_M - 0.03 + rise_m], [_HALF_SEAT, 0.205, 0.03]),
        "backrest": ([0, _BACK_Y + 0.02, SEAT_HEIGHT_M + back_half + rise_m], [0.215, 0.02, back_half]),
    }
    for side, sign in _SIGNS.items():
        if side in armrests:
            boxes[f"{side}_armrest"] = (
                [sign * ARMREST_X_M, -0.03, ARMREST_TOP_HEIGHT_M - 0.015 + rise_m],
                [ARMREST_HALF_WIDTH_M, 0.16, 0.015],
            )
        boxes[f"{side}_wheel"] = ([sign * _WHEEL_X, _AXLE_Y, _WHEEL_RADIUS], [0.02, 0.28, 0.28])
    for name, (pos, size) in boxes.items():
        add_collision_geom(body, f"wheelchair_{name}", BOX, collision_bits.FURNITURE, pos=pos, size=size)


def _add_upholstery(spec: mujoco.MjSpec, body: mujoco.MjsBody, rise_m: float) -> None:
    fabric = add_furniture_material(spec, "fabric")
    rubber = add_furniture_material(spec, "rubber")
    seat_y, seat_z = 0.5 * (_BACK_Y + _FRONT_Y), SEAT_HEIGHT_M - 0.035 + rise_m
    add_visual_geom(body, BOX, fabric, pos=[0, seat_y, seat_z], size=[_HALF_SEAT, 0.205, 0.030])
    add_visual_geom(body, BOX, fabric, pos=[0, _BACK_Y + 0.012, 0.70 + rise_m], size=[0.215, 0.012, 0.185])
    for sign in (-1, 1):
        handle = [sign * 0.222, 0.21, 0.915 + rise_m, sign * 0.222, 0.31, 0.905 + rise_m]
        add_visual_geom(body, CAPSULE, rubber, fromto=handle, size=[0.016, 0, 0])
        add_visual_geom(
            body, BOX, rubber, pos=[sign * 0.10, -0.50, 0.095 + rise_m], size=[0.075, 0.115, 0.008]
        )


def _add_frame(spec: mujoco.MjSpec, body: mujoco.MjsBody, rise_m: float) -> None:
    paint = add_furniture_material(spec, "frame")
    steel = add_furniture_material(spec, "steel")
    for side, sign in _SIGNS.items():
        x = sign * _FRAME_X
        bars = {
            "back": [[x, _BACK_Y, 0.20], [x, _BACK_Y, 0.60], [x, _BACK_Y + 0.01, 0.86],
                     [sign * 0.222, 0.20, 0.912]],
            "seat": [[x, _BACK_Y, 0.44], [x, -0.10, 0.44], [x, _FRONT_Y - 0.03, 0.435], [x, -0.36, 0.40]],
            "shin": [[x, -0.36, 0.40], [sign * 0.22, -0.40, 0.28], [sign * 0.18, -0.46, 0.11],
                     [sign * 0.10, -0.47, 0.09]],
            "base": [[x, _BACK_Y, 0.22], [x, -0.05, 0.22], [x, _CASTER_Y, 0.22]],
            "front": [[x, _CASTER_Y, 0.44], [x, _CASTER_Y, 0.30], [x, _CASTER_Y, 0.19]],
        }  # fmt: skip
        for name in ("back", "seat", "shin"):
            bars[name] = [[x, y, z + rise_m] for x, y, z in bars[name]]
        bars["front"][0][2] += rise_m
        for name, points in bars.items():
            add_visual_mesh(
                spec,
                body,
                f"wheelchair_{side}_{name}",
                paint,
                make_tube(round_polyline_corners(points), 0.0125),
            )
    for sign in (-1.0, 1.0):
        brace = [sign * _FRAME_X, -0.05, 0.22, -sign * _FRAME_X, -0.05, 0.42 + rise_m]
        add_visual_geom(body, CAPSULE, steel, fromto=brace, size=[0.010, 0, 0])


def _add_armrest(spec: mujoco.MjSpec, body: mujoco.MjsBody, side: str, rise_m: float) -> None:
    rubber = add_furniture_material(spec, "rubber")
    paint = add_furniture_material(spec, "frame")
    x = _SIGNS[side] * ARMREST_X_M
    low, high = 0.44 + rise_m, 0.73 + rise_m
    bar = [[x, 0.11, low], [x, 0.11, high], [x, -0.17, high], [x, -0.17, low]]
    add_visual_mesh(
        spec, body, f"wheelchair_{side}_arm", paint, make_tube(round_polyline_corners(bar), 0.0125)
    )
    guard = [_SIGNS[side] * (ARMREST_X_M - 0.003), -0.03, 0.60 + rise_m]
    add_visual_geom(body, BOX, paint, pos=guard, size=[0.004, 0.12, 0.10])
    add_visual_geom(body, BOX, rubber, pos=[x, -0.03, 0.748 + rise_m], size=[0.028, 0.15, 0.012])


def _add_wheels(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    rubber = add_furniture_material(spec, "rubber")
    steel = add_furniture_material(spec, "steel")
    for side, sign in _SIGNS.items():
        hub = [sign * _WHEEL_X, _AXLE_Y, _WHEEL_RADIUS]
        tyre = make_torus(_WHEEL_RADIUS - 0.014, 0.014)
        add_visual_mesh(spec, body, f"wheelchair_{side}_tyre", rubber, tyre, pos=hub)
        rim = [hub[0] + sign * 0.018, hub[1], hub[2]]
        add_visual_mesh(spec, body, f"wheelchair_{side}_rim", steel, make_torus(0.262, 0.006), pos=rim)
        axle = [*hub, sign * 0.22, _AXLE_Y, _WHEEL_RADIUS]
        add_visual_geom(body, CAPSULE, steel, fromto=axle, size=[0.018, 0, 0])
        for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
            end = [hub[0], hub[1] + 0.28 * np.cos(angle), hub[2] + 0.28 * np.sin(angle)]
            add_visual_geom(body, CAPSULE, steel, fromto=[*hub, *end], size=[0.0022, 0, 0])
        caster = [sign * 0.245, _CASTER_Y - 0.03, _CASTER_RADIUS]
        add_visual_mesh(spec, body, f"wheelchair_{side}_caster", rubber, make_torus(0.075, 0.016), pos=caster)
        side_of_caster = [caster[0] - 0.008, *caster[1:], caster[0] + 0.008, *caster[1:]]
        add_visual_geom(body, CYLINDER, steel, fromto=side_of_caster, size=[0.062, 0, 0])


def add_bracket(
    spec: mujoco.MjSpec,
    appearance: bool,
    *,
    mount_m: tuple[float, float, float],
    max_shoulder_height_m: float,
    mirrored: bool = False,
) -> None:
    """Add a bracket for a robot's arm on the wheelchair's right side, and reserve the space of the robot's shoulder.

    Args:
        spec: a scene with a wheelchair.
        appearance: whether to add visual geoms.
        mount_m: position of the robot's base, world frame.
        max_shoulder_height_m: maximum height of the robot's shoulder above the base. People's initial poses avoid the
            space up to this height.
        mirrored: whether the bracket is on the left side instead.
    """
    x, y, z = mount_m
    outwards = -1.0
    if mirrored:
        x, outwards = -x, 1.0
    body = spec.body(WHEELCHAIR_BODY)
    half_height = 0.5 * max_shoulder_height_m
    room = [x, y, z + half_height]
    add_collision_geom(
        body, "shoulder_room", BOX, collision_bits.NO_COLLISION, pos=room, size=[0.05, 0.05, half_height]
    )
    if not appearance:
        return
    paint = add_furniture_material(spec, "bracket")
    add_visual_geom(body, CYLINDER, paint, fromto=[x, y, z - 0.02, x, y, z], size=[0.055, 0, 0])
    arm = [[x, y, z - 0.015], [x - 0.03 * outwards, y, z - 0.02], [outwards * _FRAME_X, y, z - 0.02]]
    add_visual_mesh(spec, body, "bracket", paint, make_tube(np.array(arm), 0.016))
