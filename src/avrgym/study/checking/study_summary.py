"""Summarise a study: its progress, and results of completed trials by task, robot and policy."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

import sqlalchemy as sa

from avrgym.study.design.allocation import make_trial_orders
from avrgym.study.storage.answers import has_open_questionnaire
from avrgym.study.storage.database_rows import (
    DeletedParticipant,
    Participant,
    StudyAnswer,
    StudySession,
    Trial,
    TrialAttempt,
)
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.state_transitions import ALLOCATED_STATES, UNKNOWN_PARTICIPATION_STATE
from avrgym.study.storage.store import StudyStore, find_rows


@dataclass(frozen=True)
class ParticipantSummary:
    """Progress of one participant; numbers of trials include practice trials.

    ``site_participant``: in a merged study, the pseudonym at the participant's site. ``cell``: index of the
    participant's trial order.
    """

    participant: str
    site: str | None
    site_participant: str | None
    state: str
    simulated: bool
    cell: int | None
    consented: bool
    sessions: int
    trials_completed: int
    trials: int
    questionnaires_open: int
    attempts: int
    answers: int


@dataclass(frozen=True)
class StudySummary:
    """Progress of a study.

    A cell is a trial order of the design. ``filled``: number of allocated and completed participants in each cell.
    ``completed_cells``: number of completed participants in each cell. ``filled_by_site``: ``filled`` of each site.
    """

    title: str
    planned: int
    simulated: int
    completed: int
    withdrawn: int
    excluded: int
    unknown: int
    deleted: int
    filled: tuple[int, ...]
    completed_cells: tuple[int, ...]
    filled_by_site: dict[str, tuple[int, ...]]
    participants: tuple[ParticipantSummary, ...]


def summarise_study(store: StudyStore) -> StudySummary:
    """Returns the current numbers of participants, sessions, trials and answers of a study."""
    with store.database.read_transaction() as connection:
        participants = find_rows(connection, Participant)
        deleted = len(find_rows(connection, DeletedParticipant))
        counts = _count(store, connection)
    states = Counter(participant.state for participant in participants)
    return StudySummary(
        title=store.design.title,
        planned=store.design.participants,
        simulated=sum(participant.simulated for participant in participants),
        completed=states["completed"],
        withdrawn=states["withdrawn"],
        excluded=states["excluded"],
        unknown=states[UNKNOWN_PARTICIPATION_STATE],
        deleted=deleted,
        filled=_per_cell(store, participants, ALLOCATED_STATES),
        completed_cells=_per_cell(store, participants, ("completed",)),
        filled_by_site={
            site: _per_cell(store, [each for each in participants if each.site == site], ALLOCATED_STATES)
            for site in sorted({each.site for each in participants if each.site})
        },
        participants=tuple(_summarise(participant, counts) for participant in participants),
    )


def _per_cell(store: StudyStore, participants: list[Participant], states: tuple[str, ...]) -> tuple[int, ...]:
    count = Counter(participant.cell for participant in participants if participant.state in states)
    return tuple(count[cell] for cell in range(len(make_trial_orders(store.design))))


def _count(store: StudyStore, connection: sa.Connection) -> dict[str, Counter[int]]:
    """Returns the numbers of sessions, trials, attempts, answers and open questionnaires of each participant.

    Keys are the name of the column, then the participant number.
    """
    trials = find_rows(connection, Trial)
    of_session = {session.id: session.participant for session in find_rows(connection, StudySession)}
    completed = find_rows(connection, TrialAttempt, state="completed")
    return {
        "questionnaires_open": Counter(
            of_session[each.session] for each in completed if has_open_questionnaire(store, connection, each)
        ),
        "sessions": Counter(of_session.values()),
        "trials": Counter(trial.participant for trial in trials),
        "trials_completed": Counter(trial.participant for trial in trials if trial.state == "completed"),
        "attempts": Counter(of_session[attempt.session] for attempt in find_rows(connection, TrialAttempt)),
        "answers": Counter(of_session[answer.session] for answer in find_rows(connection, StudyAnswer)),
    }


def _summarise(participant: Participant, counts: dict[str, Counter[int]]) -> ParticipantSummary:
    return ParticipantSummary(
        participant=participant.pseudonym,
        site=participant.site,
        site_participant=participant.pseudonym_at_site,
        state=participant.state,
        simulated=participant.simulated,
        cell=participant.cell,
        consented=participant.consented_at is not None,
        **{name: count[participant.number] for name, count in counts.items()},
    )


ConditionKey = tuple[str, str, str, bool]
"""Task, robot, policy (a letter for a blinded experimenter), and whether participants are simulated."""


@dataclass(frozen=True)
class ConditionResults:
    """Results of a condition's completed trials (without practice trials), of people or of simulated participants.

    ``policy``: a letter if the experimenter is blinded. ``reward_mean``: mean over trials. ``success_rate``: 0 to 1.
    ``answer_means``: mean answer to each version of an item, on its scale.
    """

    task: str
    robot: str
    policy: str
    simulated: bool
    trials: int
    success_rate: float
    reward_mean: float
    answer_means: dict[str, float]


def summarise_results(
    store: StudyStore, answered_items: AnsweredItems | None = None
) -> tuple[ConditionResults, ...]:
    """Returns the current results for each condition, from trials of allocated and completed participants.

    ``answered_items``: the items that participants answered; by default, they are read from the study.
    """
    answered_items = answered_items or AnsweredItems(store)
    with store.database.read_transaction() as connection:
        completed = _completed_attempts(store, connection)
        answers = _answers_by_attempt(connection)
    return tuple(
        _summarise_condition(
            answered_items,
            condition,
            attempts,
            [each for attempt in attempts for each in answers[attempt.id]],
        )
        for condition, attempts in sorted(completed.items())
    )


def _completed_attempts(
    store: StudyStore, connection: sa.Connection
) -> dict[ConditionKey, list[TrialAttempt]]:
    participants = {each.number: each for each in find_rows(connection, Participant)}
    trials = {trial.id: trial for trial in find_rows(connection, Trial)}
    found = defaultdict[ConditionKey, list[TrialAttempt]](list)
    for attempt in find_rows(connection, TrialAttempt, state="completed"):
        trial = trials[attempt.trial]
        participant = participants[trial.participant]
        if not trial.practice and participant.state in ALLOCATED_STATES:
            found[_condition(store, trial, participant)].append(attempt)
    return found


def _condition(store: StudyStore, trial: Trial, participant: Participant) -> ConditionKey:
    policy = store.design.choose_displayed_policy(trial.policy, trial.practice)
    return trial.task, trial.robot, policy, participant.simulated


def _answers_by_attempt(connection: sa.Connection) -> dict[int | None, list[StudyAnswer]]:
    found = defaultdict[int | None, list[StudyAnswer]](list)
    for answer in find_rows(connection, StudyAnswer):
        found[answer.attempt].append(answer)
    return found


def _summarise_condition(
    answered_items: AnsweredItems,
    condition: ConditionKey,
    attempts: Sequence[TrialAttempt],
    answers: Sequence[StudyAnswer],
) -> ConditionResults:
    values = defaultdict[str, list[int]](list)
    for answer in filter(answered_items.contains, answers):
        values[answered_items.find_item(answer).id].append(answered_items.compute_answer_value(answer))
    return ConditionResults(
        *condition,
        trials=len(attempts),
        success_rate=fmean(bool(attempt.metrics.success) for attempt in attempts),
        reward_mean=fmean(attempt.metrics.reward or 0.0 for attempt in attempts),
        answer_means={item: fmean(given) for item, given in sorted(values.items())},
    )
