"""Learning from an expert before PPO: dataset aggregation (Ross, Gordon, Bagnell, AISTATS 2011, algorithm 3.1).

The policy drives ever more of the worlds, the expert says at every step what it would do there, and the policy
learns to do the same from all that was gathered so far.
"""

# Stable-Baselines3's attributes and PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast
from zipfile import BadZipFile

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor

from avrgym.learning.stable_baselines import finished_episodes, go_on_from, normaliser_of
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.known import EPISODE_STEPS

Array = NDArray[np.float64]

EXPERT_SHARE = 0.8
"""The expert drives all worlds in the first round, and in each later one this share of those of the round before."""
BATCH = 1024
EPOCHS, LAST_EPOCHS = 10, 100
"""How often all that was gathered is gone through at the end of a round and of the last."""
LEARNING_RATE, FALL, LAST_FALL = 1e-3, 0.3, 0.01
"""The learning rate, and the share of it that is left at the end of a round and of the last."""

Hear = Callable[[list[tuple[float, bool]]], object]


def imitate(model: PPO, episodes: Episodes, rounds: int, seed: int, shown: Path, hear: Hear) -> None:
    """Bring a model's actor to do as the expert does, and fit its normaliser of observations on the way.

    What the model has done of it, by its number of steps, is not done again: it goes on to the same weights.

    Args:
        model: over a ``VecNormalize`` of the environment whose worlds ``episodes`` are; not yet begun, or as it was
            after a round.
        episodes: the worlds.
        rounds: how many in all; each is an episode in every world.
        seed: of who drives which world, and of the minibatches.
        shown: a folder for what the expert shows, a file for each round; it must hold those of the rounds done.
        hear: told after each round return and success of each episode that the policy drove.

    Raises:
        ValueError: for a file that is missing or damaged.
    """
    normaliser = normaliser_of(model)
    worlds = episodes.simulation.num_worlds
    done = model.num_timesteps // (worlds * EPISODE_STEPS)
    shown.mkdir(exist_ok=True)
    files = [shown / f"round_{number:04}.npz" for number in range(rounds)]
    gathered = [_load(file) for file in files[:done]]
    if not done:
        normaliser.reset()
    for number in range(done, rounds):
        random = np.random.default_rng([seed, 2, number])
        by_expert = random.random(worlds) < EXPERT_SHARE**number
        round_shown, finished = _gather(model, normaliser, episodes, by_expert)
        np.savez(files[number], **asdict(round_shown))
        gathered.append(round_shown)
        _fit(model, gathered, random, last=number == rounds - 1)
        model.num_timesteps += len(round_shown.observations)
        hear(finished)
    go_on_from(model, episodes.observe())


@dataclass(frozen=True)
class Shown:
    """What an expert showed: observations (S, O) and its actions (S, J), single precision."""

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]


def _load(file: Path) -> Shown:
    try:
        with np.load(file) as arrays:
            return Shown(**arrays)
    except (OSError, ValueError, TypeError, BadZipFile) as error:
        raise ValueError(f"{file}: not what an expert showed ({error})") from error


def _gather(
    model: PPO, normaliser: VecNormalize, episodes: Episodes, by_expert: NDArray[np.bool_]
) -> tuple[Shown, list[tuple[float, bool]]]:
    """One episode in every world: what the expert showed, and return and success of the policy's own."""
    expert = episodes.task.reactive_expert(episodes)
    observation = episodes.observe()
    seen: list[Array] = []
    shown: list[Array] = []
    infos: list[dict[str, Any]] = []
    for _ in range(EPISODE_STEPS):
        seen.append(observation)
        shown.append(np.clip(expert(observation), -1.0, 1.0))
        own, _ = model.predict(np.asarray(normaliser.normalize_obs(observation)), deterministic=True)
        actions = np.where(by_expert[:, None], shown[-1], own)
        infos = cast(list[dict[str, Any]], normaliser.step(actions)[3])
        observation = np.asarray(normaliser.get_original_obs())
    own_infos = [info for info, shows in zip(infos, by_expert, strict=True) if not shows]
    observations, actions = (np.concatenate(rows).astype(np.float32) for rows in (seen, shown))
    return Shown(observations, actions), finished_episodes(own_infos)


def _fit(model: PPO, gathered: list[Shown], random: np.random.Generator, *, last: bool) -> None:
    """Least squares over all that was gathered, at a rate that falls; in the last round longer."""
    normaliser = normaliser_of(model)
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
