"""The vision network in PyTorch, for training; see ``networks.vision`` for the NumPy version."""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import relu

from avrgym.array_types import FloatArray
from avrgym.networks.policy import Policy
from avrgym.networks.vision import VisionNetwork

CONVOLUTION_CHANNELS, KERNEL_SIZES, CONVOLUTION_STRIDES = (16, 32, 32), (5, 3, 3), (3, 2, 2)
"""Number of output channels, kernel size and stride of each convolution."""
IMAGE_LAYER_UNITS, COMBINED_LAYER_UNITS = 64, 96
"""Number of units of the first and the second dense layer. The first layer receives the image features. The second
layer also receives the measured entries.
"""


class TrainableVisionNetwork(nn.Module):
    """Estimates entries of the normalised observation, and computes a teacher's actions from the estimates."""

    def __init__(self, teacher: Policy, estimated: list[int], image_shape: tuple[int, int, int]) -> None:
        """Create random weights for images (H, W, C). ``estimated`` contains the indices of the estimated entries."""
        super().__init__()
        height, width, channels = image_shape
        convolutions: list[nn.Module] = []
        for outputs, size, stride in zip(
            CONVOLUTION_CHANNELS, KERNEL_SIZES, CONVOLUTION_STRIDES, strict=True
        ):
            convolutions.append(nn.Conv2d(channels, outputs, size, stride))
            height, width, channels = (height - size) // stride + 1, (width - size) // stride + 1, outputs
        measured = teacher.observation_size - len(estimated)
        self.convolutions = nn.ModuleList(convolutions)
        self.dense = nn.ModuleList(
            [
                nn.Linear(height * width * channels, IMAGE_LAYER_UNITS),
                nn.Linear(IMAGE_LAYER_UNITS + measured, COMBINED_LAYER_UNITS),
                nn.Linear(COMBINED_LAYER_UNITS, len(estimated)),
            ]
        )
        self._estimated = estimated
        self._measured = [i for i in range(teacher.observation_size) if i not in estimated]
        self._clip = teacher.observation_clip
        layers = zip(teacher.weights, teacher.biases, strict=True)
        self._teacher = [tuple(torch.tensor(each, dtype=torch.float32) for each in layer) for layer in layers]

    def forward(self, image: Tensor, rows: Tensor) -> Tensor:
        """Returns estimates (N, E) for images (N, C, H, W) and normalised observations (N, O)."""
        for convolution in self.convolutions:
            image = relu(convolution(image))
        seen = relu(self.dense[0](image.permute(0, 2, 3, 1).flatten(1)))
        joined = torch.cat([seen, rows[:, self._measured]], dim=1)
        return self.dense[2](relu(self.dense[1](joined)))

    def compute_teacher_actions(self, rows: Tensor, estimates: Tensor) -> Tensor:
        """Returns the teacher's mean actions (N, A). In its input ``rows`` (N, O), the estimates replace the
        estimated entries.
        """
        filled = rows.clone()
        filled[:, self._estimated] = estimates.clamp(-self._clip, self._clip)
        for weight, bias in self._teacher[:-1]:
            filled = torch.tanh(filled @ weight + bias)
        weight, bias = self._teacher[-1]
        return filled @ weight + bias

    def to_numpy_network(self) -> VisionNetwork:
        """Returns the network with NumPy arrays instead of tensors."""
        return VisionNetwork(
            kernels=tuple(_array(each.weight).transpose(2, 3, 1, 0) for each in self.convolutions),
            kernel_biases=tuple(_array(each.bias) for each in self.convolutions),
            strides=np.array(CONVOLUTION_STRIDES, float),
            dense_weights=tuple(_array(each.weight).T for each in self.dense),
            dense_biases=tuple(_array(each.bias) for each in self.dense),
            estimated_indices=np.array(self._estimated, float),
        )


def _array(tensor: Tensor | nn.Module) -> FloatArray:
    assert isinstance(tensor, Tensor)
    return tensor.detach().numpy().astype(np.float64)
