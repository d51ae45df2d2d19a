"""PPO of feed-forward policies with Stable-Baselines3. The training data are whole episodes from ``rollouts``."""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable
from math import exp
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO

from avrgym.array_types import Float32Array
from avrgym.learning.configuration import FeedforwardConfiguration
from avrgym.learning.normaliser import OBSERVATION_CLIP, Normaliser, ObservationScales
from avrgym.learning.rollouts import Rollout
from avrgym.networks.policy import Policy, PolicyMetadata

TENSORBOARD_FOLDER = "tensorboard"
PolicyUpdateFunction = Callable[[PPO, Any, Any, Any], object]
"""Function that performs a PPO update of a model with whole episodes. All episodes end at the time limit.

Arguments: the model, normalised observations (T + 1, N, O), actions (T, N, A) and scaled rewards (T, N).
"""


class Agent(NamedTuple):
    """An agent in training: its PPO model, and the normaliser of its observations and rewards."""

    model: PPO
    normaliser: Normaliser


def make_agent(
    configuration: FeedforwardConfiguration, observation: ObservationScales, action_size: int, out: Path
) -> Agent:
    """Create and return an untrained agent for observations of a given size and ``action_size`` actions."""
    return Agent(
        make_ppo(configuration, observation.size, action_size, out),
        Normaliser(observation, configuration.gamma),
    )


def make_ppo(
    configuration: FeedforwardConfiguration, observation_size: int, action_size: int, out: Path
) -> PPO:
    """Create and return an untrained PPO model of Stable-Baselines3, without an environment."""

    def learning_rate(remaining: float) -> float:
        return configuration.compute_learning_rate((1.0 - remaining) * configuration.steps)

    torch.set_num_threads(
        1
    )  # more threads are not faster with small networks, and would change the order of sums
    model = PPO(
        "MlpPolicy",
        None,  # type: ignore[arg-type]
        learning_rate=learning_rate,
        n_steps=configuration.episode_steps,
        batch_size=configuration.batch_size,
        n_epochs=configuration.n_epochs,
        gamma=configuration.gamma,
        gae_lambda=configuration.gae_lambda,
        clip_range=configuration.clip_range,
        ent_coef=configuration.ent_coef,
        vf_coef=configuration.vf_coef,
        max_grad_norm=configuration.max_grad_norm,
        policy_kwargs={"net_arch": list(configuration.net_arch), "activation_fn": torch.nn.Tanh},
        tensorboard_log=str(out / TENSORBOARD_FOLDER),
        seed=configuration.seed,
        device="cpu",
        _init_setup_model=False,
    )
    model.observation_space = spaces.Box(-OBSERVATION_CLIP, OBSERVATION_CLIP, (observation_size,))
    model.action_space = spaces.Box(-1.0, 1.0, (action_size,))
    model.n_envs = configuration.num_envs
    model._setup_model()  # pyright: ignore[reportPrivateUsage]  # as its own load() does
    model.policy.log_std.requires_grad_(False)
    return model


def count_trained_timesteps(model: PPO) -> int:
    """Returns the number of environment steps for which a model was trained."""
    return cast(int, model.num_timesteps)


def set_log_std(model: PPO, configuration: FeedforwardConfiguration) -> None:
    """Set the exploration noise (``log_std``) of a model for its next update."""
    with torch.no_grad():
        model.policy.log_std.fill_(configuration.compute_log_std(count_trained_timesteps(model)))


def set_actor_trainable(model: PPO, configuration: FeedforwardConfiguration) -> None:
    """Freeze the actor if only the critic learns (first updates after imitation); otherwise unfreeze it."""
    learns = configuration.is_actor_learning(count_trained_timesteps(model))
    model.policy.mlp_extractor.policy_net.requires_grad_(learns)
    model.policy.action_net.requires_grad_(learns)


def update_agent(agent: Agent, rollout: Rollout, last: int, update: PolicyUpdateFunction) -> None:
    """Train an agent with the episodes of an update. ``last`` is the total number of steps of the training run."""
    model, normaliser = agent
    rewards = normaliser.normalize_rewards(rollout)
    observations = normaliser.normalize_obs(rollout.observations)
    model._update_current_progress_remaining(count_trained_timesteps(model), last)  # pyright: ignore[reportPrivateUsage]
    update(model, observations, rollout.actions, rewards)
    normaliser.update_observations(rollout)


def update_ppo_on_host(model: PPO, observations: Any, actions: Any, rewards: Any) -> None:
    """Perform a PPO update with Stable-Baselines3 on the host (a ``PolicyUpdateFunction``)."""
    _fill(model, observations, actions, rewards)
    model.train()


def _fill(model: PPO, observations: Float32Array, actions: Float32Array, rewards: Float32Array) -> None:
    """Fill a model's rollout buffer.

    Episodes are truncated, not terminated: the last step is bootstrapped with the critic's value.
    """
    buffer, policy = model.rollout_buffer, model.policy
    policy.set_training_mode(False)
    buffer.reset()
    count = rewards.shape[1]
    seen, done = torch.as_tensor(observations), torch.as_tensor(actions)
    with torch.no_grad():
        last_values: Any = policy.predict_values(seen[-1])
        for number, reward in enumerate(rewards):
            value, log_probability, _ = policy.evaluate_actions(seen[number], done[number])
            if number == len(rewards) - 1:
                reward = reward + model.gamma * last_values.numpy().ravel()
            starts = np.full(count, number == 0)
            buffer.add(observations[number], actions[number], reward, starts, value, log_probability)
    truncated: Any = np.ones(count, dtype=bool)
    buffer.compute_returns_and_advantage(last_values, truncated)


def make_agent_state(agent: Agent) -> dict[str, Any]:
    """Returns the state of an agent for a checkpoint: network, optimizer and normaliser."""
    model, normaliser = agent
    return {
        "steps": model.num_timesteps,
        "updates": model._n_updates,  # pyright: ignore[reportPrivateUsage]
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        **normaliser.checkpoint_state(),
    }


def restore_agent(agent: Agent, state: dict[str, Any]) -> None:
    """Restore network, optimizer and normaliser of an agent from the result of ``make_agent_state``."""
    model, normaliser = agent
    model.policy.load_state_dict(state["policy"])
    model.policy.optimizer.load_state_dict(state["optimizer"])
    model.num_timesteps = state["steps"]
    model._n_updates = state["updates"]  # pyright: ignore[reportPrivateUsage]
    normaliser.restore(state)


def export_policy(agent: Agent, log_std: float, metadata: PolicyMetadata) -> Policy:
    """Convert the actor and its normaliser to a policy that does not need PyTorch. Returns the policy."""
    actor, normaliser = agent.model.policy, agent.normaliser
    layers: list[Any] = [
        layer for layer in actor.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)
    ]
    layers.append(actor.action_net)
    return Policy(
        weights=tuple(layer.weight.detach().cpu().numpy().T for layer in layers),
        biases=tuple(layer.bias.detach().cpu().numpy() for layer in layers),
        observation_mean=normaliser.obs_rms.mean,
        observation_variance=normaliser.obs_rms.var,
        observation_clip=normaliser.clip_obs,
        observation_epsilon=normaliser.epsilon,
        action_std=exp(log_std),
        metadata=metadata,
    )
