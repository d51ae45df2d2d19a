"""From a model that learns to a policy that needs no PyTorch."""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

import subprocess
from functools import cache
from math import exp
from pathlib import Path
from typing import Any, cast

import torch
from stable_baselines3 import PPO

from avrgym.learning.configuration import TrainingConfiguration
from avrgym.learning.stable_baselines import Normaliser
from avrgym.networks.policy import HumanRole, Policy, PolicyMetadata
from avrgym.people.populations import population_label
from avrgym.tasks.registry import plugins_of

CURVE_POINTS = 100


def export_policy(
    model: PPO,
    normaliser: Normaliser,
    configuration: TrainingConfiguration,
    seconds: float,
    curve: list[tuple[int, float, float]],
    role: HumanRole | None = None,
) -> Policy:
    """The actor of a PPO model with its observation normaliser and the chance of this stage of training.

    ``seconds`` it was trained for; of the ``curve`` a hundred points are kept; ``role`` is that of a human's.
    """
    steps = cast(int, model.num_timesteps)
    beside_human = ", trained beside it" if configuration.pairing is not None and role is None else ""
    actor = model.policy
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
        action_deviation=exp(configuration.log_std_at(steps)),
        metadata=PolicyMetadata(
            environment=configuration.environment,
            people=population_label(configuration.people) + beside_human,
            impairment=configuration.impairment,
            steps=steps,
            seed=configuration.seed,
            git_commit=git_commit(),
            seconds=round(seconds, 1),
            curve=thinned(curve),
            human=role,
            plugins=plugins_of(configuration.environment),
        ),
    )


def thinned(curve: list[tuple[int, float, float]]) -> list[tuple[int, float, float]]:
    """A curve with at most ``CURVE_POINTS`` of its points, the last among them."""
    stride = -(-len(curve) // CURVE_POINTS) or 1
    return curve[::-stride][::-1]


@cache
def git_commit() -> str:
    """The commit that this code is of; empty where nobody knows."""
    found = subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, cwd=Path(__file__).parent, check=False
    )
    return found.stdout.strip()
