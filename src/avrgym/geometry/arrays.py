"""Functions for NumPy arrays and for arrays of other libraries (Python array API), such as PyTorch tensors on a GPU.

Functions compute with the library of their arguments. With NumPy arrays, results are bit-identical to those of NumPy's
functions. With other libraries, only ``to_numpy`` copies values to the host: no function branches on values.
"""

from dataclasses import is_dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, to_device
from numpy.typing import ArrayLike

from avrgym.array_types import AnyArray, FloatArray, IntArray, NumpyArray

RAD_PER_DEGREE = float(np.radians(1.0))
"""Radians in one degree."""

_NUMPYS = (np.ndarray, float, int, list, tuple, np.generic)
"""Types for which the functions of this module use NumPy."""


def get_namespace(*values: AnyArray) -> Any:
    """Returns the array library of the values: NumPy if all values are NumPy arrays, numbers or sequences."""
    for value in values:
        if not isinstance(value, _NUMPYS):
            return array_namespace(value)
    return np


def get_namespace_and_floats(*values: AnyArray) -> tuple[AnyArray, ...]:
    """Returns the array library of the values, followed by each value as a floating-point array of this library.

    NumPy values become float64. If one value is an array of another library, all values become arrays of that library.
    """
    for value in values:
        if not isinstance(value, _NUMPYS):
            return array_namespace(value), *[constant_like(each, value) for each in values]
    return np, *[np.asarray(value, float) for value in values]


def constant_like(values: AnyArray, array: AnyArray) -> AnyArray:
    """Returns constants as an array with the library and the device of ``array``.

    Floating-point constants get the data type of ``array``. If ``array`` is a NumPy array, ``values`` are returned
    unchanged. Conversions are cached.
    """
    if isinstance(array, _NUMPYS) or not isinstance(values, _NUMPYS):
        return values
    numbers = np.asarray(values)
    xp, dtype = array_namespace(array), array.dtype if numbers.dtype.kind == "f" else None
    return _there(numbers.tobytes(), numbers.shape, numbers.dtype.str, xp, dtype, array.device)


@lru_cache(maxsize=1024)
def _there(numbers: bytes, shape: tuple[int, ...], kind: str, xp: Any, dtype: Any, device: Any) -> Any:
    return xp.asarray(np.frombuffer(numbers, kind).reshape(shape).copy(), dtype=dtype, device=device)


def to_device_of(values: AnyArray, array: AnyArray) -> AnyArray:
    """Returns a NumPy array, or a dataclass of arrays, converted to the library and the device of ``array``.

    Floating-point numbers get the data type of ``array``.
    """
    if isinstance(array, _NUMPYS):
        return values
    if is_dataclass(values) and not isinstance(values, type):
        return replace(values, **{name: to_device_of(each, array) for name, each in vars(values).items()})
    if not isinstance(values, _NUMPYS):
        return values
    numbers = np.asarray(values)
    dtype = array.dtype if numbers.dtype.kind == "f" else None
    return get_namespace(array).asarray(numbers.copy(), dtype=dtype, device=array.device)


def to_numpy(array: AnyArray) -> NumpyArray:
    """Returns the array as a NumPy array. For other libraries, this waits until the device has computed the array."""
    return np.asarray(array if isinstance(array, _NUMPYS) else to_device(array, "cpu"))


def copy_as_float(array: ArrayLike) -> AnyArray:
    """Returns a copy as a floating-point array. The caller may change the copy."""
    xp, numbers = get_namespace_and_floats(array)
    return xp.asarray(numbers, copy=True)


def make_row_indices(array: AnyArray) -> AnyArray:
    """Returns the indices 0 to n − 1 of the rows of an array (n, ...), on the device of the array."""
    return get_namespace(array).arange(len(array), device=array.device)


def find_indices_to_compute(mask: AnyArray) -> tuple[AnyArray, ...]:
    """Returns index arrays, one per axis, of the elements that must be computed.

    With NumPy these are the elements with a true ``mask``. With other libraries they are all elements, because their
    number would otherwise be copied to the host. The caller must therefore mask the results.
    """
    xp = get_namespace(mask)
    if xp is np:
        return np.nonzero(mask)
    grid = xp.meshgrid(*[xp.arange(size, device=mask.device) for size in mask.shape], indexing="ij")
    return tuple(xp.reshape(axis, (-1,)) for axis in grid)


def interpolate(limits: tuple[float, float], share: FloatArray) -> FloatArray:
    """Returns the linear interpolation between two limits, in the shape of ``share``. Share 0 gives the first limit,
    share 1 the second limit.
    """
    return limits[0] + (limits[1] - limits[0]) * share


def choose_index(uniform: FloatArray, count: IntArray | int) -> IntArray:
    """Returns indices from 0 to ``count`` − 1 for uniform random numbers in [0, 1]. All indices are equally likely."""
    xp = get_namespace(uniform)
    return xp.minimum(xp.astype(uniform * count, xp.int64), count - 1)
