"""Values drawn from uniform numbers."""

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry.arrays import namespace


def between(limits: tuple[float, float], uniform: FloatArray) -> FloatArray:
    """What uniform numbers in 0..1, any shape, are in a range."""
    return limits[0] + (limits[1] - limits[0]) * uniform


def which(uniform: FloatArray, count: IntArray | int) -> IntArray:
    """Which of so many, from 0, uniform numbers in 0..1 mean, each with the same chance."""
    xp = namespace(uniform)
    return xp.minimum(xp.astype(uniform * count, xp.int64), count - 1)
