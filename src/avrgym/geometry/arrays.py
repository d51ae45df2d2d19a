"""Arrays of NumPy, or of another library that follows the Python array API standard, such as tensors on a GPU.

Functions of arrays compute with the library that their arguments are of, so that one source serves all. With NumPy's
arrays they give what NumPy gives, to the bit. With others nothing is copied to the host: no function branches on a
value, or asks how often something is true.
"""

from dataclasses import is_dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, to_device
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray, IntArray, NumpyArray

RAD_PER_DEGREE = float(np.radians(1.0))

_NUMPYS = (np.ndarray, float, int, list, tuple, np.generic)
"""What NumPy's functions take as it is."""


def namespace(*values: Any) -> Any:
    """The library that values are of, as the standard has it; NumPy where all are NumPy's arrays or numbers."""
    for value in values:
        if not isinstance(value, _NUMPYS):
            return array_namespace(value)
    return np


def as_floats(*values: Any) -> tuple[Any, ...]:
    """The values' library, then each of them as an array of it, of floating numbers.

    NumPy's become float64; numbers of the host beside another library's arrays become like these.
    """
    for value in values:
        if not isinstance(value, _NUMPYS):
            return array_namespace(value), *[constant_like(each, value) for each in values]
    return np, *[np.asarray(value, float) for value in values]


def constant_like(values: Any, array: Any) -> Any:
    """Constant numbers of the host, where an array is: beside NumPy's as they are, else once brought there.

    Floating ones get the type of the array.
    """
    if isinstance(array, _NUMPYS) or not isinstance(values, _NUMPYS):
        return values
    numbers = np.asarray(values)
    xp, dtype = array_namespace(array), array.dtype if numbers.dtype.kind == "f" else None
    return _there(numbers.tobytes(), numbers.shape, numbers.dtype.str, xp, dtype, array.device)


@lru_cache(maxsize=1024)
def _there(numbers: bytes, shape: tuple[int, ...], kind: str, xp: Any, dtype: Any, device: Any) -> Any:
    return xp.asarray(np.frombuffer(numbers, kind).reshape(shape).copy(), dtype=dtype, device=device)


def moved_to(values: Any, beside: Any) -> Any:
    """An array of the host, or a dataclass of some, brought to where another array is; those not of the host stay.

    Floating numbers get the type of that array.
    """
    if isinstance(beside, _NUMPYS):
        return values
    if is_dataclass(values) and not isinstance(values, type):
        return replace(values, **{name: moved_to(each, beside) for name, each in vars(values).items()})
    if not isinstance(values, _NUMPYS):
        return values
    numbers = np.asarray(values)
    dtype = beside.dtype if numbers.dtype.kind == "f" else None
    return namespace(beside).asarray(numbers.copy(), dtype=dtype, device=beside.device)


def to_numpy(array: Any) -> NumpyArray:
    """NumPy's array of the same numbers: the same one, or a copy that waits for the device."""
    return np.asarray(array if isinstance(array, _NUMPYS) else to_device(array, "cpu"))


def float_copy(array: ArrayLike) -> Any:
    """A copy, of floating numbers, that may be changed."""
    xp, numbers = as_floats(array)
    return xp.asarray(numbers, copy=True)


def row_indices(array: Any) -> Any:
    """0, 1, … for each of an array's rows (n, ...), where the array is."""
    return namespace(array).arange(len(array), device=array.device)


def active_indices(mask: Any) -> tuple[Any, ...]:
    """The indices, an array for each axis, of what is worth computing: with NumPy that for which a mask is true.

    With other libraries it is everything, since how much is true would have to be copied to the host, which would wait
    for it. What is computed has to be masked, therefore.
    """
    xp = namespace(mask)
    if xp is np:
        return np.nonzero(mask)
    grid = xp.meshgrid(*[xp.arange(size, device=mask.device) for size in mask.shape], indexing="ij")
    return tuple(xp.reshape(axis, (-1,)) for axis in grid)


def interpolate(limits: tuple[float, float], share: FloatArray) -> FloatArray:
    """Values between two limits at shares 0 to 1, any shape."""
    return limits[0] + (limits[1] - limits[0]) * share


def choose_index(uniform: FloatArray, count: IntArray | int) -> IntArray:
    """Indices 0 to ``count`` − 1 from uniform numbers in 0..1, each index equally likely."""
    xp = namespace(uniform)
    return xp.minimum(xp.astype(uniform * count, xp.int64), count - 1)
