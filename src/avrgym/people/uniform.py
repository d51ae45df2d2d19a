"""Values drawn from uniform numbers."""

import numpy as np
from numpy.typing import NDArray

from avrgym.geometry.arrays import namespace

Array = NDArray[np.float64]


def between(limits: tuple[float, float], uniform: Array) -> Array:
    """What uniform numbers in 0..1, any shape, are in a range."""
    return limits[0] + (limits[1] - limits[0]) * uniform


def which(uniform: Array, count: NDArray[np.intp] | int) -> NDArray[np.intp]:
    """Which of so many, from 0, uniform numbers in 0..1 mean, each with the same chance."""
    xp = namespace(uniform)
    return xp.minimum(xp.astype(uniform * count, xp.int64), count - 1)
