"""Proximal policy optimisation of a recurrent policy with a recurrent critic.

Loss: Schulman et al., "Proximal policy optimization algorithms", 2017, equation 7. Advantages: Schulman et al., ICLR
2016, equation 16. Truncated backpropagation through time: Williams and Peng, Neural Computation 2, 1990.
"""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from avrgym.learning.hyperparameters import RECURRENT_HYPERPARAMETERS
from avrgym.learning.recurrent_network import (
    RecurrentNetwork,
    fit_network,
    make_bptt_windows,
    take_gradient_step,
)


class RecurrentPPO:
    """PPO of a recurrent network, with whole episodes in which the network controlled the robot. The hyperparameters
    are ``RECURRENT_HYPERPARAMETERS``."""

    def __init__(self, network: RecurrentNetwork, observation_size: int) -> None:
        """Create a critic with random weights from PyTorch's global random stream, and both optimizers."""
        self._network = network
        self._critic = RecurrentNetwork(
            observation_size,
            RECURRENT_HYPERPARAMETERS.critic_memory_size,
            RECURRENT_HYPERPARAMETERS.critic_net_arch,
            1,
        )
        self._optimizer = torch.optim.Adam(network.parameters(), eps=1e-5)
        self._critic_optimizer = torch.optim.Adam(
            self._critic.parameters(), RECURRENT_HYPERPARAMETERS.critic_learning_rate
        )

    def checkpoint_state(self) -> dict[str, Any]:
        """Returns the state of the critic and of both optimizers (policy and critic), for a checkpoint."""
        return {name: part.state_dict() for name, part in self._parts.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the critic and both optimizers from the result of ``state``."""
        for name, part in self._parts.items():
            part.load_state_dict(state[name])

    @property
    def _parts(self) -> dict[str, Any]:
        return {
            "critic": self._critic,
            "optimizer": self._optimizer,
            "critic_optimizer": self._critic_optimizer,
        }

    def update(
        self,
        observations: Tensor,
        actions: Tensor,
        rewards: Tensor,
        action_std: float,
        random: np.random.Generator,
        learning_rate: float,
    ) -> None:
        """Train policy and critic with the episodes of an update.

        Args:
            observations: normalised, (T + 1, N, O). The last observation is the one after the last step.
            actions: with exploration noise, before clipping, (T, N, A).
            rewards: scaled, (T, N).
            action_std: standard deviation of the actions.
            random: random stream of the minibatches.
            learning_rate: learning rate of the policy. If it is 0, only the critic learns.
        """
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate
        with torch.no_grad():
            values = self._critic(observations)[0][..., 0]
            old_log_prob = _log_prob(self._network(observations[:-1])[0], actions, action_std)
        advantage = compute_generalised_advantages(rewards, values)
        returns = advantage + values[:-1]
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        learns = learning_rate > 0.0
        worlds = rewards.shape[1]
        minibatches = min(
            -(-worlds // RECURRENT_HYPERPARAMETERS.minibatch_episodes),
            RECURRENT_HYPERPARAMETERS.max_minibatches,
        )
        for _ in range(RECURRENT_HYPERPARAMETERS.n_epochs):
            divergences: list[float] = []
            for columns in np.array_split(random.permutation(worlds), minibatches):
                chosen = torch.as_tensor(columns)
                observed, targets = observations[:-1, chosen], [returns[:, chosen, None]]
                fit_network(
                    self._critic,
                    self._critic_optimizer,
                    observed,
                    mse_loss,
                    targets,
                    RECURRENT_HYPERPARAMETERS.max_grad_norm,
                )
                if learns:
                    divergences += self._fit_policy(
                        observed,
                        actions[:, chosen],
                        old_log_prob[:, chosen],
                        advantage[:, chosen],
                        action_std,
                    )
            learns = learns and float(np.mean(divergences)) <= RECURRENT_HYPERPARAMETERS.target_kl

    def _fit_policy(
        self,
        observations: Tensor,
        actions: Tensor,
        old_log_prob: Tensor,
        advantage: Tensor,
        action_std: float,
    ) -> list[float]:
        """Make the policy's gradient steps. Returns the approximate Kullback-Leibler divergence of each window."""
        memory, divergences, clip_range = None, list[float](), RECURRENT_HYPERPARAMETERS.clip_range
        for window in make_bptt_windows(len(actions)):
            means, memory = self._network(observations[window], memory)
            log_ratio = _log_prob(means, actions[window], action_std) - old_log_prob[window]
            ratio = log_ratio.exp()
            clipped = ratio.clamp(1.0 - clip_range, 1.0 + clip_range)
            loss = -torch.minimum(ratio * advantage[window], clipped * advantage[window]).mean()
            take_gradient_step(self._optimizer, self._network, loss, RECURRENT_HYPERPARAMETERS.max_grad_norm)
            memory = memory.detach()
            divergences.append(float((ratio - 1.0 - log_ratio).mean().detach()))
        return divergences


def compute_generalised_advantages(
    rewards: Tensor,
    values: Tensor,
    gamma: float = RECURRENT_HYPERPARAMETERS.gamma,
    gae_lambda: float = RECURRENT_HYPERPARAMETERS.gae_lambda,
) -> Tensor:
    """Returns generalised advantage estimates (T, N) of truncated episodes.

    ``rewards`` has shape (T, N), ``values`` (T + 1, N). The last value estimates the return after the last step.
    """
    errors = rewards + gamma * values[1:] - values[:-1]
    estimates = torch.empty_like(errors)
    later = torch.zeros_like(errors[0])
    for number in reversed(range(len(errors))):
        later = errors[number] + gamma * gae_lambda * later
        estimates[number] = later
    return estimates


def _log_prob(means: Tensor, actions: Tensor, action_std: float) -> Tensor:
    """Returns the log-probability (T, N) of the actions, without its constant term."""
    return -0.5 * (((actions - means) / action_std) ** 2).sum(dim=-1)
