"""What policies' networks are made of, in sums whose order neither batch nor processor changes."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary

CACHED = 65536
"""How many numbers of a product are held before they are summed: half a megabyte, which a processor's cache holds."""


@dataclass(frozen=True, eq=False)
class Memory:
    """A gated recurrent unit (Cho et al., EMNLP 2014), in the variant that PyTorch has.

    Columns are those of the reset gates, then the update gates, then what is new; U units. All arrays are kept as
    read-only float64.

    Args:
        input_weight: (inputs, 3 U).
        input_bias: (3 U,).
        hidden_weight: (U, 3 U).
        hidden_bias: (3 U,).
    """

    input_weight: FloatArray
    input_bias: FloatArray
    hidden_weight: FloatArray
    hidden_bias: FloatArray

    def __post_init__(self) -> None:
        for each in fields(self):
            object.__setattr__(self, each.name, frozen(getattr(self, each.name)))

    @property
    def units(self) -> int:
        """U."""
        return self.hidden_weight.shape[0]

    def after(self, rows: FloatArray, remembered: FloatArray) -> FloatArray:
        """What is remembered (N, U) after inputs (N, inputs), of what was before them; all within -1 to 1."""
        seen = np.split(product(rows, self.input_weight) + self.input_bias, 3, axis=1)
        known = np.split(product(remembered, self.hidden_weight) + self.hidden_bias, 3, axis=1)
        reset, kept = (_sigmoid(seen[gate] + known[gate]) for gate in (0, 1))
        new = elementary.tanh(seen[2] + reset * known[2])
        return (1.0 - kept) * new + kept * remembered


def product(rows: FloatArray, weight: FloatArray) -> FloatArray:
    """The rows (N, inputs) times (inputs, outputs); a library for matrices would sum in an order of its own."""
    outputs = np.empty((len(rows), weight.shape[1]))
    at_once = max(1, CACHED // weight.size)
    for first in range(0, len(rows), at_once):
        some = slice(first, first + at_once)
        (rows[some, :, None] * weight).sum(axis=1, out=outputs[some])
    return outputs


def frozen(array: Any) -> FloatArray:
    """A read-only copy."""
    copy = np.array(array, np.float64, order="C")
    copy.setflags(write=False)
    return copy


def _sigmoid(x: FloatArray) -> FloatArray:
    return 0.5 + 0.5 * elementary.tanh(0.5 * x)
