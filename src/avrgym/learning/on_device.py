"""PPO where the worlds are: RSL-RL (ETH Zurich and NVIDIA) improves a model on the device that its episodes lie on.

Network, optimizer, and how its rate and chance fall are Stable-Baselines3's, so that initial weights, imitation,
checkpoints and policy files are those of any other training. What RSL-RL brings is PPO whose episodes and minibatches
never leave the device. Two things differ: the gradients of actor and critic are clipped each by its own norm, and
minibatches are of equal size, the nearest to what was asked for that leaves nearly no step over.

Needs the extra ``gpu``.
"""

# Stable-Baselines3's attributes and RSL-RL: their types are known only in part.
# pyright: reportUnknownMemberType=false

from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3 import PPO
from torch import Tensor, nn

from avrgym.learning.configuration import TrainingConfiguration
from avrgym.learning.ppo import steps_of

MINIBATCH_STREAM = 6
"""Of the streams that are drawn from a training's seed, see ``rollouts.NOISE_STREAMS``."""
SEEN = "policy"
"""RSL-RL's name of the observations."""


class _Libraries(NamedTuple):
    algorithms: Any
    models: Any
    storage: Any
    tensordict: Any


def libraries() -> _Libraries:
    """What the extra brings for learning.

    Raises:
        RuntimeError: where it is not installed.
    """
    names = (*(f"rsl_rl.{name}" for name in _Libraries._fields[:-1]), "tensordict")
    try:
        return _Libraries(*map(import_module, names))
    except ModuleNotFoundError as error:
        raise RuntimeError(
            f"{error.name} is missing; `pip install avrgym[train,gpu]` brings what training on the engine warp needs"
        ) from error


class DeviceImprovement:
    """An ``updates.Improve`` for one training.

    Minibatches are drawn from the training's seed and its steps so far, so that a checkpoint need not keep where a
    device's random stream is.
    """

    def __init__(self, configuration: TrainingConfiguration) -> None:
        self._configuration = configuration
        self._libraries = libraries()
        self._algorithm: Any = None

    def __call__(self, model: PPO, observations: Tensor, actions: Tensor, rewards: Tensor) -> None:
        """Improve the model; it moves to where the episodes are."""
        if self._algorithm is None:
            _move(model, observations.device)
            self._algorithm = self._made(model, observations[0])
        policy, algorithm = model.policy, self._algorithm
        policy.set_training_mode(True)
        model._update_learning_rate(policy.optimizer)  # pyright: ignore[reportPrivateUsage]
        with torch.no_grad():
            self._store(observations[:-1], actions, rewards)
            algorithm.compute_returns(self._named(observations[-1]))
        stream = np.random.default_rng([self._configuration.seed, MINIBATCH_STREAM, steps_of(model)])
        torch.manual_seed(int(stream.integers(2**63)))
        losses = [algorithm.update() for _ in range(model.n_epochs)]
        model._n_updates += model.n_epochs  # pyright: ignore[reportPrivateUsage]
        for ours, theirs in {"policy_gradient_loss": "surrogate", "value_loss": "value"}.items():
            model.logger.record(f"train/{ours}", float(np.mean([each[theirs] for each in losses])))

    def _made(self, model: PPO, first: Tensor) -> Any:
        """RSL-RL's PPO over the model's own network and optimizer; ``first`` are observations (N, O)."""
        of, configuration, policy = self._libraries, self._configuration, model.policy
        torso = policy.mlp_extractor
        chance = {"class_name": "GaussianDistribution", "std_type": "log", "learn_std": False}
        size = policy.log_std.shape[0]
        actor = self._over(first, size, [*torso.policy_net, policy.action_net], chance)
        actor.distribution.log_std_param = policy.log_std
        critic = self._over(first, 1, [*torso.value_net, policy.value_net], None)
        device = str(first.device)
        episodes = of.storage.RolloutStorage(
            "rl", len(first), model.n_steps, self._named(first), [size], device
        )
        algorithm = of.algorithms.PPO(
            actor,
            critic,
            episodes,
            num_learning_epochs=1,  # each goes through the steps in an order of its own
            num_mini_batches=max(1, round(configuration.update_steps / configuration.minibatch)),
            clip_param=configuration.clip_range,
            gamma=configuration.discount,
            lam=configuration.gae_lambda,
            value_loss_coef=model.vf_coef,
            entropy_coef=model.ent_coef,
            max_grad_norm=model.max_grad_norm,
            use_clipped_value_loss=False,
            schedule="fixed",
            normalize_advantage_per_mini_batch=True,
            device=device,
        )
        algorithm.optimizer = policy.optimizer
        return algorithm

    def _over(
        self, first: Tensor, outputs: int, layers: list[nn.Module], chance: dict[str, Any] | None
    ) -> Any:
        """A model of RSL-RL's that computes with these layers."""
        net = self._libraries.models.MLPModel(
            self._named(first),
            {SEEN: [SEEN]},
            SEEN,
            outputs,
            hidden_dims=list(self._configuration.hidden),
            activation="tanh",
            distribution_cfg=chance,
        )
        net.mlp = nn.Sequential(*layers)
        return net

    def _named(self, observations: Tensor) -> Any:
        return self._libraries.tensordict.TensorDict(
            {SEEN: observations}, batch_size=[len(observations)], device=observations.device
        )

    def _store(self, observations: Tensor, actions: Tensor, rewards: Tensor) -> None:
        """Have the algorithm remember episodes, with what actor and critic make of them.

        No step ends one: what may follow the last counts with the critic's value.
        """
        algorithm = self._algorithm
        algorithm.storage.clear()
        going_on = torch.zeros_like(rewards[0], dtype=torch.bool)
        for seen, done, reward in zip(observations, actions, rewards, strict=True):
            named, now = self._named(seen), algorithm.transition
            algorithm.actor(named, stochastic_output=True)
            now.observations, now.actions, now.rewards, now.dones = named, done, reward, going_on
            now.values = algorithm.critic(named)
            now.actions_log_prob = algorithm.actor.get_output_log_prob(done)
            now.distribution_params = algorithm.actor.output_distribution_params
            algorithm.storage.add_transition(now)
            now.clear()


def _move(model: PPO, device: torch.device) -> None:
    """Bring a model's network and what its optimizer remembers to a device."""
    model.policy.to(device)
    optimizer = model.policy.optimizer
    optimizer.load_state_dict(optimizer.state_dict())  # which brings it to where the parameters are
