"""Layers of policy networks in NumPy. The order of sums is fixed: it does not depend on batch size or processor."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary

MAX_STORED_PRODUCTS = 65536
"""Maximum number of products that are stored before they are summed. These products need half a megabyte, less than the
cache of a processor.
"""


@dataclass(frozen=True, eq=False)
class GatedRecurrentUnit:
    """A gated recurrent unit (Cho et al., EMNLP 2014) with U units, in PyTorch's variant.

    The columns of the weights are reset gates, update gates and candidates. Arrays are stored as read-only float64.

    Args:
        input_weight: weights of the inputs (inputs, 3 U).
        input_bias: biases of the inputs (3 U,).
        hidden_weight: weights of the previous hidden state (U, 3 U).
        hidden_bias: biases of the previous hidden state (3 U,).
    """

    input_weight: FloatArray
    input_bias: FloatArray
    hidden_weight: FloatArray
    hidden_bias: FloatArray

    def __post_init__(self) -> None:
        for each in fields(self):
            object.__setattr__(self, each.name, copy_read_only(getattr(self, each.name)))

    @property
    def num_units(self) -> int:
        """Returns the number of units, U."""
        return self.hidden_weight.shape[0]

    def compute_next_hidden_state(self, rows: FloatArray, memory: FloatArray) -> FloatArray:
        """Returns the next hidden state (N, U), from inputs ``rows`` (N, inputs) and the previous state
        ``memory`` (N, U). Values are in [-1, 1].
        """
        inputs = np.split(multiply_matrices(rows, self.input_weight) + self.input_bias, 3, axis=1)
        hidden = np.split(multiply_matrices(memory, self.hidden_weight) + self.hidden_bias, 3, axis=1)
        reset, update = (_sigmoid(inputs[gate] + hidden[gate]) for gate in (0, 1))
        candidate = elementary.tanh(inputs[2] + reset * hidden[2])
        return (1.0 - update) * candidate + update * memory


def multiply_matrices(rows: FloatArray, weight: FloatArray) -> FloatArray:
    """Returns the matrix product (N, outputs) of ``rows`` (N, inputs) and ``weight`` (inputs, outputs).

    Unlike in BLAS, the order of sums is fixed.
    """
    outputs = np.empty((len(rows), weight.shape[1]))
    batch = max(1, MAX_STORED_PRODUCTS // weight.size)
    for first in range(0, len(rows), batch):
        part = slice(first, first + batch)
        (rows[part, :, None] * weight).sum(axis=1, out=outputs[part])
    return outputs


def copy_read_only(array: Any) -> FloatArray:
    """Returns a read-only copy of the array as float64."""
    copy = np.array(array, np.float64, order="C")
    copy.setflags(write=False)
    return copy


def _sigmoid(x: FloatArray) -> FloatArray:
    return 0.5 + 0.5 * elementary.tanh(0.5 * x)
