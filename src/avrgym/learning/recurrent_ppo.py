"""Proximal policy optimisation of a policy that remembers, by a critic that remembers, too.

Schulman et al., "Proximal policy optimization algorithms", 2017, equation 7; advantages by Schulman et al., ICLR 2016,
equation 16. Gradients go back through ``WINDOW`` control steps at most, as in imitation.
"""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from avrgym.learning.recurrent import RecurrentNetwork, fit, step, windows

DISCOUNT, GAE_LAMBDA = 0.99, 0.95
CLIP_RANGE = 0.2
EPOCHS = 4
SEQUENCES, MOST_MINIBATCHES = 16, 8
"""An update's episodes are cut into minibatches of so many, or into so many where that would make more."""
FARTHEST = 0.03
"""An update ends when the policy has gone so far from where it began (mean Kullback-Leibler divergence of an epoch)."""
CRITIC_MEMORY, CRITIC_HIDDEN, CRITIC_LEARNING_RATE = 64, (64,), 1e-3
GRADIENT_NORM = 0.5
"""Gradients longer than this are shortened to it."""


class RecurrentPPO:
    """Improves a network that remembers from whole episodes of its own."""

    def __init__(self, network: RecurrentNetwork, observation_size: int) -> None:
        """Draw the critic's weights from PyTorch's random stream."""
        self._network = network
        self._critic = RecurrentNetwork(observation_size, CRITIC_MEMORY, CRITIC_HIDDEN, 1)
        self._optimizer = torch.optim.Adam(network.parameters(), eps=1e-5)
        self._critic_optimizer = torch.optim.Adam(self._critic.parameters(), CRITIC_LEARNING_RATE)

    def state(self) -> dict[str, Any]:
        """What it goes on from, beside the network."""
        return {name: part.state_dict() for name, part in self._parts.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        for name, part in self._parts.items():
            part.load_state_dict(state[name])

    @property
    def _parts(self) -> dict[str, Any]:
        return {
            "critic": self._critic,
            "optimizer": self._optimizer,
            "critic_optimizer": self._critic_optimizer,
        }

    def improve(
        self,
        observations: Tensor,
        actions: Tensor,
        rewards: Tensor,
        deviation: float,
        random: np.random.Generator,
        learning_rate: float,
    ) -> None:
        """Learn from an update's episodes.

        Args:
            observations: normalised, (T + 1, N, O), the last of them after the last step.
            actions: drawn about the network's means, before they are clipped, (T, N, A).
            rewards: (T, N), scaled.
            deviation: of the actions from their means.
            random: chooses minibatches.
            learning_rate: of the policy; with 0 only the critic learns.
        """
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate
        with torch.no_grad():
            values = self._critic(observations)[0][..., 0]
            before = _log_chance(self._network(observations[:-1])[0], actions, deviation)
        gained = advantages(rewards, values)
        returns = gained + values[:-1]
        gained = (gained - gained.mean()) / (gained.std() + 1e-8)
        learns = learning_rate > 0.0
        worlds = rewards.shape[1]
        minibatches = min(-(-worlds // SEQUENCES), MOST_MINIBATCHES)
        for _ in range(EPOCHS):
            far: list[float] = []
            for columns in np.array_split(random.permutation(worlds), minibatches):
                chosen = torch.as_tensor(columns)
                seen, wanted = observations[:-1, chosen], returns[:, chosen, None]
                fit(self._critic, self._critic_optimizer, seen, mse_loss, [wanted], GRADIENT_NORM)
                if learns:
                    far += self._fit_policy(
                        seen,
                        actions[:, chosen],
                        before[:, chosen],
                        gained[:, chosen],
                        deviation,
                    )
            learns = learns and float(np.mean(far)) <= FARTHEST

    def _fit_policy(
        self, observations: Tensor, actions: Tensor, before: Tensor, gained: Tensor, deviation: float
    ) -> list[float]:
        """How far the policy had gone in each window."""
        remembered, far = None, list[float]()
        for window in windows():
            means, remembered = self._network(observations[window], remembered)
            change = _log_chance(means, actions[window], deviation) - before[window]
            ratio = change.exp()
            clipped = ratio.clamp(1.0 - CLIP_RANGE, 1.0 + CLIP_RANGE)
            loss = -torch.minimum(ratio * gained[window], clipped * gained[window]).mean()
            step(self._optimizer, self._network, loss, GRADIENT_NORM)
            remembered = remembered.detach()
            far.append(float((ratio - 1.0 - change).mean().detach()))
        return far


def advantages(
    rewards: Tensor, values: Tensor, discount: float = DISCOUNT, gae_lambda: float = GAE_LAMBDA
) -> Tensor:
    """Generalised advantage estimates (T, N) of episodes that were cut off.

    ``rewards`` are (T, N), ``values`` (T + 1, N): what may follow the last step counts with the last of them.
    """
    errors = rewards + discount * values[1:] - values[:-1]
    gained = torch.empty_like(errors)
    later = torch.zeros_like(errors[0])
    for number in reversed(range(len(errors))):
        later = errors[number] + discount * gae_lambda * later
        gained[number] = later
    return gained


def _log_chance(means: Tensor, actions: Tensor, deviation: float) -> Tensor:
    """Logarithm of the actions' chance, up to a constant, (T, N)."""
    return -0.5 * (((actions - means) / deviation) ** 2).sum(dim=-1)
