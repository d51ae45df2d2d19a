"""Learning from a teacher before PPO: dataset aggregation (Ross, Gordon, Bagnell, AISTATS 2011, algorithm 3.1).

The policy drives ever more of the worlds, the teacher says at every step what it would do there, and the policy
learns to do the same from all that was gathered so far.
"""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor

from avrgym.episodes import EPISODE_STEPS, Episodes
from avrgym.stable_baselines import finished_episodes
from avrgym.teachers import TEACHERS

Array = NDArray[np.float64]

TEACHER_SHARE = 0.8
"""The teacher drives all worlds in the first round, and in each later one this share of those of the round before."""
BATCH = 1024
EPOCHS, LAST_EPOCHS = 10, 100
"""How often all that was gathered is gone through at the end of a round and of the last."""
LEARNING_RATE, FALL, LAST_FALL = 1e-3, 0.3, 0.01
"""The learning rate, and the share of it that is left at the end of a round and of the last."""

Hear = Callable[[int, list[tuple[float, bool]]], object]


def imitate(model: PPO, episodes: Episodes, rounds: int, seed: int, hear: Hear) -> None:
    """Bring a model's actor to do as the teacher does, and fit its normaliser of observations on the way.

    Args:
        model: over a ``VecNormalize`` of the environment whose worlds ``episodes`` are; not yet begun.
        episodes: the worlds.
        rounds: how many, 1 or more; each is an episode in every world.
        seed: of who drives which world, and of the minibatches.
        hear: told after each round how many steps were made in all, and return and success of each episode that the
            policy drove.
    """
    normaliser = model.get_env()
    assert isinstance(normaliser, VecNormalize)
    random = np.random.default_rng([seed, 2])
    normaliser.reset()
    seen, shown = [], []
    for number in range(rounds):
        by_teacher = random.random(episodes.simulation.num_worlds) < TEACHER_SHARE**number
        observations, actions, finished = _gather(model, normaliser, episodes, by_teacher)
        seen.append(observations)
        shown.append(actions)
        last = number == rounds - 1
        _fit(model, np.concatenate(seen), np.concatenate(shown), random, last)
        if finished:
            hear((number + 1) * len(observations), finished)
    model._last_obs = normaliser.normalize_obs(episodes.observe())  # type: ignore[assignment]
    model._last_episode_starts = np.ones(episodes.simulation.num_worlds, dtype=bool)


def _gather(
    model: PPO, normaliser: VecNormalize, episodes: Episodes, by_teacher: NDArray[np.bool_]
) -> tuple[Array, Array, list[tuple[float, bool]]]:
    """One episode in every world: observations (S, O), the teacher's actions (S, 7), the policy's returns."""
    teacher = TEACHERS[episodes.task.name](episodes)
    observation = episodes.observe()
    seen, shown, infos = [], [], []
    for _ in range(EPISODE_STEPS):
        seen.append(observation)
        shown.append(np.clip(teacher(observation), -1.0, 1.0))
        own, _ = model.predict(np.asarray(normaliser.normalize_obs(observation)), deterministic=True)
        _, _, _, infos = normaliser.step(np.where(by_teacher[:, None], shown[-1], own))
        observation = np.asarray(normaliser.get_original_obs())
    own_infos = [infos[world] for world in np.nonzero(~by_teacher)[0]]
    return np.concatenate(seen), np.concatenate(shown), finished_episodes(own_infos)


def _fit(model: PPO, seen: Array, shown: Array, random: np.random.Generator, last: bool) -> None:
    """Least squares over all that was gathered, at a rate that falls; in the last round longer."""
    normaliser = model.get_env()
    assert isinstance(normaliser, VecNormalize)
    observations = torch.as_tensor(np.asarray(normaliser.normalize_obs(seen)), dtype=torch.float32)
    actions = torch.as_tensor(shown, dtype=torch.float32)
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
