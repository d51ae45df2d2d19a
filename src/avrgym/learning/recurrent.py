"""A network that remembers, in PyTorch: what ``policies.trained.Policy`` is with a memory, while it learns."""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn

from avrgym.networks.layers import Memory
from avrgym.policies.trained import Policy, PolicyMetadata
from avrgym.tasks.constants import EPISODE_STEPS

WINDOW = 50
"""Through how many control steps gradients go back."""


class RecurrentNetwork(nn.Module):
    """A gated recurrent unit, and tanh layers that see the observation and what is remembered."""

    def __init__(self, observation_size: int, memory: int, hidden: tuple[int, ...], action_size: int) -> None:
        """Draw the weights from PyTorch's random stream."""
        super().__init__()
        self.memory = nn.GRU(observation_size, memory)
        sizes = [observation_size + memory, *hidden, action_size]
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(sizes))

    @classmethod
    def of(cls, policy: Policy) -> "RecurrentNetwork":
        """The network of a policy that remembers, in single precision."""
        memory = policy.memory
        assert memory is not None
        observation_size, action_size = policy.observation_size, policy.action_size
        hidden = tuple(len(bias) for bias in policy.biases[:-1])
        network = cls(observation_size, memory.units, hidden, action_size)
        arrays = {
            "memory.weight_ih_l0": memory.input_weight,
            "memory.bias_ih_l0": memory.input_bias,
            "memory.weight_hh_l0": memory.hidden_weight,
            "memory.bias_hh_l0": memory.hidden_bias,
        }
        for number, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
            arrays[f"layers.{number}.weight"], arrays[f"layers.{number}.bias"] = weight, bias
        network.load_state_dict({name: torch.as_tensor(array.T.copy()) for name, array in arrays.items()})
        return network

    def forward(self, observations: Tensor, remembered: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Mean actions (T, n, A) for normalised observations (T, n, O), and what is remembered (1, n, U) at the end."""
        told, last = self.memory(observations, remembered)
        rows = torch.cat([observations, told], dim=-1)
        for layer in self.layers[:-1]:
            rows = torch.tanh(layer(rows))
        return self.layers[-1](rows), last

    def policy(self, normaliser: Any, metadata: PolicyMetadata, deviation: float = 0.0) -> Policy:
        """The same as a policy behind a normaliser of observations, with a chance of this standard deviation."""
        unit, layers = self.memory, [*self.layers]
        return Policy(
            weights=tuple(_array(layer.weight).T for layer in layers),
            biases=tuple(_array(layer.bias) for layer in layers),
            observation_mean=normaliser.obs_rms.mean,
            observation_variance=normaliser.obs_rms.var,
            observation_clip=normaliser.clip_obs,
            observation_epsilon=normaliser.epsilon,
            action_deviation=deviation,
            metadata=metadata,
            memory=Memory(
                input_weight=_array(unit.weight_ih_l0).T,
                input_bias=_array(unit.bias_ih_l0),
                hidden_weight=_array(unit.weight_hh_l0).T,
                hidden_bias=_array(unit.bias_hh_l0),
            ),
        )


def windows() -> Iterator[slice]:
    """The parts of an episode through which gradients go back, one after the other."""
    return (slice(first, first + WINDOW) for first in range(0, EPISODE_STEPS, WINDOW))


def fit(
    network: RecurrentNetwork,
    optimizer: torch.optim.Optimizer,
    observations: Tensor,
    loss: Callable[..., Tensor],
    targets: Sequence[Tensor],
    gradient_norm: float,
) -> None:
    """Lower the loss of what a network says of whole episodes, (T, n, O).

    ``loss`` is given what it says in a window, (t, n, A), and that part of each of the targets (T, n, ...).
    """
    remembered = None
    for window in windows():
        said, remembered = network(observations[window], remembered)
        step(optimizer, network, loss(said, *(target[window] for target in targets)), gradient_norm)
        remembered = remembered.detach()


def step(optimizer: torch.optim.Optimizer, network: nn.Module, loss: Tensor, gradient_norm: float) -> None:
    """Take a step down a loss; a gradient longer than given is shortened to that."""
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), gradient_norm)
    optimizer.step()


def _array(tensor: Any) -> Any:
    return tensor.detach().numpy()
