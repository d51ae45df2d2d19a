"""Checks a task: runs a few steps with every robot and every expert."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.system import random_streams
from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.placement_check import check_initial_states
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from avrgym.tasks.task import Expert

CHECK_WORLDS, CHECK_STEPS = 3, 5


def check_task(name: str) -> None:
    """Run a few control steps of a task with every suitable robot and each expert.

    Initial states are checked by ``tasks.placement_check.check_initial_states``.

    Raises:
        ValueError: for an unknown task, or for the first error of the task.
    """
    if name not in TASKS:
        raise ValueError(f"unknown task {name!r}; allowed: {', '.join(TASKS)}")
    for environment_id, (task, _) in ENVIRONMENTS.items():
        if task == name:
            check_initial_states(environment_id)
            episodes = Episodes(environment_id, CHECK_WORLDS, num_threads=1)
            for part in ("expert", "feedback_expert", "memory_expert"):
                expert: Expert | None = getattr(TASKS[name], part)
                if expert is not None:
                    _check_expert(episodes, part, expert)


def _check_expert(episodes: Episodes, name: str, expert: Expert) -> None:
    where = f"{name} in {episodes.environment_id}"
    first, again = (_observations(episodes, expert, where) for _ in range(2))
    if first.tobytes() != again.tobytes():
        raise ValueError(
            f"{where}: two episodes with the same seed differ; use only the random numbers that the functions receive"
        )


def _observations(episodes: Episodes, expert: Expert, where: str) -> FloatArray:
    """Run a few steps with an expert. Returns the observations (T, N, O)."""
    episodes.reset(
        np.arange(CHECK_WORLDS), [random_streams.make_episode_rng(seed) for seed in range(CHECK_WORLDS)]
    )
    steps = [episodes.evaluate_state()]
    controller = expert(episodes)
    for _ in range(CHECK_STEPS):
        steps.append(episodes.step(controller(steps[-1].observation)))
    for step in steps:
        _check_step(episodes, step, where)
    return np.array([step.observation for step in steps])


def _check_step(episodes: Episodes, step: StepOutcome, where: str) -> None:
    bound = episodes.observation_spec.bound
    for entry, within in zip(
        episodes.observation_spec.entries,
        np.split(np.abs(step.observation) <= bound, episodes.observation_spec.entry_end_indices[:-1], axis=1),
        strict=True,
    ):
        if not within.all():
            raise ValueError(
                f"{where}: observation entry {entry.name} is NaN or outside its bound; allowed: ±{entry.bound:g}"
            )
    terms = {f"reward term {name}": term for name, term in step.reward_terms.items()}
    figures = terms | {"distance_m": step.distance_m, "force_on_person_n": step.force_on_person_n}
    for name, values in figures.items():
        if np.shape(values) != (CHECK_WORLDS,) or not np.isfinite(values).all():
            raise ValueError(f"{where}: {name} is {values!r}; allowed: finite numbers of shape (N,)")
    for name, values, kinds in (("success", step.success, "b"), ("num_events", step.num_events, "bi")):
        if np.shape(values) != (CHECK_WORLDS,) or np.asarray(values).dtype.kind not in kinds:
            raise ValueError(
                f"{where}: {name} is {values!r}; allowed: an array (N,) of NumPy kind {' or '.join(kinds)}"
            )
