"""Additional training reward for participants' preferences, with weights from ``avrgym fit-reward``."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.registry import TASKS, find_environment

FORCE_TERM = "force_on_person_n"
"""Name of the reward term for the contact force on the person, in newtons."""
REWARD_PER_LOG_ODDS = 10.0
"""Reward of a whole episode, per unit of the log odds that a participant prefers this episode."""


def read_preference_weights(file: Path, environment: str) -> dict[str, float]:
    """Returns the weight of each reward term in a control step, for an environment's task.

    The file contains weights for means over the control steps of a trial.

    Raises:
        ValueError: if the file contains no weights for the task, or weights of unknown reward terms.
    """
    task, _ = find_environment(environment)
    allowed = {*TASKS[task].reward_weights, FORCE_TERM}
    try:
        models: dict[str, dict[str, Any]] = {model["task"]: model for model in json.loads(file.read_bytes())}
        weights = None if task not in models else {**models[task]["weights"]}
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ValueError(
            f"{file}: no reward weights ({type(error).__name__}: {error}); allowed: a file of `avrgym fit-reward`"
        ) from error
    if weights is None:
        raise ValueError(
            f"{file} contains weights of {', '.join(models) or 'no task'}; allowed for {environment}: weights of {task}"
        )
    unknown = sorted(weights.keys() - allowed)
    if unknown:
        raise ValueError(
            f"{file}: unknown reward terms {', '.join(unknown)}; allowed: {', '.join(sorted(allowed))}"
        )
    return weights


def preference_reward(step: StepOutcome, weights: Mapping[str, float], steps: int) -> Any:
    """Returns the additional reward (N,) of one control step in an episode of ``steps`` control steps."""
    terms = {**step.reward_terms, FORCE_TERM: step.force_on_person_n}
    log_odds = sum(weight * terms[name] for name, weight in weights.items())
    return REWARD_PER_LOG_ODDS / steps * log_odds
