"""How well a policy does: many episodes at once, the same figures for the same seed."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrgym.episodes import ACTIONS, EPISODE_STEPS, Episodes
from avrgym.oracles import ORACLES
from avrgym.policies import PolicyError, find_policy, load_policy

Array = NDArray[np.float64]
Act = Callable[[Array], NDArray[np.floating]]

MAX_WORLDS = 64
EVALUATION_STREAM = 1_000_003
"""Evaluation draws from streams of its own, which training never uses."""


@dataclass(frozen=True)
class Evaluation:
    """The figures of one policy in one environment; force is the mean over all steps."""

    env: str
    policy: str
    people: str
    episodes: int
    reward_mean: float
    reward_std: float
    success_rate: float
    success_ci95: tuple[float, float]
    force_mean_newton: float


def evaluate(
    environment_id: str,
    policy: str,
    people: str,
    episodes: int,
    seed: int,
    progress: Callable[[int], None] = lambda steps: None,
) -> Evaluation:
    """Run episodes of 200 steps and sum them up.

    Args:
        environment_id: such as ``avrgym/FeedingJaco-v1``.
        policy: the name of a packaged policy, ``oracle``, ``random``, ``zero``, or the path of a policy file.
        people: whom to meet, a name in ``people.DISTRIBUTIONS`` or a file of people.
        episodes: how many, 1 or more.
        seed: of the episodes; another seed gives other people and starts.
        progress: told after each control step how many environment steps were made.

    Raises:
        ValueError: for an unknown name or fewer than one episode, naming what is allowed.
    """
    if episodes < 1:
        raise ValueError(f"{episodes} episodes; at least 1 is needed")
    rewards, successes, forces = [], [], []
    for first in range(0, episodes, MAX_WORLDS):
        batch = range(first, min(first + MAX_WORLDS, episodes))
        world = Episodes(environment_id, len(batch), distribution=people)
        generators = [np.random.default_rng([EVALUATION_STREAM, seed, episode]) for episode in batch]
        reward, success, force = _run(world, policy, generators, progress)
        rewards.append(reward)
        successes.append(success)
        forces.append(force)
    reward, success = np.concatenate(rewards), np.concatenate(successes)
    return Evaluation(
        env=environment_id,
        policy=policy,
        people=people,
        episodes=episodes,
        reward_mean=float(reward.mean()),
        reward_std=float(reward.std()),
        success_rate=float(success.mean()),
        success_ci95=wilson_interval(int(success.sum()), episodes),
        force_mean_newton=float(np.concatenate(forces).mean()),
    )


def wilson_interval(successes: int, count: int) -> tuple[float, float]:
    """The 95 % score interval of a share (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    z = 1.959963984540054
    share = successes / count
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(share * (1 - share) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == count else centre + half
    return float(low), float(high)


def actor(policy: str, world: Episodes, generators: list[np.random.Generator]) -> Act:
    """What turns observations (N, O) into actions (N, 7), in a world whose episodes have begun.

    ``policy`` as for ``evaluate``.
    """
    if policy == "zero":
        return lambda observation: np.zeros((len(observation), ACTIONS), np.float32)
    if policy == "random":
        return lambda observation: np.stack([g.uniform(-1.0, 1.0, ACTIONS) for g in generators]).astype(
            np.float32
        )
    if policy == "oracle":
        return ORACLES[world.task.name](world)
    try:
        path = find_policy(policy, world.environment_id)
    except PolicyError as error:
        raise PolicyError(f"{error}; or oracle, random or zero") from error
    found = load_policy(path, world.environment_id, world.task.observation_size, ACTIONS)
    return lambda observation: found.act(observation, generators)


def _run(
    world: Episodes, policy: str, generators: list[np.random.Generator], progress: Callable[[int], None]
) -> tuple[Array, NDArray[np.bool_], Array]:
    """One batch of episodes: summed reward (n,), success (n,) and mean force (n,)."""
    count = len(generators)
    observation = world.begin(np.arange(count), generators)
    act = actor(policy, world, generators)
    reward, force, success = np.zeros(count), np.zeros(count), np.zeros(count, dtype=bool)
    for _ in range(EPISODE_STEPS):
        step = world.step(act(observation).astype(float))
        observation, success = step.observation, step.success
        reward += step.reward
        force += step.force_on_person_n / EPISODE_STEPS
        progress(count)
    return reward, success, force
