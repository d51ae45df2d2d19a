"""Grips of a hand with two parallel fingers."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.robot import Grip
from avrgym.models.scratcher import FINGERTIPS_TO_GRIP_DISTANCE_M, SCRATCHER

CUP_ROTATION = transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation of a cup relative to a spoon: the cup's x axis is across the fingers."""
WASHCLOTH_ROTATION = transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation of a washcloth relative to a spoon: the washcloth's z axis is across the fingers."""
SPOON_ROTATION = transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""Rotation of a spoon relative to the hand. The hand's z axis points outwards; its y axis is across the fingers."""
TOOL_ROTATIONS = {
    "spoon": transforms.IDENTITY_QUATERNION,
    "cup": CUP_ROTATION,
    "scratcher": transforms.IDENTITY_QUATERNION,
    "washcloth": WASHCLOTH_ROTATION,
}
"""Rotations (4,) of tools in the hand relative to a spoon, by tool."""


def make_parallel_grips(
    grip_point_m: ArrayLike,
    fingertip_length_m: float,
    tool_rotation: FloatArray,
    **fingers: Mapping[str, float],
) -> dict[str, Grip]:
    """Returns grips by tool name. The grip point is between the fingertips; for the scratcher it is farther back.

    Args:
        grip_point_m: point between the fingertips (3,), end effector's frame.
        fingertip_length_m: distance from this point to the end of the fingertips.
        tool_rotation: rotation (4,) of a spoon, x out of the hand and y across the fingers, end effector's frame.
        **fingers: positions of the finger joints by tool.
    """
    out, between = transforms.rotate(tool_rotation, [1.0, 0.0, 0.0]), np.asarray(grip_point_m, float)
    return {
        tool: Grip(
            between - (FINGERTIPS_TO_GRIP_DISTANCE_M - fingertip_length_m) * out
            if tool == SCRATCHER.name
            else between,
            transforms.multiply(tool_rotation, TOOL_ROTATIONS[tool]),
            positions,
        )
        for tool, positions in fingers.items()
    }
