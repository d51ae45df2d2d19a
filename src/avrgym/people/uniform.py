"""Values drawn from uniform numbers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def between(limits: tuple[float, float], uniform: Array) -> Array:
    """What uniform numbers in 0..1, any shape, are in a range."""
    return limits[0] + (limits[1] - limits[0]) * uniform
