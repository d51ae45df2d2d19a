"""Array types for annotations."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
NumpyArray = NDArray[Any]
"""A NumPy array of any data type."""
AnyArray = Any
"""An array of NumPy or another array library such as PyTorch, or a number. ``array_api_compat`` has no types for it."""
