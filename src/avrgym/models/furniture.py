"""Wheelchair, table and bowl, in the world's frame: the person sits at the origin and faces −y.

Wheelchair: seat height 485 mm, armrests 760 mm, push handles 915 mm, overall width 660 mm, length 1065 mm,
seat 460 × 410 mm (accessibility tables for adult manual wheelchairs).
"""

from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from avrgym.models import contacts
from avrgym.models.parts import BOX, CAPSULE, CYLINDER, add_collision, add_material, add_skin, add_visual
from avrgym.models.shapes import revolve, torus, tube

SEAT_HEIGHT_M = 0.485
TABLE_HEIGHT_M = 0.75
BOWL_START_M = (-0.15, -0.55, TABLE_HEIGHT_M)
BOWL_BODY = "bowl"
TABLE_BODY = "table"

_BACK_Y, _FRONT_Y = 0.165, -0.245
_HALF_SEAT = 0.23
_WHEEL_RADIUS, _WHEEL_X, _AXLE_Y = 0.305, 0.305, 0.10
_CASTER_RADIUS, _CASTER_Y = 0.09, -0.32
_FRAME_X = 0.245
JACO_MOUNT_M = (-0.35, -0.30, 0.36)


def add_wheelchair(spec: mujoco.MjSpec, appearance: bool) -> None:
    """Add the wheelchair; the hips of a seated person rest on its cushion."""
    body = spec.worldbody.add_body(name="wheelchair")
    _add_wheelchair_collision(body)
    if appearance:
        _add_upholstery(spec, body)
        _add_frame(spec, body)
        _add_wheels(spec, body)


def _add_wheelchair_collision(body: mujoco.MjsBody) -> None:
    back_half = 0.5 * (0.90 - SEAT_HEIGHT_M)
    boxes = {
        "seat": ([0, 0.5 * (_BACK_Y + _FRONT_Y), SEAT_HEIGHT_M - 0.03], [_HALF_SEAT, 0.205, 0.03]),
        "backrest": ([0, _BACK_Y + 0.02, SEAT_HEIGHT_M + back_half], [0.215, 0.02, back_half]),
    }
    for side, sign in (("right", -1), ("left", 1)):
        boxes[f"{side}_armrest"] = ([sign * 0.265, -0.03, 0.745], [0.03, 0.16, 0.015])
        boxes[f"{side}_wheel"] = ([sign * _WHEEL_X, _AXLE_Y, _WHEEL_RADIUS], [0.02, 0.28, 0.28])
    for name, (pos, size) in boxes.items():
        add_collision(body, f"wheelchair_{name}", BOX, contacts.FURNITURE, pos=pos, size=size)


def _add_upholstery(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    fabric = add_material(spec, "fabric", (0.10, 0.12, 0.15), roughness=0.95)
    rubber = add_material(spec, "rubber", (0.07, 0.07, 0.075), roughness=0.9)
    seat_y = 0.5 * (_BACK_Y + _FRONT_Y)
    add_visual(body, BOX, fabric, pos=[0, seat_y, SEAT_HEIGHT_M - 0.035], size=[_HALF_SEAT, 0.205, 0.030])
    add_visual(body, BOX, fabric, pos=[0, _BACK_Y + 0.012, 0.70], size=[0.215, 0.012, 0.185])
    for sign in (-1, 1):
        add_visual(body, BOX, rubber, pos=[sign * 0.265, -0.03, 0.748], size=[0.028, 0.15, 0.012])
        handle = [sign * 0.222, 0.21, 0.915, sign * 0.222, 0.31, 0.905]
        add_visual(body, CAPSULE, rubber, fromto=handle, size=[0.016, 0, 0])
        add_visual(body, BOX, rubber, pos=[sign * 0.10, -0.50, 0.095], size=[0.075, 0.115, 0.008])


def _add_frame(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    paint = add_material(spec, "frame", (0.42, 0.10, 0.12), metallic=0.4, roughness=0.35)
    steel = add_material(spec, "steel", (0.80, 0.81, 0.83), metallic=0.4, roughness=0.3)
    for side, sign in (("right", -1.0), ("left", 1.0)):
        x = sign * _FRAME_X
        bars = {
            "back": [[x, _BACK_Y, 0.20], [x, _BACK_Y, 0.60], [x, _BACK_Y + 0.01, 0.86],
                     [sign * 0.222, 0.20, 0.912]],
            "seat": [[x, _BACK_Y, 0.44], [x, -0.10, 0.44], [x, _FRONT_Y - 0.03, 0.435], [x, -0.36, 0.40]],
            "shin": [[x, -0.36, 0.40], [sign * 0.22, -0.40, 0.28], [sign * 0.18, -0.46, 0.11],
                     [sign * 0.10, -0.47, 0.09]],
            "base": [[x, _BACK_Y, 0.22], [x, -0.05, 0.22], [x, _CASTER_Y, 0.22]],
            "front": [[x, _CASTER_Y, 0.44], [x, _CASTER_Y, 0.30], [x, _CASTER_Y, 0.19]],
            "arm": [[sign * 0.265, 0.11, 0.44], [sign * 0.265, 0.11, 0.73], [sign * 0.265, -0.17, 0.73],
                    [sign * 0.265, -0.17, 0.44]],
        }  # fmt: skip
        for name, points in bars.items():
            add_skin(spec, body, f"wheelchair_{side}_{name}", paint, tube(_rounded(points), 0.0125))
        add_visual(body, BOX, paint, pos=[sign * 0.262, -0.03, 0.60], size=[0.004, 0.12, 0.10])
    for sign in (-1.0, 1.0):
        brace = [sign * _FRAME_X, -0.05, 0.22, -sign * _FRAME_X, -0.05, 0.42]
        add_visual(body, CAPSULE, steel, fromto=brace, size=[0.010, 0, 0])


def _add_wheels(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    rubber = add_material(spec, "rubber", (0.07, 0.07, 0.075), roughness=0.9)
    steel = add_material(spec, "steel", (0.80, 0.81, 0.83), metallic=0.4, roughness=0.3)
    for side, sign in (("right", -1.0), ("left", 1.0)):
        hub = [sign * _WHEEL_X, _AXLE_Y, _WHEEL_RADIUS]
        tyre = torus(_WHEEL_RADIUS - 0.014, 0.014)
        add_skin(spec, body, f"wheelchair_{side}_tyre", rubber, tyre, pos=hub)
        rim = [hub[0] + sign * 0.018, hub[1], hub[2]]
        add_skin(spec, body, f"wheelchair_{side}_rim", steel, torus(0.262, 0.006), pos=rim)
        axle = [*hub, sign * 0.22, _AXLE_Y, _WHEEL_RADIUS]
        add_visual(body, CAPSULE, steel, fromto=axle, size=[0.018, 0, 0])
        for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
            end = [hub[0], hub[1] + 0.28 * np.cos(angle), hub[2] + 0.28 * np.sin(angle)]
            add_visual(body, CAPSULE, steel, fromto=[*hub, *end], size=[0.0022, 0, 0])
        caster = [sign * 0.245, _CASTER_Y - 0.03, _CASTER_RADIUS]
        add_skin(spec, body, f"wheelchair_{side}_caster", rubber, torus(0.075, 0.016), pos=caster)
        side_of_caster = [caster[0] - 0.008, *caster[1:], caster[0] + 0.008, *caster[1:]]
        add_visual(body, CYLINDER, steel, fromto=side_of_caster, size=[0.062, 0, 0])


def add_jaco_bracket(spec: mujoco.MjSpec, appearance: bool) -> None:
    """The bracket on the wheelchair's right side that carries the Jaco."""
    if not appearance:
        return
    paint = add_material(spec, "bracket", (0.25, 0.26, 0.28), metallic=0.5, roughness=0.4)
    x, y, z = JACO_MOUNT_M
    body = spec.body("wheelchair")
    add_visual(body, CYLINDER, paint, fromto=[x, y, z - 0.02, x, y, z], size=[0.055, 0, 0])
    arm = [[x, y, z - 0.015], [x + 0.03, y, z - 0.02], [-_FRAME_X, y, z - 0.02]]
    add_skin(spec, body, "jaco_bracket", paint, tube(np.array(arm), 0.016))


def add_table(spec: mujoco.MjSpec, appearance: bool) -> None:
    """A table in front of the person's left, with a bowl whose body carries its place."""
    centre, half = np.array([0.35, -0.90]), np.array([0.65, 0.42])
    table = spec.worldbody.add_body(name=TABLE_BODY)
    top = [*centre, TABLE_HEIGHT_M - 0.015]
    add_collision(table, TABLE_BODY, BOX, contacts.FURNITURE, pos=top, size=[*half, 0.015])
    bowl = spec.worldbody.add_body(name=BOWL_BODY, pos=BOWL_START_M)
    add_collision(bowl, BOWL_BODY, CYLINDER, contacts.FURNITURE, pos=[0, 0, 0.025], size=[0.07, 0.025, 0])
    if appearance:
        _add_table_skin(spec, table, bowl, centre, half)


def _add_table_skin(
    spec: mujoco.MjSpec, table: mujoco.MjsBody, bowl: mujoco.MjsBody, centre: np.ndarray, half: np.ndarray
) -> None:
    wood = add_material(spec, "wood", (0.66, 0.50, 0.34), roughness=0.6)
    white = add_material(spec, "ceramic", (0.93, 0.93, 0.90), roughness=0.3)
    food = add_material(spec, "porridge", (0.82, 0.56, 0.28), roughness=0.8)
    add_visual(table, BOX, wood, pos=[*centre, TABLE_HEIGHT_M - 0.015], size=[*half, 0.015])
    for corner in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        leg = centre + np.array(corner) * (half - 0.06)
        add_visual(table, BOX, wood, pos=[*leg, 0.36], size=[0.025, 0.025, 0.36])
    profile = [
        (0.0, 0.0), (0.035, 0.0), (0.055, 0.012), (0.068, 0.032), (0.072, 0.05),
        (0.069, 0.05), (0.064, 0.034), (0.051, 0.016), (0.030, 0.007), (0.0, 0.007),
    ]  # fmt: skip
    add_skin(spec, bowl, "bowl_skin", white, revolve(profile))
    add_visual(bowl, CYLINDER, food, pos=[0, 0, 0.022], size=[0.058, 0.006, 0])


def _rounded(points: list[list[float]], per_corner: int = 6) -> np.ndarray:
    """A polyline with its inner corners replaced by quadratic arcs."""
    p = np.asarray(points, float)
    pieces = [p[:1]]
    for before, corner, after in zip(p[:-2], p[1:-1], p[2:], strict=True):
        reach = 0.35 * min(np.linalg.norm(corner - before), np.linalg.norm(after - corner))
        start = corner + reach * (before - corner) / np.linalg.norm(before - corner)
        end = corner + reach * (after - corner) / np.linalg.norm(after - corner)
        t = np.linspace(0.0, 1.0, per_corner)[:, None]
        pieces.append((1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * end)
    return np.concatenate([*pieces, p[-1:]])


FURNITURE: Mapping[str, Callable[[mujoco.MjSpec, bool], None]] = {
    "wheelchair": add_wheelchair,
    "table": add_table,
    "jaco_bracket": add_jaco_bracket,
}
