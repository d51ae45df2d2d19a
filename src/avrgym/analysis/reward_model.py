"""Fit reward weights to participants' ratings of trials (preference learning).

Two trials of a participant with the same task are compared: the trial with the higher sum of answers is preferred. The
model of this preference is Bradley and Terry's (Biometrika 39, 1952), with sums of rewards as strengths (Christiano et
al., NeurIPS 2017). The reward of a control step is linear in the task's reward terms and the force on the person. The
fitted weights therefore correspond to ``Task.weights``, except for a common factor.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from statistics import fmean

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.learning.preference_reward import FORCE_TERM
from avrgym.study.export.exported_attempts import list_completed_attempts
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import write_atomically

COMFORT_ITEM_NAMES = ("L2", "L3")
"""Item ids of the paper's statements about comfort and safety."""
RIDGE_PENALTY = 1.0
"""Strength of the ridge penalty on squared weights of standardised reward terms."""
NEWTON_ITERATIONS = 30
MIN_PARTICIPANTS = 3
"""Minimum number of participants with comparisons for a fit."""


@dataclass(frozen=True)
class RatedTrial:
    """A completed trial with the participant's rating.

    ``rating``: sum of the answers. ``mean_reward_terms``: mean of each reward term over control steps.
    ``mean_reward``: mean of the task's reward over control steps.
    """

    participant: str
    task: str
    rating: float
    mean_reward_terms: Mapping[str, float]
    mean_reward: float


@dataclass(frozen=True)
class RewardModel:
    """The reward weights of one task, fitted to comparisons of trials.

    ``participants``, ``comparisons``: number of participants and of comparisons. ``weights``: weight by reward term,
    for example in 1/N; only ratios of weights have a meaning. ``accuracy``: share of correctly predicted preferences
    (leave one participant out). ``accuracy_of_reward``: share of preferences that the task's own reward predicts
    correctly. ``simulated``: whether all participants are simulated; formulas then generated their answers.
    """

    task: str
    participants: int
    comparisons: int
    accuracy: float
    accuracy_of_reward: float
    weights: dict[str, float]
    simulated: bool


def fit_reward_models(store: StudyStore, items: Sequence[str] = COMFORT_ITEM_NAMES) -> list[RewardModel]:
    """Returns a reward model for each task of a study with comparisons of at least ``MIN_PARTICIPANTS`` participants.

    Simulated participants are used only if there are no people. Practice trials are not used.

    Raises:
        StudyError: if a recording is missing or damaged, or no task has comparisons of at least three participants.
    """
    fetch_recordings(store)
    simulated, trials = _rated_trials(store, items)
    by_task: dict[str, list[RatedTrial]] = {}
    for trial in trials:
        by_task.setdefault(trial.task, []).append(trial)
    models = [fit_reward_model(task, own, simulated=simulated) for task, own in by_task.items()]
    found = [model for model in models if model is not None]
    if not found:
        raise StudyError(
            f"no task has comparisons of at least {MIN_PARTICIPANTS} participants. A comparison needs two completed "
            f"trials of a task with different answers to {' and '.join(items)}"
        )
    return found


def fit_reward_model(task: str, trials: Sequence[RatedTrial], *, simulated: bool) -> RewardModel | None:
    """Returns the reward model of a task; ``None`` with fewer than ``MIN_PARTICIPANTS`` participants."""
    pairs = list(find_preference_pairs(trials))
    people = list(dict.fromkeys(better.participant for better, _ in pairs))
    if len(people) < MIN_PARTICIPANTS:
        return None
    names = [
        name
        for name in trials[0].mean_reward_terms
        if all(name in trial.mean_reward_terms for trial in trials)
    ]
    values = {id(trial): np.array([trial.mean_reward_terms[name] for name in names]) for trial in trials}
    scale: FloatArray = np.std(np.array([*values.values()]), axis=0)
    scale[scale == 0.0] = np.inf
    differences = np.array([values[id(better)] - values[id(worse)] for better, worse in pairs]) / scale
    owners = np.array([better.participant for better, _ in pairs])
    correct = np.concatenate(
        [
            _credit(differences[owners == each] @ fit_reward_weights(differences[owners != each]))
            for each in people
        ]
    )
    reward = _credit(np.array([better.mean_reward - worse.mean_reward for better, worse in pairs]))
    weights: list[float] = (fit_reward_weights(differences) / scale).tolist()
    return RewardModel(
        task,
        len(people),
        len(pairs),
        float(correct.mean()),
        float(reward.mean()),
        dict(zip(names, weights, strict=True)),
        simulated,
    )


def find_preference_pairs(trials: Iterable[RatedTrial]) -> Iterable[tuple[RatedTrial, RatedTrial]]:
    """Yields pairs of trials of the same participant: first the trial with the higher rating. Ties are omitted."""
    for first, second in combinations(trials, 2):
        if first.participant == second.participant and first.rating != second.rating:
            yield (first, second) if first.rating > second.rating else (second, first)


def fit_reward_weights(differences: FloatArray) -> FloatArray:
    """Returns the weights (F,) of a logistic regression without intercept, by Newton's method.

    ``differences`` (n, F): reward terms of the preferred trial minus reward terms of the other trial. The ridge penalty
    makes the solution unique.
    """
    weights = np.zeros(differences.shape[1])
    for _ in range(NEWTON_ITERATIONS):
        wrong = 1.0 / (1.0 + np.exp(np.clip(differences @ weights, -30.0, 30.0)))
        gradient = differences.T @ wrong - RIDGE_PENALTY * weights
        curvature = (differences.T * (wrong * (1.0 - wrong))) @ differences + RIDGE_PENALTY * np.eye(
            len(weights)
        )
        weights = weights + np.linalg.solve(curvature, gradient)
    return weights


def write_reward_models(models: Sequence[RewardModel], out: Path) -> None:
    """Write reward models into a new JSON file. Raises ``FileExistsError`` if it exists."""
    if out.exists():
        raise FileExistsError(f"{out} already exists; choose another file with --out FILE")
    write_atomically(out, json.dumps([asdict(model) for model in models], indent=2).encode() + b"\n")


def _credit(margins: FloatArray) -> FloatArray:
    """Returns the score (n,) of predictions: 1 if correct, 0 if wrong, 0.5 if both trials have equal predicted
    rewards."""
    return (np.sign(margins) + 1.0) / 2.0


def _rated_trials(store: StudyStore, items: Sequence[str]) -> tuple[bool, list[RatedTrial]]:
    attempts = [each for each in list_completed_attempts(store) if not each.trial.practice]
    simulated = all(each.participant.simulated for each in attempts)
    found: list[RatedTrial] = []
    for exported in attempts:
        answers = {answer.item: answer.value for answer in exported.answers}
        if exported.participant.simulated != simulated or not set(items) <= set(answers):
            continue
        steps = [control for _, control in exported.read_control_steps()]
        terms = {
            name: fmean(step.reward_terms.get(name, 0.0) for step in steps) for name in steps[0].reward_terms
        }
        terms[FORCE_TERM] = fmean(step.force_on_person_n for step in steps)
        found.append(
            RatedTrial(
                exported.participant.pseudonym,
                exported.trial.task,
                sum(answers[item] for item in items),
                terms,
                fmean(step.reward for step in steps),
            )
        )
    return simulated, found
