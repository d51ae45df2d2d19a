"""Compares the vector environment with Gymnasium's ``SyncVectorEnv`` of single environments."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.testing import assert_array_equal

WORLDS, EPISODE = 3, 5


def assert_same(ours: Any, theirs: Any, where: str) -> None:
    """Assert equal keys, types, shapes and bits, recursively."""
    if isinstance(theirs, Mapping):
        assert isinstance(ours, dict)
        assert ours.keys() == theirs.keys(), where
        for key, value in theirs.items():
            assert_same(ours[key], value, f"{where}[{key!r}]")
        return
    assert type(ours) is type(theirs), where
    assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape), where
    if ours.dtype == object:
        for i, (our, their) in enumerate(zip(ours, theirs, strict=True)):
            assert (our is None) == (their is None), f"{where}[{i}]"
            if their is not None:
                assert_same(our, their, f"{where}[{i}]")
        return
    assert_array_equal(ours, theirs, err_msg=where, strict=True)


def make_both(environment: str, mode: AutoresetMode, people: str) -> tuple[VectorEnv, SyncVectorEnv]:
    """Create both vector environments with short episodes."""
    options: dict[str, Any] = {"num_envs": WORLDS, "max_episode_steps": EPISODE, "people": people}
    theirs = gym.make_vec(
        environment, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **options
    )
    assert isinstance(theirs, SyncVectorEnv)
    return gym.make_vec(environment, autoreset_mode=mode, **options), theirs


def compare(
    environment: str, mode: AutoresetMode, steps: int, rng: np.random.Generator, people: str = "revised"
) -> int:
    """Step both with the same actions. Returns the number of ended episodes.

    Random resets make episodes end at different times.
    """
    ours, theirs = make_both(environment, mode, people)
    seed = int(rng.integers(1000))
    assert_same_pair(ours.reset(seed=seed), theirs.reset(seed=seed), "reset")
    ends, truncated = 0, np.zeros(WORLDS, dtype=bool)
    for number in range(steps):
        actions = rng.uniform(-1.5, 1.5, ours.action_space.shape).astype(np.float32)
        mask = truncated if mode is AutoresetMode.DISABLED else np.zeros(WORLDS, dtype=bool)
        if rng.random() < 0.15:
            mask = mask | (rng.random(WORLDS) < 0.5)
        if mask.any():
            seeds = [None, int(rng.integers(1000)), rng.integers(1000, size=WORLDS).tolist(), [None, 5, None]]
            seed = seeds[rng.integers(len(seeds))]
            one, other = (env.reset(seed=seed, options={"reset_mask": mask.copy()}) for env in (ours, theirs))
            assert_same_pair(one, other, f"reset before step {number}")
        one, other = (env.step(actions) for env in (ours, theirs))
        assert_same_pair(one, other, f"step {number}")
        truncated = other[3]
        ends += int(truncated.sum())
    assert_same(np.array(ours.np_random_seed), np.array(theirs.np_random_seed), "np_random_seed")
    theirs.close()
    ours.close()
    return ends


def assert_same_pair(ours: tuple[Any, ...], theirs: tuple[Any, ...], where: str) -> None:
    """Assert equal results of ``reset`` or ``step``."""
    assert len(ours) == len(theirs)
    for i, (our, their) in enumerate(zip(ours, theirs, strict=True)):
        assert_same(our, their, f"{where}, part {i}")


def invalid_actions(shape: tuple[int, ...]) -> list[Any]:
    """Return invalid actions for environments with this action shape."""
    not_finite = [np.zeros(shape) for _ in range(3)]
    for array, number in zip(not_finite, (np.nan, np.inf, -np.inf), strict=True):
        array[..., 2] = number
    return [
        *not_finite,
        np.zeros((*shape[:-1], 6)),
        np.zeros((*shape, 1)),
        np.zeros(7 * 2),
        0.5,
        None,
        "up",
        [[1], [2, 3]],
    ]
