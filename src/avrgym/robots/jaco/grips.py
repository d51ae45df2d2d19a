"""How the Jaco's hand holds each tool; fingertips touch what they hold, within 3 mm."""

from collections.abc import Mapping

import numpy as np

from avrgym.geometry import transforms
from avrgym.models.robot import Grip


def _three_fingers(*bends_rad: tuple[float, float]) -> dict[str, float]:
    """How far each finger, the thumb first, and its tip are bent."""
    return {
        f"finger_{part}{number}": bend
        for number, bends in enumerate(bends_rad, start=1)
        for part, bend in zip(("", "tip_"), bends, strict=True)
    }


GRIPS: Mapping[str, Grip] = {
    "spoon": Grip(
        pos=np.zeros(3),
        q=transforms.multiply(
            transforms.from_matrix([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
            transforms.from_axis_angle([1.0, 0.0, 0.0], np.radians(30.0)),
        ),
        fingers=_three_fingers((1.40, 0.40), (1.05, 0.35), (1.20, 0.30)),
    ),
    "cup": Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        fingers=_three_fingers((0.54, 0.61), (0.38, 0.78), (0.59, 0.50)),
    ),
    "washcloth": Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        fingers=_three_fingers((1.40, -0.30), (1.30, -0.20), (1.30, -0.20)),
    ),
    "scratcher": Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        fingers=_three_fingers((1.15, 0.30), (1.23, 0.30), (1.23, 0.30)),
    ),
}
