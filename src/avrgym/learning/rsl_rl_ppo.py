"""PPO on the device of the worlds, with RSL-RL (ETH Zurich and NVIDIA).

Network, optimizer and schedules are those of Stable-Baselines3. Initial weights, imitation, checkpoints and policy
files are therefore the same as on the host. RSL-RL stores episodes and minibatches on the device. Two details differ
from training on the host. The gradients of actor and critic are clipped separately. All minibatches have the same size,
close to ``batch_size``.

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

from avrgym.learning.configuration import FeedforwardConfiguration
from avrgym.learning.ppo import count_trained_timesteps
from avrgym.system import random_streams

OBSERVATION_GROUP_NAME = "policy"
"""Name of the observation group in RSL-RL. Actor and critic both use this group."""


class _Libraries(NamedTuple):
    algorithms: Any
    models: Any
    storage: Any
    tensordict: Any


def import_rsl_rl() -> _Libraries:
    """Import RSL-RL's modules and return them.

    Raises:
        RuntimeError: if the extra ``gpu`` is not installed.
    """
    names = (*(f"rsl_rl.{name}" for name in _Libraries._fields[:-1]), "tensordict")
    try:
        return _Libraries(*map(import_module, names))
    except ModuleNotFoundError as error:
        raise RuntimeError(
            f"training on the engine warp needs {error.name}; run `pip install avrgym[train,gpu]`"
        ) from error


class DevicePPO:
    """A ``ppo.PolicyUpdateFunction`` on a device.

    The seed of the training run and the number of past steps determine the minibatches. A checkpoint therefore contains
    no random state of a device.
    """

    def __init__(self, configuration: FeedforwardConfiguration) -> None:
        self._configuration = configuration
        self._libraries = import_rsl_rl()
        self._algorithm: Any = None

    def __call__(self, model: PPO, observations: Tensor, actions: Tensor, rewards: Tensor) -> None:
        """Make a PPO update. The first call moves the model to the device of the episodes."""
        if self._algorithm is None:
            _move(model, observations.device)
            self._algorithm = self._algorithm_of(model, observations[0])
        policy, algorithm = model.policy, self._algorithm
        policy.set_training_mode(True)
        model._update_learning_rate(policy.optimizer)  # pyright: ignore[reportPrivateUsage]
        with torch.no_grad():
            self._store(observations[:-1], actions, rewards)
            algorithm.compute_returns(self._named(observations[-1]))
        torch.manual_seed(
            random_streams.derive_device_minibatch_seed(
                self._configuration.seed, count_trained_timesteps(model)
            )
        )
        losses = [algorithm.update() for _ in range(model.n_epochs)]
        model._n_updates += model.n_epochs  # pyright: ignore[reportPrivateUsage]
        for ours, theirs in {"policy_gradient_loss": "surrogate", "value_loss": "value"}.items():
            model.logger.record(f"train/{ours}", float(np.mean([each[theirs] for each in losses])))

    def _algorithm_of(self, model: PPO, first: Tensor) -> Any:
        """Create and return RSL-RL's PPO with the model's network and optimizer. ``first`` are observations (N, O)."""
        of, configuration, policy = self._libraries, self._configuration, model.policy
        torso = policy.mlp_extractor
        noise = {"class_name": "GaussianDistribution", "std_type": "log", "learn_std": False}
        size = policy.log_std.shape[0]
        actor = self._model_of(first, size, [*torso.policy_net, policy.action_net], noise)
        actor.distribution.log_std_param = policy.log_std
        critic = self._model_of(first, 1, [*torso.value_net, policy.value_net], None)
        device = str(first.device)
        episodes = of.storage.RolloutStorage(
            "rl", len(first), model.n_steps, self._named(first), [size], device
        )
        algorithm = of.algorithms.PPO(
            actor,
            critic,
            episodes,
            num_learning_epochs=1,  # called once per epoch, for a new order of the steps
            num_mini_batches=max(1, round(configuration.steps_per_update / configuration.batch_size)),
            clip_param=configuration.clip_range,
            gamma=configuration.gamma,
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

    def _model_of(
        self, first: Tensor, outputs: int, layers: list[nn.Module], noise: dict[str, Any] | None
    ) -> Any:
        """Create and return a model of RSL-RL (actor or critic) with these layers and number of outputs."""
        net = self._libraries.models.MLPModel(
            self._named(first),
            {OBSERVATION_GROUP_NAME: [OBSERVATION_GROUP_NAME]},
            OBSERVATION_GROUP_NAME,
            outputs,
            hidden_dims=list(self._configuration.net_arch),
            activation="tanh",
            distribution_cfg=noise,
        )
        net.mlp = nn.Sequential(*layers)
        return net

    def _named(self, observations: Tensor) -> Any:
        return self._libraries.tensordict.TensorDict(
            {OBSERVATION_GROUP_NAME: observations}, batch_size=[len(observations)], device=observations.device
        )

    def _store(self, observations: Tensor, actions: Tensor, rewards: Tensor) -> None:
        """Store episodes in the algorithm, with the critic's values and the actions' log-probabilities.

        Episodes are truncated, not terminated: the last step is bootstrapped with the critic's value.
        """
        algorithm = self._algorithm
        algorithm.storage.clear()
        not_done = torch.zeros_like(rewards[0], dtype=torch.bool)
        for seen, done, reward in zip(observations, actions, rewards, strict=True):
            named, now = self._named(seen), algorithm.transition
            algorithm.actor(named, stochastic_output=True)
            now.observations, now.actions, now.rewards, now.dones = named, done, reward, not_done
            now.values = algorithm.critic(named)
            now.actions_log_prob = algorithm.actor.get_output_log_prob(done)
            now.distribution_params = algorithm.actor.output_distribution_params
            algorithm.storage.add_transition(now)
            now.clear()


def _move(model: PPO, device: torch.device) -> None:
    """Move a model's network and its optimizer's state to a device."""
    model.policy.to(device)
    optimizer = model.policy.optimizer
    optimizer.load_state_dict(optimizer.state_dict())  # moves it to the parameters' device
