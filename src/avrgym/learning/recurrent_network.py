"""A recurrent network in PyTorch, for the training of a ``Policy`` with memory."""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn

from avrgym.learning.hyperparameters import RECURRENT_HYPERPARAMETERS
from avrgym.learning.normaliser import Normaliser
from avrgym.networks.layers import GatedRecurrentUnit
from avrgym.policies.trained_policies import Policy, PolicyMetadata


class RecurrentNetwork(nn.Module):
    """A gated recurrent unit (GRU), then tanh layers. The inputs of the first layer are observation and memory."""

    def __init__(
        self, observation_size: int, memory_size: int, net_arch: tuple[int, ...], outputs: int
    ) -> None:
        """Create a network with random weights from PyTorch's global random stream."""
        super().__init__()
        self.memory = nn.GRU(observation_size, memory_size)
        sizes = [observation_size + memory_size, *net_arch, outputs]
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(sizes))

    @classmethod
    def from_policy(cls, policy: Policy) -> "RecurrentNetwork":
        """Create and return a network with the weights of a recurrent policy, in single precision."""
        memory = policy.memory
        assert memory is not None
        net_arch = tuple(len(bias) for bias in policy.biases[:-1])
        network = cls(policy.observation_size, memory.num_units, net_arch, policy.action_size)
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

    def forward(self, observations: Tensor, memory: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Returns outputs (T, n, A) for normalised observations (T, n, O), and the memory (1, n, U) after the last
        step."""
        remembered, last = self.memory(observations, memory)
        rows = torch.cat([observations, remembered], dim=-1)
        for layer in self.layers[:-1]:
            rows = torch.tanh(layer(rows))
        return self.layers[-1](rows), last

    def to_policy(self, normaliser: Normaliser, metadata: PolicyMetadata, action_std: float = 0.0) -> Policy:
        """Convert the network and its normaliser to a policy that does not need PyTorch. Returns the policy."""
        unit, layers = self.memory, [*self.layers]
        return Policy(
            weights=tuple(_array(layer.weight).T for layer in layers),
            biases=tuple(_array(layer.bias) for layer in layers),
            observation_mean=normaliser.obs_rms.mean,
            observation_variance=normaliser.obs_rms.var,
            observation_clip=normaliser.clip_obs,
            observation_epsilon=normaliser.epsilon,
            action_std=action_std,
            metadata=metadata,
            memory=GatedRecurrentUnit(
                input_weight=_array(unit.weight_ih_l0).T,
                input_bias=_array(unit.bias_ih_l0),
                hidden_weight=_array(unit.weight_hh_l0).T,
                hidden_bias=_array(unit.bias_hh_l0),
            ),
        )


def make_bptt_windows(episode_steps: int) -> Iterator[slice]:
    """Returns the windows (slices) of an episode for truncated backpropagation through time."""
    steps = RECURRENT_HYPERPARAMETERS.bptt_steps
    return (slice(first, min(first + steps, episode_steps)) for first in range(0, episode_steps, steps))


def fit_network(
    network: RecurrentNetwork,
    optimizer: torch.optim.Optimizer,
    observations: Tensor,
    loss: Callable[..., Tensor],
    targets: Sequence[Tensor],
    max_grad_norm: float,
) -> None:
    """Fit a network to whole episodes with ``observations`` (T, n, O): one gradient step per window.

    The arguments of ``loss`` are the outputs of a window (t, n, A) and the same window of each target (T, n, ...).
    """
    memory = None
    for window in make_bptt_windows(len(targets[0])):
        outputs, memory = network(observations[window], memory)
        take_gradient_step(
            optimizer, network, loss(outputs, *(each[window] for each in targets)), max_grad_norm
        )
        memory = memory.detach()


def take_gradient_step(
    optimizer: torch.optim.Optimizer, network: nn.Module, loss: Tensor, max_grad_norm: float
) -> None:
    """Make one step of the optimizer. The norm of the gradient is clipped to ``max_grad_norm``."""
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), max_grad_norm)
    optimizer.step()


def _array(tensor: Any) -> Any:
    return tensor.detach().numpy()
