"""What stands around the person, by name, in the world's frame: they sit or lie at the origin, facing −y."""

from collections.abc import Callable, Mapping
from functools import partial

import mujoco

from avrgym.models.furniture.bed import NIGHTSTAND_BODY, NIGHTSTAND_TOP_M, add_hospital_bed, add_nightstand
from avrgym.models.furniture.table import BOWL_BODY, BOWL_START_M, TABLE_BODY, TABLE_HEIGHT_M, add_table
from avrgym.models.furniture.wheelchair import JACO_MOUNT_M, add_jaco_bracket, add_wheelchair

__all__ = [
    "BOWL_BODY",
    "BOWL_START_M",
    "FURNITURE",
    "JACO_MOUNT_M",
    "NIGHTSTAND_BODY",
    "NIGHTSTAND_TOP_M",
    "TABLE_BODY",
    "TABLE_HEIGHT_M",
]

FURNITURE: Mapping[str, Callable[[mujoco.MjSpec, bool], None]] = {
    "wheelchair": add_wheelchair,
    "wheelchair_without_right_armrest": partial(add_wheelchair, armrests=("left",)),
    "table": add_table,
    "jaco_bracket": add_jaco_bracket,
    "hospital_bed": add_hospital_bed,
    "nightstand": add_nightstand,
}
"""Each adds its bodies to a scene; the second argument says whether to add what only pictures need."""
