"""A table with a bowl, in the world frame. The person sits at the origin and faces −y."""

import mujoco
import numpy as np

from avrgym.models import collision_bits
from avrgym.models.furniture.finishes import add_furniture_material
from avrgym.models.geoms import BOX, CYLINDER, add_collision_geom, add_visual_geom, add_visual_mesh
from avrgym.models.shapes import revolve

TABLE_BODY = "table"
TABLE_HEIGHT_M = 0.75
BOWL_BODY = "bowl"
BOWL_INITIAL_POS_M = (-0.15, -0.55, TABLE_HEIGHT_M)


PositionOffset = tuple[float, float, float]


def add_table(spec: mujoco.MjSpec, appearance: bool, offset_m: PositionOffset = (0.0, 0.0, 0.0)) -> None:
    """Add a table with a bowl, in front of the person and on their left.

    The position of the bowl's body differs between episodes.

    ``offset_m`` moves table and bowl. The table's legs always end on the floor.
    """
    centre, half = np.array([0.35, -0.90]), np.array([0.65, 0.42])
    table = spec.worldbody.add_body(name=TABLE_BODY, pos=offset_m)
    top = [*centre, TABLE_HEIGHT_M - 0.015]
    add_collision_geom(table, TABLE_BODY, BOX, collision_bits.FURNITURE, pos=top, size=[*half, 0.015])
    bowl = spec.worldbody.add_body(name=BOWL_BODY, pos=np.add(BOWL_INITIAL_POS_M, offset_m))
    add_collision_geom(
        bowl, BOWL_BODY, CYLINDER, collision_bits.FURNITURE, pos=[0, 0, 0.025], size=[0.07, 0.025, 0]
    )
    if appearance:
        _add_table_skin(spec, table, bowl, centre, half, offset_m[2])


def _add_table_skin(
    spec: mujoco.MjSpec,
    table: mujoco.MjsBody,
    bowl: mujoco.MjsBody,
    centre: np.ndarray,
    half: np.ndarray,
    height_offset_m: float,
) -> None:
    wood = add_furniture_material(spec, "wood")
    white = add_furniture_material(spec, "ceramic")
    food = add_furniture_material(spec, "porridge")
    add_visual_geom(table, BOX, wood, pos=[*centre, TABLE_HEIGHT_M - 0.015], size=[*half, 0.015])
    for corner in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        leg = centre + np.array(corner) * (half - 0.06)
        add_visual_geom(
            table,
            BOX,
            wood,
            pos=[*leg, 0.36 - 0.5 * height_offset_m],
            size=[0.025, 0.025, 0.36 + 0.5 * height_offset_m],
        )
    profile = [
        (0.0, 0.0), (0.035, 0.0), (0.055, 0.012), (0.068, 0.032), (0.072, 0.05),
        (0.069, 0.05), (0.064, 0.034), (0.051, 0.016), (0.030, 0.007), (0.0, 0.007),
    ]  # fmt: skip
    add_visual_mesh(spec, bowl, "bowl_skin", white, revolve(profile))
    add_visual_geom(bowl, CYLINDER, food, pos=[0, 0, 0.022], size=[0.058, 0.006, 0])
