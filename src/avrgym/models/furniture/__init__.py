"""Furniture by name, in the world frame. The person is at the origin, seated or in bed, and faces −y."""

from collections.abc import Callable, Mapping
from functools import partial

import mujoco

from avrgym.models.furniture.bed import (
    NIGHTSTAND_BODY,
    NIGHTSTAND_TOP_POS_M,
    add_hospital_bed,
    add_nightstand,
)
from avrgym.models.furniture.table import (
    BOWL_BODY,
    BOWL_INITIAL_POS_M,
    TABLE_BODY,
    TABLE_HEIGHT_M,
    PositionOffset,
    add_table,
)
from avrgym.models.furniture.wheelchair import add_bracket, add_wheelchair

__all__ = [
    "BOWL_BODY",
    "BOWL_INITIAL_POS_M",
    "FURNITURE_BUILDERS",
    "NIGHTSTAND_BODY",
    "NIGHTSTAND_TOP_POS_M",
    "TABLE_BODY",
    "TABLE_HEIGHT_M",
    "PositionOffset",
    "add_bracket",
    "add_hospital_bed",
    "add_nightstand",
    "add_table",
    "add_wheelchair",
    "add_wheelchair_without_right_armrest",
]

add_wheelchair_without_right_armrest = partial(add_wheelchair, armrests=("left",))

FURNITURE_BUILDERS: Mapping[str, Callable[[mujoco.MjSpec, bool], None]] = {
    "wheelchair": add_wheelchair,
    "wheelchair_without_right_armrest": add_wheelchair_without_right_armrest,
    "table": add_table,
    "hospital_bed": add_hospital_bed,
    "nightstand": add_nightstand,
}
"""Functions that add furniture to a scene, by name of the furniture. Arguments: the scene, and whether to add visual
geoms.
"""
