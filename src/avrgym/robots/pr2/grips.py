"""How a hand of the PR2 holds each tool; fingertips touch what they hold, within 3 mm."""

from collections.abc import Mapping

import numpy as np

from avrgym.geometry import transforms
from avrgym.models.robot import Grip


def _parallel_fingers(opening_rad: float) -> dict[str, float]:
    """Two fingers that open alike, their tips parallel."""
    return {
        f"{side}_finger_{part}joint": sign * opening_rad
        for side, opened in (("l", 1.0), ("r", -1.0))
        for part, sign in (("", opened), ("tip_", -opened))
    }


GRIPS: Mapping[str, Grip] = {
    "spoon": Grip(
        pos=np.array([0.0, 0.0, -0.0065]),
        q=transforms.IDENTITY_QUATERNION,
        fingers=_parallel_fingers(0.051),
    ),
    "cup": Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        fingers=_parallel_fingers(0.48),
    ),
    "washcloth": Grip(
        pos=np.array([-0.021, 0.0, 0.0]),
        q=transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
        fingers=_parallel_fingers(0.075),
    ),
    "scratcher": Grip(
        pos=np.array([-0.020, 0.0, 0.0]),
        q=transforms.IDENTITY_QUATERNION,
        fingers=_parallel_fingers(0.066),
    ),
}
