"""The hospital bed with raised backrest, and the nightstand; in the world frame.

The person lies on their back, with the hips at (0, 0, 0.7) and the legs towards −y. Mattress 880 × 2000 × 150 mm, its
top at 0.55 m (makers' tables of adult hospital beds); backrest 60° above the horizontal (paper's code).
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.furniture.finishes import add_furniture_material
from avrgym.models.geoms import BOX, CAPSULE, CYLINDER, add_collision_geom, add_visual_geom, add_visual_mesh
from avrgym.models.shapes import CrossSection, Mesh, make_loft, make_torus, make_tube, round_polyline_corners

MATTRESS_TOP_HEIGHT_M = 0.55
MATTRESS_THICKNESS_M, MATTRESS_HALF_WIDTH_M = 0.15, 0.44
MATTRESS_LEG_SECTION_LENGTH_M, BACKREST_LENGTH_M = 1.15, 0.85
BACKREST_ANGLE_DEG = 60.0
NIGHTSTAND_BODY = "nightstand"
NIGHTSTAND_TOP_POS_M = (-0.75, 0.15, 0.60)
"""Position of a robot on the nightstand, and origin of the nightstand's body. The nightstand may move with the robot.
"""

_CREASE = (0.0, 0.05, MATTRESS_TOP_HEIGHT_M)
"""Edge between seat and backrest: 0.118 m behind the axis of a torso reclined by 30°."""
_HIPS = (0.0, 0.0, 0.7)
_LEGS_HALF = (MATTRESS_HALF_WIDTH_M, 0.5 * MATTRESS_LEG_SECTION_LENGTH_M, 0.5 * MATTRESS_THICKNESS_M)
_BACK_HALF = (MATTRESS_HALF_WIDTH_M, 0.5 * BACKREST_LENGTH_M, 0.5 * MATTRESS_THICKNESS_M)
_LEGS_CENTRE = (0.0, _CREASE[1] - _LEGS_HALF[1], MATTRESS_TOP_HEIGHT_M - _LEGS_HALF[2])
_FOOT_Y, _HEAD_Y = _CREASE[1] - MATTRESS_LEG_SECTION_LENGTH_M - 0.03, _CREASE[1] + BACKREST_LENGTH_M + 0.03
_MIDDLE_Y, _HALF_LENGTH = 0.5 * (_FOOT_Y + _HEAD_Y), 0.5 * (_HEAD_Y - _FOOT_Y)
_FOOTBOARD_TOP, _HEADBOARD_TOP, _BOARD_BOTTOM = 0.78, 1.02, 0.30
_HALF_BOARD = (0.46, 0.018)
_DECK_Z = MATTRESS_TOP_HEIGHT_M - MATTRESS_THICKNESS_M - 0.025
_CASTER_RADIUS, _CASTER_X, _CASTER_Y = 0.06, 0.36, 0.72
_UPRIGHT_Q = transforms.from_axis_angle([1.0, 0.0, 0.0], 0.5 * np.pi)
_NIGHTSTAND_HALF = (0.165, 0.20, 0.5 * NIGHTSTAND_TOP_POS_M[2])


def add_hospital_bed(
    spec: mujoco.MjSpec, appearance: bool, *, rise_m: float = 0.0, backrest_deg: float = BACKREST_ANGLE_DEG
) -> None:
    """Add the bed: a mattress in two parts, a frame on casters, end boards, and lowered side rails.

    ``rise_m`` is the height of the mattress above its default height, ``backrest_deg`` the angle of the backrest above
    the horizontal.
    """
    body = spec.worldbody.add_body(name="hospital_bed", pos=[0.0, 0.0, rise_m])
    back = _backrest(backrest_deg)
    _add_bed_collision(body, back)
    if appearance:
        _add_bedding(spec, body, back)
        _add_boards(spec, body)
        _add_bed_frame(spec, body, back)
        _add_side_rails(spec, body)
        _add_undercarriage(spec, body, rise_m)


_Pose = tuple[FloatArray, FloatArray]


def _backrest(backrest_deg: float) -> _Pose:
    """Returns the pose of the backrest's surface in the bed's frame: its lower end (3,) and its rotation (4,).

    The distance between the surface and the axis of the torso is the same at every angle.
    """
    usual, angle = (np.radians(degrees) for degrees in (BACKREST_ANGLE_DEG, backrest_deg))
    _, y, z = np.subtract(_HIPS, _CREASE)
    usual_m, at_m = (z * np.cos(each) - y * np.sin(each) for each in (usual, angle))
    end = np.array([0.0, _CREASE[1] + (usual_m - at_m) / np.sin(angle), _CREASE[2]])
    return end, transforms.from_axis_angle([1.0, 0.0, 0.0], angle)


def _on_backrest(back: _Pose, along: float, above: float) -> FloatArray:
    """Returns a point (3,) above the middle line of the backrest, in the bed's frame.

    ``along`` is the distance from its lower end, ``above`` the height above the surface.
    """
    return back[0] + transforms.rotate(back[1], [0.0, along, above])


def _add_bed_collision(body: mujoco.MjsBody, back: _Pose) -> None:
    boxes = {
        "mattress": (_LEGS_CENTRE, _LEGS_HALF),
        "deck": ([0, _MIDDLE_Y, _DECK_Z], [0.45, _HALF_LENGTH, 0.025]),
        "footboard": _board(_FOOT_Y, _FOOTBOARD_TOP),
        "headboard": _board(_HEAD_Y, _HEADBOARD_TOP),
    }
    for name, (pos, size) in boxes.items():
        add_collision_geom(body, f"bed_{name}", BOX, collision_bits.FURNITURE, pos=pos, size=size)
    middle = _on_backrest(back, 0.5 * BACKREST_LENGTH_M, -_BACK_HALF[2])
    add_collision_geom(
        body, "bed_backrest", BOX, collision_bits.FURNITURE, pos=middle, quat=back[1], size=_BACK_HALF
    )


def _board(y: float, top: float) -> tuple[list[float], list[float]]:
    """Returns the centre (3,) and the half sizes (3,) of the board at one end of the bed."""
    half_height = 0.5 * (top - _BOARD_BOTTOM)
    return [0.0, y, _BOARD_BOTTOM + half_height], [_HALF_BOARD[0], _HALF_BOARD[1], half_height]


def _add_bedding(spec: mujoco.MjSpec, body: mujoco.MjsBody, back: _Pose) -> None:
    sheet = add_furniture_material(spec, "sheet")
    linen = add_furniture_material(spec, "linen")
    add_visual_mesh(spec, body, "bed_mattress_skin", sheet, _cushion(*_LEGS_HALF), pos=_LEGS_CENTRE)
    middle = _on_backrest(back, 0.5 * BACKREST_LENGTH_M, -_BACK_HALF[2])
    add_visual_mesh(spec, body, "bed_backrest_skin", sheet, _cushion(*_BACK_HALF), pos=middle, quat=back[1])
    pillow = _on_backrest(back, 0.66, 0.005)
    add_visual_mesh(spec, body, "bed_pillow", linen, _pillow(), pos=pillow, quat=back[1])


def _cushion(half_x: float, half_y: float, half_z: float) -> Mesh:
    """Returns a box with rounded corners and edges; z is the direction of its thickness."""
    edge = 0.025
    turn = np.linspace(0.0, 0.5 * np.pi, 5)
    inset, height = edge * (1.0 - np.cos(turn)), half_z - edge + edge * np.sin(turn)
    rings = [*zip(-height[::-1], inset[::-1], strict=True), *zip(height, inset, strict=True)]
    return make_loft([CrossSection(z, half_x - d, half_y - d, exponent=12.0) for z, d in rings], segments=40)


def _pillow() -> Mesh:
    """Returns a pillow of 0.60 × 0.38 m, 7 cm thick in the middle."""
    turns = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 11)[1:-1]
    rings = [(0.035 * np.sin(turn), np.cos(turn) ** 0.35) for turn in turns]
    return make_loft([CrossSection(z, 0.30 * share, 0.19 * share, exponent=4.0) for z, share in rings])


def _add_boards(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    plastic = add_furniture_material(spec, "plastic")
    wood = add_furniture_material(spec, "wood")
    for name, y, top in (("footboard", _FOOT_Y, _FOOTBOARD_TOP), ("headboard", _HEAD_Y, _HEADBOARD_TOP)):
        pos, (half_x, half_y, half_z) = _board(y, top)
        panel = _panel(half_x, half_z, half_y)
        inlay = _panel(half_x - 0.09, half_z - 0.09, half_y + 0.002)
        add_visual_mesh(spec, body, f"bed_{name}_skin", plastic, panel, pos=pos, quat=_UPRIGHT_Q)
        add_visual_mesh(spec, body, f"bed_{name}_inlay", wood, inlay, pos=pos, quat=_UPRIGHT_Q)


def _panel(half_x: float, half_y: float, half_z: float) -> Mesh:
    """Returns a flat board with rounded corners; z is the direction of its thickness."""
    return make_loft([CrossSection(z, half_x, half_y, exponent=8.0) for z in (-half_z, half_z)], segments=48)


def _add_bed_frame(spec: mujoco.MjSpec, body: mujoco.MjsBody, back: _Pose) -> None:
    paint = add_furniture_material(spec, "bed_frame")
    steel = add_furniture_material(spec, "steel")
    for sign in (-1.0, 1.0):
        pos = [sign * 0.425, _MIDDLE_Y, _DECK_Z - 0.005]
        add_visual_geom(body, BOX, paint, pos=pos, size=[0.02, _HALF_LENGTH, 0.025])
    for y in (-0.9, -0.45, 0.0, 0.45, 0.85):
        add_visual_geom(body, BOX, paint, pos=[0, y, _DECK_Z - 0.005], size=[0.41, 0.02, 0.015])
    legs = [0, _LEGS_CENTRE[1], _DECK_Z + 0.018]
    add_visual_geom(body, BOX, paint, pos=legs, size=[0.43, _LEGS_HALF[1], 0.008])
    middle = _on_backrest(back, 0.5 * BACKREST_LENGTH_M, -MATTRESS_THICKNESS_M - 0.012)
    add_visual_geom(body, BOX, paint, pos=middle, quat=back[1], size=[0.43, _BACK_HALF[1] - 0.02, 0.012])
    strut = [0.0, 0.80, _DECK_Z, *_on_backrest(back, 0.50, -MATTRESS_THICKNESS_M - 0.02)]
    add_visual_geom(body, CAPSULE, steel, fromto=strut, size=[0.018, 0, 0])


def _add_side_rails(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Add one rail on each side, below the top of the mattress. A robot can reach over the rails."""
    steel = add_furniture_material(spec, "steel")
    low, high, foot, head = 0.30, 0.50, -0.55, 0.30
    for side, sign in (("right", -1.0), ("left", 1.0)):
        x = sign * 0.456
        loop = [[x, 0.5 * (foot + head), low], [x, foot, low], [x, foot, high], [x, head, high], [x, head, low],
                [x, 0.5 * (foot + head), low]]  # fmt: skip
        add_visual_mesh(spec, body, f"bed_{side}_rail", steel, make_tube(round_polyline_corners(loop), 0.011))
        for y in np.linspace(foot, head, 7)[1:-1]:
            add_visual_geom(body, CAPSULE, steel, fromto=[x, y, low, x, y, high], size=[0.007, 0, 0])


def _add_undercarriage(spec: mujoco.MjSpec, body: mujoco.MjsBody, rise_m: float) -> None:
    paint = add_furniture_material(spec, "bed_frame")
    steel = add_furniture_material(spec, "steel")
    rubber = add_furniture_material(spec, "rubber")
    low = 2.0 * _CASTER_RADIUS + 0.06 - rise_m
    for y in (-0.45, 0.45):
        column = [0.0, _MIDDLE_Y + y, low, 0.0, _MIDDLE_Y + y, _DECK_Z]
        add_visual_geom(body, CYLINDER, steel, fromto=column, size=[0.045, 0, 0])
        add_visual_geom(body, BOX, paint, pos=[0, _MIDDLE_Y + y, low], size=[_CASTER_X, 0.03, 0.02])
    for side, sign in (("right", -1.0), ("left", 1.0)):
        x = sign * _CASTER_X
        add_visual_geom(body, BOX, paint, pos=[x, _MIDDLE_Y, low], size=[0.025, _CASTER_Y + 0.04, 0.025])
        for end, y in (("foot", _MIDDLE_Y - _CASTER_Y), ("head", _MIDDLE_Y + _CASTER_Y)):
            _add_caster(spec, body, f"bed_{side}_{end}_caster", (x, y, low), rise_m, rubber, steel)


def _add_caster(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    top: Sequence[float],
    rise_m: float,
    tyre: str,
    metal: str,
) -> None:
    x, y, z = top
    centre = [x, y, _CASTER_RADIUS - rise_m]
    add_visual_mesh(spec, body, name, tyre, make_torus(_CASTER_RADIUS - 0.014, 0.014, 24, 8), pos=centre)
    wheel = [x - 0.008, *centre[1:], x + 0.008, *centre[1:]]
    add_visual_geom(body, CYLINDER, metal, fromto=wheel, size=[_CASTER_RADIUS - 0.02, 0, 0])
    for side in (-0.02, 0.02):
        add_visual_geom(body, BOX, metal, pos=[x + side, y, 0.5 * (z + centre[2])], size=[0.004, 0.016, 0.06])


def add_nightstand(spec: mujoco.MjSpec, appearance: bool, *, mirrored: bool = False) -> None:
    """Add the nightstand. The origin of its body is the middle of its top. ``mirrored``: on the person's left."""
    x, y, z = NIGHTSTAND_TOP_POS_M
    body = spec.worldbody.add_body(name=NIGHTSTAND_BODY, pos=[-x if mirrored else x, y, z])
    half_x, half_y, half_z = _NIGHTSTAND_HALF
    add_collision_geom(
        body,
        NIGHTSTAND_BODY,
        BOX,
        collision_bits.FURNITURE,
        pos=[0, 0, -half_z],
        size=[half_x, half_y, half_z],
    )
    if appearance:
        _add_nightstand_skin(spec, body)


def _add_nightstand_skin(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Add a cabinet on a plinth. Its three drawers open towards −y."""
    plastic = add_furniture_material(spec, "plastic")
    wood = add_furniture_material(spec, "wood")
    steel = add_furniture_material(spec, "steel")
    half_x, half_y, half_z = _NIGHTSTAND_HALF
    add_visual_geom(body, BOX, plastic, pos=[0, 0, -0.0125], size=[half_x, half_y, 0.0125])
    add_visual_geom(
        body, BOX, plastic, pos=[0, 0, -half_z - 0.01], size=[half_x - 0.01, half_y - 0.015, half_z - 0.05]
    )
    add_visual_geom(
        body, BOX, steel, pos=[0, 0, -2.0 * half_z + 0.025], size=[half_x - 0.03, half_y - 0.035, 0.025]
    )
    for z in (-0.12, -0.29, -0.46):
        add_visual_geom(body, BOX, wood, pos=[0, -half_y + 0.012, z], size=[half_x - 0.02, 0.008, 0.078])
        handle = [-0.05, -half_y - 0.004, z + 0.03, 0.05, -half_y - 0.004, z + 0.03]
        add_visual_geom(body, CAPSULE, steel, fromto=handle, size=[0.006, 0, 0])
