"""What a task is: plain functions of the state, the same for training, live VR and replay."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrgym.models.human import People
from avrgym.models.robots import Robot
from avrgym.models.scene import Stage
from avrgym.simulation import Start, State

Array = NDArray[np.float64]
Memory = Any
"""What a task remembers of an episode: a dataclass of arrays, world axis first."""


@dataclass(frozen=True)
class Outcome:
    """One control step, judged. ``terms``: unweighted, (N,); ``gone`` (N, K): particles to take away."""

    memory: Memory
    terms: Mapping[str, Array]
    distance_m: Array
    success: NDArray[np.bool_]
    gone: NDArray[np.bool_]


@dataclass(frozen=True)
class Task:
    """A task. Every function takes and gives arrays with the world axis first.

    ``stage(robot)`` says what stands in the scene. ``start(stage, people, uniforms)`` draws where things
    begin from uniform numbers (n, ``uniforms``). ``remember(n)`` is an episode's empty memory.
    ``observe(state)`` gives (N, ``observation_size``). ``judge(state, action, memory)`` judges a control
    step. ``weights`` has one weight for each term; the reward is their weighted sum.
    """

    name: str
    uniforms: int
    observation_size: int
    weights: Mapping[str, float]
    stage: Callable[[Robot], Stage]
    start: Callable[[Stage, People, Array], Start]
    remember: Callable[[int], Memory]
    observe: Callable[[State], Array]
    judge: Callable[[State, Array, Memory], Outcome]

    def reward(self, terms: Mapping[str, Array]) -> Array:
        """The weighted sum of the terms, (N,)."""
        total = np.zeros_like(next(iter(terms.values())), dtype=float)
        for name, weight in self.weights.items():
            total = total + weight * terms[name]
        return total


def norm(v: Array) -> Array:
    """Length of vectors along the last axis."""
    return np.sqrt((v * v).sum(axis=-1))


def merge(old: Memory, new: Memory, ids: NDArray[np.intp]) -> Memory:
    """The memory ``old`` of N worlds with the worlds ``ids`` replaced by ``new``."""
    arrays = {}
    for name, array in vars(old).items():
        array = array.copy()
        array[ids] = getattr(new, name)
        arrays[name] = array
    return type(old)(**arrays)
