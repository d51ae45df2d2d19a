"""The vision of a policy: a small convolutional network in NumPy that estimates entries of the observation.

The robot cannot measure the estimated entries, for example the position of the mouth. The inputs of the network are an
image and the measured entries.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray, NumpyArray
from avrgym.networks.layers import copy_read_only, multiply_matrices

MAX_INPUT_DEPTH_M = 1.2
"""Depth that corresponds to 1 in the network's input. Larger depths are clipped to 1."""
CONVOLUTION_COUNT = 3


@dataclass(frozen=True, eq=False)
class VisionNetwork:
    """Convolutions with rectified linear units (ReLU), then three dense layers. The second dense layer also receives
    the measured entries.

    All arrays are stored as read-only float64.

    Args:
        kernels: one array (K, K, inputs, outputs) for each convolution.
        kernel_biases: one array (outputs,) for each convolution.
        strides: stride of each convolution (3,), integers.
        dense_weights: one array (inputs, outputs) for each dense layer. The inputs of the second are the outputs of the
            first and the measured entries.
        dense_biases: one array (outputs,) for each dense layer.
        estimated_indices: indices (E,) of the estimated entries of the observation.
    """

    kernels: tuple[FloatArray, ...]
    kernel_biases: tuple[FloatArray, ...]
    strides: FloatArray
    dense_weights: tuple[FloatArray, ...]
    dense_biases: tuple[FloatArray, ...]
    estimated_indices: FloatArray

    def __post_init__(self) -> None:
        for name in ("kernels", "kernel_biases", "dense_weights", "dense_biases"):
            object.__setattr__(self, name, tuple(copy_read_only(array) for array in getattr(self, name)))
        for name in ("strides", "estimated_indices"):
            object.__setattr__(self, name, copy_read_only(getattr(self, name)))

    def fill_estimated_entries(self, rows: FloatArray, image: FloatArray) -> FloatArray:
        """Returns normalised observations (N, O) with the network's estimates in the estimated entries.

        Args:
            rows: normalised observations (N, O). The values of estimated entries are not used.
            image: input images (N, H, W, C), from ``make_vision_input``.
        """
        estimated = self.estimated_indices.astype(np.intp)
        features = image
        for kernel, bias, stride in zip(self.kernels, self.kernel_biases, self.strides, strict=True):
            features = np.maximum(_convolved(features, kernel, int(stride)) + bias, 0.0)
        first, second, last = zip(self.dense_weights, self.dense_biases, strict=True)
        seen = np.maximum(multiply_matrices(features.reshape(len(rows), -1), first[0]) + first[1], 0.0)
        measured = np.delete(rows, estimated, axis=1)
        joined = np.maximum(
            multiply_matrices(np.concatenate([seen, measured], axis=1), second[0]) + second[1], 0.0
        )
        filled = rows.copy()
        filled[:, estimated] = multiply_matrices(joined, last[0]) + last[1]
        return filled

    def to_tensors(self) -> dict[str, NumpyArray]:
        """Returns the arrays of the network by their names in a policy file."""
        found: dict[str, NumpyArray] = {
            "vision.strides": self.strides,
            "vision.estimated": self.estimated_indices,
        }
        for name, arrays in (
            ("kernel", self.kernels),
            ("kernel_bias", self.kernel_biases),
            ("dense", self.dense_weights),
            ("dense_bias", self.dense_biases),
        ):
            found |= {f"vision.{name}.{number}": array for number, array in enumerate(arrays)}
        return found

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, NumpyArray]) -> "VisionNetwork":
        """Create and return a network from the arrays that ``tensors`` returned."""

        def each(name: str) -> tuple[Any, ...]:
            return tuple(tensors[f"vision.{name}.{number}"] for number in range(CONVOLUTION_COUNT))

        return cls(
            each("kernel"),
            each("kernel_bias"),
            tensors["vision.strides"],
            each("dense"),
            each("dense_bias"),
            tensors["vision.estimated"],
        )

    def check_shapes(self, observation_size: int, image_shape: tuple[int, int, int]) -> None:
        """Check the shapes of all arrays for images (H, W, C) and observations (O,).

        Raises:
            ValueError: if the arrays do not match each other, the images or the observations.
        """
        height, width, channels = image_shape
        for number, (kernel, stride) in enumerate(zip(self.kernels, self.strides.tolist(), strict=True)):
            size = kernel.shape[0] if kernel.ndim == 4 else 0
            if not size or kernel.shape[:3] != (size, size, channels) or stride != int(stride) or stride < 1:
                raise ValueError(
                    f"vision.kernel.{number} has the shape {kernel.shape} and stride {stride}; "
                    f"allowed: (K, K, {channels}, outputs) and 1 or more"
                )
            height, width = (int((side - size) // stride + 1) for side in (height, width))
            channels = kernel.shape[3]
            _check(f"vision.kernel_bias.{number}", self.kernel_biases[number], (channels,))
        estimated = self.estimated_indices
        whole = estimated.ndim == 1 and (estimated == np.round(estimated)).all()
        if not whole or not len(estimated) or len({*estimated.tolist()}) < len(estimated):
            raise ValueError(
                f"vision.estimated is {estimated.tolist()}; allowed: one or more different indices"
            )
        if estimated.min() < 0 or estimated.max() >= observation_size:
            raise ValueError(
                f"vision.estimated is {estimated.tolist()}; allowed: indices from 0 to {observation_size - 1}"
            )
        inputs, measured = height * width * channels, observation_size - len(estimated)
        for number, (weight, extra) in enumerate(zip(self.dense_weights, (0, measured, 0), strict=True)):
            if weight.ndim != 2 or weight.shape[0] != inputs + extra:
                raise ValueError(
                    f"vision.dense.{number} has the shape {weight.shape}; allowed: ({inputs + extra}, outputs)"
                )
            inputs = weight.shape[1]
            _check(f"vision.dense_bias.{number}", self.dense_biases[number], (inputs,))
        if inputs != len(estimated):
            raise ValueError(f"vision.dense.2 has {inputs} outputs; allowed: {len(estimated)}")


VISION_TENSOR_NAMES = (
    "vision.strides",
    "vision.estimated",
    *(
        f"vision.{name}.{number}"
        for name in ("kernel", "kernel_bias", "dense", "dense_bias")
        for number in range(CONVOLUTION_COUNT)
    ),
)
"""Names of the vision network's arrays in a policy file."""


def make_vision_input(images: Mapping[str, NumpyArray]) -> FloatArray:
    """Returns the network's input (N, H, W, C) for images of one camera, by kind: ``rgb`` (N, H, W, 3) or ``depth`` (N,
    H, W)."""
    parts: list[FloatArray] = []
    if "rgb" in images:
        parts.append(images["rgb"].astype(np.float64) / 255.0)
    if "depth" in images:
        depth = np.minimum(images["depth"].astype(np.float64), MAX_INPUT_DEPTH_M) / MAX_INPUT_DEPTH_M
        parts.append(depth[..., None])
    return np.concatenate(parts, axis=-1)


def _check(name: str, array: FloatArray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(f"{name} has the shape {array.shape}; allowed: {shape}")


def _convolved(image: FloatArray, kernel: FloatArray, stride: int) -> FloatArray:
    """Returns the convolution (N, h, w, F) of images (N, H, W, C) and a kernel (K, K, C, F), without padding."""
    size, _, channels, outputs = kernel.shape
    windows = np.lib.stride_tricks.sliding_window_view(image, (size, size), axis=(1, 2))
    windows = windows[:, ::stride, ::stride].transpose(0, 1, 2, 4, 5, 3)
    rows = windows.reshape(-1, size * size * channels)
    return multiply_matrices(rows, kernel.reshape(-1, outputs)).reshape(*windows.shape[:3], outputs)
