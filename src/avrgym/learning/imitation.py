"""Learning from an expert before PPO: dataset aggregation (Ross, Gordon, Bagnell, AISTATS 2011, algorithm 3.1).

The policy drives ever more of the worlds, the expert says at every step what it would do there, and the policy
learns to do the same from all that was gathered so far.
"""

# Stable-Baselines3's attributes and PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar
from zipfile import BadZipFile

import numpy as np
import torch
from stable_baselines3 import PPO
from torch import Tensor

from avrgym.array_types import BoolArray, Float32Array
from avrgym.learning.stable_baselines import Normaliser
from avrgym.tasks.constants import EPISODE_STEPS

EXPERT_SHARE = 0.8
"""The expert drives all worlds in the first round, and in each later one this share of those of the round before."""
BATCH = 1024
EPOCHS, LAST_EPOCHS = 10, 100
"""How often all that was gathered is gone through at the end of a round and of the last."""
LEARNING_RATE, FALL, LAST_FALL = 1e-3, 0.3, 0.01
"""The learning rate, and the share of it that is left at the end of a round and of the last."""

Finished = list[tuple[float, bool]]
"""Return and success of episodes that the policy drove."""
Hear = Callable[[Finished], object]


def imitate(
    model: PPO,
    normaliser: Normaliser,
    worlds: int,
    rounds: int,
    seed: int,
    shown: Path,
    gather: "Gather",
    hear: Hear,
) -> None:
    """Bring a model's actor to do as the expert does.

    What the model has done of it, by its number of steps, is not done again: it goes on to the same weights.

    Args:
        model: not yet begun, or as it was after a round.
        normaliser: of its observations; ``gather`` fits it on the way.
        worlds: how many.
        rounds: how many in all; each is an episode in every world.
        seed: of who drives which world, and of the minibatches.
        shown: a folder for what the expert shows, a file for each round; it must hold those of the rounds done.
        gather: makes the episodes of a round.
        hear: told after each round return and success of each episode that the policy drove.

    Raises:
        ValueError: for a file that is missing or damaged.
    """
    done = model.num_timesteps // (worlds * EPISODE_STEPS)
    shown.mkdir(exist_ok=True)
    files = [shown / f"round_{number:04}.npz" for number in range(rounds)]
    gathered = [load_shown(file, Shown) for file in files[:done]]
    for number in range(done, rounds):
        random = np.random.default_rng([seed, 2, number])
        by_expert = random.random(worlds) < EXPERT_SHARE**number
        round_shown, finished = gather(by_expert)
        np.savez(files[number], **asdict(round_shown))
        gathered.append(round_shown)
        _fit(model, normaliser, gathered, random, last=number == rounds - 1)
        model.num_timesteps += len(round_shown.observations)
        hear(finished)


@dataclass(frozen=True)
class Shown:
    """What an expert showed: observations (S, O) and its actions (S, J), or (T, N, ...), single precision."""

    observations: Float32Array
    actions: Float32Array


AnyShown = TypeVar("AnyShown", bound=Shown)
Gather = Callable[[BoolArray], tuple[Shown, Finished]]
"""From which worlds (N,) the expert drives to what it showed in an episode of each."""


def load_shown(file: Path, kind: type[AnyShown]) -> AnyShown:
    """What a file keeps of a round.

    Raises:
        ValueError: for a file that is missing or damaged.
    """
    try:
        with np.load(file) as arrays:
            return kind(**arrays)
    except (OSError, ValueError, TypeError, BadZipFile) as error:
        raise ValueError(f"{file}: not what an expert showed ({error})") from error


def _fit(
    model: PPO, normaliser: Normaliser, gathered: list[Shown], random: np.random.Generator, *, last: bool
) -> None:
    """Least squares over all that was gathered, at a rate that falls; in the last round longer."""
    seen = np.concatenate([shown.observations for shown in gathered])
    observations = torch.as_tensor(np.asarray(normaliser.normalize_obs(seen)), dtype=torch.float32)
    actions = torch.as_tensor(np.concatenate([shown.actions for shown in gathered]))
    actor = model.policy
    parameters = [*actor.mlp_extractor.policy_net.parameters(), *actor.action_net.parameters()]
    optimizer = torch.optim.Adam(parameters, LEARNING_RATE)
    epochs, fall = (LAST_EPOCHS, LAST_FALL) if last else (EPOCHS, FALL)
    steps = -(-epochs * len(seen) // BATCH)
    rate = torch.optim.lr_scheduler.ExponentialLR(optimizer, fall ** (1.0 / steps))
    for _ in range(steps):
        rows = torch.as_tensor(random.integers(len(seen), size=BATCH))
        loss = torch.nn.functional.mse_loss(_mean_actions(model, observations[rows]), actions[rows])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        rate.step()


def _mean_actions(model: PPO, observations: Tensor) -> Tensor:
    return model.policy.action_net(model.policy.mlp_extractor.forward_actor(observations))
