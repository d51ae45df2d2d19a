"""The same worlds on two engines."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.task import Controller

WARP = "warp:cpu"


def episodes_on_both(environment: str, worlds: int, people: str = "revised", seed: int = 3) -> list[Episodes]:
    """Return episodes on threads and on Warp's CPU device with the same initial states."""
    both = [
        Episodes(environment, worlds, people=people, engine=engine, num_threads=1)
        for engine in ("threads", WARP)
    ]
    for episodes in both:
        episodes.reset(np.arange(worlds), [np.random.default_rng([seed, world]) for world in range(worlds)])
    return both


class Comparison(NamedTuple):
    """Results of the same actions on threads and on Warp."""

    threads: StepOutcome
    warp: StepOutcome
    joint_positions: float
    """Maximum difference of the arms' joint angles."""


def step_both(both: list[Episodes], expert: Controller, steps: int) -> Iterator[Comparison]:
    """Step both engines with an expert that observes the worlds on threads."""
    threads, warp = both
    for _ in range(steps):
        action = np.asarray(expert(threads.observe()), float)
        first, second = threads.step(action), warp.step(action)
        apart = np.abs(threads.simulation.get_joint_positions() - warp.simulation.get_joint_positions()).max()
        yield Comparison(first, second, float(apart))


def copy_state(both: list[Episodes]) -> None:
    """Copy the state of the worlds on threads to Warp."""
    threads, warp = (episodes.simulation for episodes in both)
    for world in range(threads.num_worlds):
        warp.set_integration_state(threads.get_integration_state(world), world)
    both[1].task_state = both[0].task_state
