"""Elementary functions with bit-identical results on every processor.

NumPy and BLAS select an implementation for the processor. The results of these implementations differ in the last bit.
Contacts amplify this difference to centimetres. The functions here use only sums, products, quotients and square roots
in a fixed order. IEEE 754 defines their results to the last bit. Arguments are first reduced with constants in several
parts (Cody and Waite, "Software Manual for the Elementary Functions", 1980). Then Taylor series are summed.

Arguments are finite float64 or float32 arrays of any shape. Results have the same type. Errors are a few units in the
last place of the result, or of 1 for smaller results. Errors of powers increase with the logarithm of the result. For
arrays of PyTorch and other libraries, the functions call the functions of that library.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import NumpyArray
from avrgym.geometry.arrays import get_namespace

P = ParamSpec("P")
T = TypeVar("T")


def _or_by_library(name: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Returns a decorator: for arrays of other libraries than NumPy, the library's function ``name`` is called."""

    def decorate(own: Callable[P, T]) -> Callable[P, T]:
        @wraps(own)
        def chosen(*arguments: P.args, **named: P.kwargs) -> T:
            library = get_namespace(*arguments)
            if library is np:
                return own(*arguments, **named)
            return getattr(library, name)(*arguments, **named)

        return chosen

    return decorate


def sine_and_cosine(x: ArrayLike) -> tuple[NumpyArray, NumpyArray]:
    """Returns sine and cosine of x in radians.

    Errors are below 10⁻¹⁵ for angles of at most 10⁵ revolutions (float32: 10⁻⁶ and 100 revolutions). Taylor series give
    the values for a quarter of the angle. Then the double-angle formulas are applied twice.
    """
    library = get_namespace(x)
    if library is not np:
        return library.sin(x), library.cos(x)
    x = _floating(x)
    parts, sine_series, cosine_series = _CIRCULAR[x.dtype]
    turns = np.rint(x * _number(x, 0.5 / math.pi))
    angle = x - turns * parts[0]
    for part in parts[1:]:
        angle -= turns * part
    angle *= _number(x, 0.25)
    square = angle * angle
    sine, cosine = angle * _series(square, sine_series), _series(square, cosine_series)
    for _ in range(2):
        sine, cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
    return sine, cosine


def sin(x: ArrayLike) -> NumpyArray:
    """Returns the sine of x in radians."""
    return sine_and_cosine(x)[0]


def cos(x: ArrayLike) -> NumpyArray:
    """Returns the cosine of x in radians."""
    return sine_and_cosine(x)[1]


@_or_by_library("tan")
def tan(x: ArrayLike) -> NumpyArray:
    """Returns the tangent of x in radians."""
    sine, cosine = sine_and_cosine(x)
    return sine / cosine


@_or_by_library("atan2")
def arctan2(y: ArrayLike, x: ArrayLike) -> NumpyArray:
    """Returns the angle of the point (x, y) in radians, −π..π; 0 at the origin.

    Let t be the ratio of the smaller to the larger coordinate, and c the closest multiple of 1/4. Then arctan t =
    arctan c + arctan (t − c)/(1 + c t).
    """
    y, x = np.broadcast_arrays(_floating(y), _floating(x))
    across, along = np.abs(y), np.abs(x)
    larger = np.maximum(across, along)
    ratio = np.minimum(across, along) / np.where(larger > 0.0, larger, 1.0)
    quarters = np.rint(4.0 * ratio)
    nearest = 0.25 * quarters
    rest = (ratio - nearest) / (1.0 + nearest * ratio)
    angle = np.take(_ARCTANGENTS, quarters.astype(np.intp)) + rest * _series(rest * rest, _ARCTANGENT)
    angle = np.where(across > along, 0.5 * math.pi - angle, angle)
    angle = np.where(np.signbit(x), math.pi - angle, angle)
    return np.copysign(angle, y).astype(np.result_type(x, y))


@_or_by_library("asin")
def arcsin(x: ArrayLike) -> NumpyArray:
    """Returns the arcsine of x in radians, −π/2..π/2, for x in −1..1."""
    x = _floating(x)
    return arctan2(x, np.sqrt((1.0 - x) * (1.0 + x)))


@_or_by_library("acos")
def arccos(x: ArrayLike) -> NumpyArray:
    """Returns the arccosine of x in radians, 0..π, for x in −1..1."""
    x = _floating(x)
    return arctan2(np.sqrt((1.0 - x) * (1.0 + x)), x)


@_or_by_library("tanh")
def tanh(x: ArrayLike) -> NumpyArray:
    """Returns the hyperbolic tangent of x, (e²ˣ − 1) / (e²ˣ + 1)."""
    x = _floating(x)
    scale, more = _exponential(np.minimum(2.0 * np.abs(x), 40.0))
    grown = scale * more + (scale - 1.0)
    return np.copysign(grown / (grown + 2.0), x)


def _exponential(x: NumpyArray) -> tuple[NumpyArray, NumpyArray]:
    """Returns 2ᵏ and eʳ − 1, where x = k ln 2 + r and therefore eˣ = 2ᵏ eʳ."""
    doublings = np.rint(x * (1.0 / math.log(2.0)))
    rest = (x - doublings * _LN_2[0]) - doublings * _LN_2[1]
    return np.ldexp(np.ones_like(x), doublings.astype(np.intp)), rest * _series(rest, _EXPONENTIAL)


@_or_by_library("pow")
def power(base: ArrayLike, exponent: ArrayLike) -> NumpyArray:
    """Returns base^exponent, for a base ≥ 0 and a result without overflow."""
    base, exponent = _floating(base), _floating(exponent)
    mantissa, doublings = np.frexp(np.where(base > 0.0, base, 1.0))
    low = mantissa < math.sqrt(0.5)
    mantissa, doublings = np.where(low, 2.0 * mantissa, mantissa), doublings - low
    ratio = (mantissa - 1.0) / (mantissa + 1.0)
    logarithm = doublings * math.log(2.0) + 2.0 * ratio * _series(ratio * ratio, _LOGARITHM)
    scale, more = _exponential(exponent * logarithm)
    return np.where(base > 0.0, scale * (more + 1.0), np.where(exponent == 0.0, 1.0, 0.0))


_FLOATING = (np.dtype(np.float32), np.dtype(np.float64))


def _floating(x: ArrayLike) -> NumpyArray:
    x = np.asarray(x)
    return x if x.dtype in _FLOATING else x.astype(np.float64)


def _number(x: NumpyArray, value: float) -> Any:
    return x.dtype.type(value)


def _series(x: NumpyArray, coefficients: Sequence[float]) -> NumpyArray:
    """Returns the value of a polynomial at x, by Horner's rule. The first coefficient is that of the highest power."""
    total = x * _number(x, coefficients[0])
    for coefficient in coefficients[1:-1]:
        total += _number(x, coefficient)
        total *= x
    total += _number(x, coefficients[-1])
    return total


def _alternating(powers: range) -> list[float]:
    """Returns the Taylor coefficients ±1/p! of sine or cosine for the powers p, the highest power first."""
    return [(-1.0) ** (power // 2) / math.factorial(power) for power in reversed(powers)]


_CIRCULAR = {
    np.dtype(np.float64): (
        (6.2831853069365025, 2.4308402025215864e-10, 8.089064995183803e-21),
        _alternating(range(1, 17, 2)),
        _alternating(range(0, 18, 2)),
    ),
    np.dtype(np.float32): (
        (np.float32(6.28125), np.float32(0.0019350051879882812), np.float32(3.019915981956753e-07)),
        _alternating(range(1, 10, 2)),
        _alternating(range(0, 10, 2)),
    ),
}
"""Constants by data type: 2π as a sum of parts, then the Taylor coefficients of sine and cosine for angles of at most
π/4.

The product of such a part (except the last) and a number of revolutions is exact.
"""

_ARCTANGENTS = np.array(
    [0.0, 0.24497866312686414, 0.4636476090008061, 0.6435011087932844, 0.7853981633974483]
)
"""Arctangents of 0, 1/4, 1/2, 3/4 and 1."""
_ARCTANGENT = [(-1.0) ** n / (2.0 * n + 1.0) for n in reversed(range(8))]
_EXPONENTIAL = [1.0 / math.factorial(power) for power in reversed(range(1, 15))]
_LN_2 = (0.6931471806019545, -4.2009150726810846e-11)
_LOGARITHM = [1.0 / (2.0 * n + 1.0) for n in reversed(range(11))]


@cache
def compute_c_library_fingerprint() -> str:
    """Returns a hash (eight hexadecimal digits) of results of the C library's functions that MuJoCo calls.

    Two computers with different hashes may simulate with different rounding errors.
    """
    numbers = [0.001 * 1.0017**step for step in range(4096)]
    functions = (math.sin, math.cos, math.tan, math.atan, math.exp, math.log, math.sqrt)
    values = [function(number) for function in functions for number in numbers if number < 700.0]
    return hashlib.sha256(np.array(values).tobytes()).hexdigest()[:8]
