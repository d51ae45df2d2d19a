"""Stable-Baselines3's PPO as a training configures it."""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

from pathlib import Path
from typing import Any, cast

import torch
from gymnasium import spaces
from stable_baselines3 import PPO

from avrgym.learning.configuration import LOG_FOLDER, TrainingConfiguration
from avrgym.tasks.constants import EPISODE_STEPS

OBSERVATION_CLIP = 5.0


def make_ppo(configuration: TrainingConfiguration, observation_size: int, action_size: int, out: Path) -> PPO:
    """A model that is given its episodes."""
    model = PPO("MlpPolicy", None, _init_setup_model=False, **_settings(configuration, out))  # type: ignore[arg-type]
    model.observation_space = spaces.Box(-OBSERVATION_CLIP, OBSERVATION_CLIP, (observation_size,))
    model.action_space = spaces.Box(-1.0, 1.0, (action_size,))
    model.n_envs = configuration.worlds
    model._setup_model()  # pyright: ignore[reportPrivateUsage]  # as its own load() does
    model.policy.log_std.requires_grad_(False)
    return model


def steps_of(model: PPO) -> int:
    """Environment steps that a model was trained for."""
    return cast(int, model.num_timesteps)


def begin_update(model: PPO, configuration: TrainingConfiguration) -> None:
    """Set how far actions are drawn from their mean in the next update."""
    with torch.no_grad():
        model.policy.log_std.fill_(configuration.log_std_at(steps_of(model)))


def free_actor(model: PPO, configuration: TrainingConfiguration) -> None:
    """Let the actor learn too, when the critic knows what it is worth."""
    learns = configuration.actor_learns_at(steps_of(model))
    model.policy.mlp_extractor.policy_net.requires_grad_(learns)
    model.policy.action_net.requires_grad_(learns)


def _settings(configuration: TrainingConfiguration, out: Path) -> dict[str, Any]:

    def rate(remaining: float) -> float:
        return configuration.learning_rate_at((1.0 - remaining) * configuration.steps)

    torch.set_num_threads(1)  # so small a network gains nothing from more, and its sums keep their order
    return {
        "learning_rate": rate,
        "n_steps": EPISODE_STEPS,
        "batch_size": configuration.minibatch,
        "n_epochs": configuration.epochs,
        "gamma": configuration.discount,
        "gae_lambda": configuration.gae_lambda,
        "clip_range": configuration.clip_range,
        "policy_kwargs": {"net_arch": list(configuration.hidden), "activation_fn": torch.nn.Tanh},
        "tensorboard_log": str(out / LOG_FOLDER),
        "seed": configuration.seed,
        "device": "cpu",
    }
