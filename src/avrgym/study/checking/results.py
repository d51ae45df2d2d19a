"""Results so far: what the completed trials gave, for each task with each robot and policy."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

import sqlalchemy as sa

from avrgym.study.storage.asked import Asked
from avrgym.study.storage.rows import GivenAnswer, Participant, Trial, TrialAttempt
from avrgym.study.storage.states import TAKES_PART
from avrgym.study.storage.store import Store, find_all
from avrgym.tasks.registry import find_environment

Condition = tuple[str, str, str, bool]
"""Task, robot, policy as the experimenter may see it, and whether simulated participants met it."""


@dataclass(frozen=True)
class ConditionResults:
    """Results of the completed trials of one condition, without practice; people and simulated participants separately.

    ``policy`` is a letter where the experimenter is blinded. ``reward_mean`` is per trial, ``success_rate`` in 0..1;
    ``answer_means`` is the mean answer to each version of an item that was answered, on its own
    scale.
    """

    task: str
    robot: str
    policy: str
    simulated: bool
    trials: int
    success_rate: float
    reward_mean: float
    answer_means: dict[str, float]


def summarise_results(store: Store, asked: Asked | None = None) -> tuple[ConditionResults, ...]:
    """The results so far of participants who take part or have finished; those who withdrew are left out.

    ``asked`` are the items that they answered, if these were read already.
    """
    asked = asked or Asked(store)
    with store.database.read() as connection:
        completed = _completed_attempts(store, connection)
        answers = _answers_by_attempt(connection)
    return tuple(
        _summarise(asked, condition, attempts, [each for attempt in attempts for each in answers[attempt.id]])
        for condition, attempts in sorted(completed.items())
    )


def _completed_attempts(store: Store, connection: sa.Connection) -> dict[Condition, list[TrialAttempt]]:
    participants = {each.number: each for each in find_all(connection, Participant)}
    trials = {trial.id: trial for trial in find_all(connection, Trial)}
    found = defaultdict[Condition, list[TrialAttempt]](list)
    for attempt in find_all(connection, TrialAttempt, state="completed"):
        trial = trials[attempt.trial]
        participant = participants[trial.participant]
        if not trial.practice and participant.state in TAKES_PART:
            found[_condition(store, trial, participant)].append(attempt)
    return found


def _condition(store: Store, trial: Trial, participant: Participant) -> Condition:
    policy = store.design.shown_policy(trial.policy, trial.practice)
    return *find_environment(trial.environment), policy, participant.simulated


def _answers_by_attempt(connection: sa.Connection) -> dict[int | None, list[GivenAnswer]]:
    found = defaultdict[int | None, list[GivenAnswer]](list)
    for answer in find_all(connection, GivenAnswer):
        found[answer.attempt].append(answer)
    return found


def _summarise(
    asked: Asked, condition: Condition, attempts: Sequence[TrialAttempt], answers: Sequence[GivenAnswer]
) -> ConditionResults:
    values = defaultdict[str, list[int]](list)
    for answer in filter(asked.contains, answers):
        values[asked.item(answer).id].append(asked.value(answer))
    return ConditionResults(
        *condition,
        trials=len(attempts),
        success_rate=fmean(bool(attempt.metrics.success) for attempt in attempts),
        reward_mean=fmean(attempt.metrics.reward or 0.0 for attempt in attempts),
        answer_means={item: fmean(given) for item, given in sorted(values.items())},
    )
