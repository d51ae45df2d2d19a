"""Distances of segments from segments, points and boxes, vectorised over pairs.

A capsule is a segment with a radius. The distance between two capsules is the distance between their segments minus
both radii. Functions broadcast over leading axes. The result of a pair does not depend on other pairs. Internally the
vector axis is the first axis, which is faster. Arrays may be of any library, see ``arrays``.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import get_namespace, get_namespace_and_floats


def segment_distance(a0: FloatArray, a1: FloatArray, b0: FloatArray, b1: FloatArray) -> FloatArray:
    """Returns the distance (...) in metres between segments a and b, given by their end points (..., 3).

    The algorithm clamps the closest points of the two lines to the segments (Ericson, *Real-Time Collision Detection*,
    2005, section 5.1.9). Segments may be points or parallel. The error is at most 1e-8 of the segments' length.
    """
    a0, a1, b0, b1 = _axis_first(a0, a1, b0, b1)
    along_a, along_b, offset = a1 - a0, b1 - b0, a0 - b0
    aa, bb, ab = _dot(along_a, along_a), _dot(along_b, along_b), _dot(along_a, along_b)
    a_offset, b_offset = _dot(along_a, offset), _dot(along_b, offset)
    s = _share(ab * b_offset - a_offset * bb, aa * bb - ab * ab)
    t = _share(ab * s + b_offset, bb)
    s = _share(ab * t - a_offset, aa)
    return _length(offset + s * along_a - t * along_b)


def point_segment_distance(point: FloatArray, s0: FloatArray, s1: FloatArray) -> FloatArray:
    """Returns the distance (...) in metres of points (..., 3) from segments.

    ``s0`` and ``s1`` (..., 3) are the end points of the segments.
    """
    point, s0, s1 = _axis_first(point, s0, s1)
    along, offset = s1 - s0, point - s0
    return _length(offset - _share(_dot(offset, along), _dot(along, along)) * along)


def segment_box_distance(
    box_pos_w: FloatArray, box_q_w: FloatArray, half_size_m: FloatArray, s0_w: FloatArray, s1_w: FloatArray
) -> FloatArray:
    """Returns the distance (...) in metres between segments and oriented boxes; 0 if they intersect.

    Args:
        box_pos_w: box centres (..., 3).
        box_q_w: box orientations (..., 4).
        half_size_m: half edge lengths of the boxes (..., 3).
        s0_w: start points of the segments (..., 3).
        s1_w: end points of the segments (..., 3).
    """
    entries = transforms.to_matrix(box_q_w).reshape(*np.shape(box_q_w)[:-1], 9)
    centre_w, entries, half, s0_w, s1_w = _axis_first(box_pos_w, entries, half_size_m, s0_w, s1_w)
    to_world = entries.reshape(3, 3, *entries.shape[1:])
    start, along = _dot(to_world, s0_w - centre_w), _dot(to_world, s1_w - s0_w)
    nearest = start + _closest_share(start, along, half) * along
    return _length(nearest - _clamp(nearest, -half, half))


def _closest_share(start: FloatArray, along: FloatArray, half: FloatArray) -> FloatArray:
    """Returns the position (...) along each segment, 0 to 1, that is closest to a box at the origin.

    Arguments are (3, ...). The squared distance is a convex function of the position. Each axis contributes a slope:
    zero inside the slab of the box, linear outside. The sum of slopes is therefore linear between neighbouring
    positions at which the segment enters or leaves a slab. One Newton step in the correct interval finds the zero of
    this sum.
    """
    xp = get_namespace(start)
    least = _vanishing(along)
    moving = xp.where(xp.abs(along) > least, along, least)
    middle, reach = -start / moving, half / xp.abs(moving)
    enter, leave, weight = middle - reach, middle + reach, along * along
    shares = _clamp(xp.concat([enter, leave]), 0.0, 1.0)
    slope = _dot(weight[:, None], shares - _clamp(shares, enter[:, None], leave[:, None]))
    last_falling = xp.max(xp.where(slope <= 0.0, shares, 0.0), axis=0)
    first_rising = xp.min(xp.where(slope >= 0.0, shares, 1.0), axis=0)
    between = 0.5 * (last_falling + first_rising)
    beyond = between - _clamp(between, enter, leave)
    curvature = _dot(weight, beyond != 0.0)
    step = _dot(weight, beyond) / xp.where(curvature > 0.0, curvature, np.inf)
    return _clamp(between - step, 0.0, 1.0)


def _share(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Returns the ratio, clamped to 0 … 1; 0 if the denominator vanishes."""
    xp = get_namespace(numerator)
    usable = xp.abs(denominator) > _vanishing(denominator)
    return _clamp(numerator / xp.where(usable, denominator, np.inf), 0.0, 1.0)


def _vanishing(x: FloatArray) -> float:
    """Returns the threshold below which a number is treated as zero.

    The inverse of the threshold is finite in the precision of x.
    """
    return 1e-100 if x.dtype == get_namespace(x).float64 else 1e-30


def _clamp(x: FloatArray, low: FloatArray | float, high: FloatArray | float) -> FloatArray:
    """Returns x clipped to [low, high]. This is faster than ``numpy.clip``."""
    xp = get_namespace(x)
    return xp.minimum(xp.maximum(x, low), high)


def _axis_first(*vectors: FloatArray) -> list[FloatArray]:
    """Returns vectors (..., n) with equal numbers of axes, and with the last axis moved to the front."""
    xp, *arrays = get_namespace_and_floats(*vectors)
    axes = max(v.ndim for v in arrays)
    order = (axes - 1, *range(axes - 1))
    turned = [xp.permute_dims(v.reshape((1,) * (axes - v.ndim) + v.shape), order) for v in arrays]
    return [v.copy() for v in turned] if xp is np else turned


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the dot product (...) of vectors (3, ...). For a matrix ``a`` (3, 3, ...), it is aᵀ b (3, ...)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _length(v: FloatArray) -> FloatArray:
    return get_namespace(v).sqrt(_dot(v, v))
