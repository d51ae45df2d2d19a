"""Counts of answers about functioning and assistive devices. Small counts are suppressed to protect privacy."""

from collections.abc import Iterator, Sequence

from avrgym.study.design.functioning import (
    ASSISTIVE_DEVICES,
    DECLINED_ANSWER,
    DIFFICULTY_LEVELS,
    FUNCTIONING_QUESTIONS,
)
from avrgym.study.export.table_rows import FunctioningCountRow, FunctioningRow
from avrgym.study.people.functioning import FunctioningAnswers
from avrgym.study.storage.database_rows import Participant
from avrgym.study.storage.state_transitions import ALLOCATED_STATES
from avrgym.study.storage.store import StudyStore

MIN_GROUP_SIZE = 5
"""Smallest exported count above 0. Counts that would reveal a smaller count are suppressed too."""
SUPPRESSED_COUNT = "suppressed"
"""Exported text instead of a suppressed count."""
NOT_ASKED_ANSWER = "not asked"
"""Answer in the counts for a participant without answers about functioning."""


def count_functioning_answers(store: StudyStore) -> Iterator[FunctioningCountRow]:
    """Yields the number of analysed participants for each question about functioning and each answer."""
    given = [_answers(person) for person in store.read_participants() if _is_analysed(store, person)]
    for question in FUNCTIONING_QUESTIONS:
        levels = [answers.levels[question] if answers else NOT_ASKED_ANSWER for answers in given]
        kinds = [*DIFFICULTY_LEVELS, NOT_ASKED_ANSWER]
        for level, number in zip(
            kinds, suppress_small_counts([levels.count(each) for each in kinds]), strict=True
        ):
            yield FunctioningCountRow(question, level, _shown(number))
    for device in ASSISTIVE_DEVICES:
        number = sum(answers is not None and device in answers.devices for answers in given)
        answer = device if device == DECLINED_ANSWER else f"{device}: {ASSISTIVE_DEVICES[device]}"
        yield FunctioningCountRow(
            "devices", answer, _shown(suppress_small_counts([number, len(given) - number])[0])
        )


def suppress_small_counts(counts: Sequence[int], min_group_size: int = MIN_GROUP_SIZE) -> list[int | None]:
    """Returns the counts with ``None`` for suppressed counts.

    Counts below ``min_group_size`` are suppressed. Counts that would reveal them are suppressed too.
    """
    hidden = {place for place, number in enumerate(counts) if 0 < number < min_group_size}
    while hidden and (sum(counts[place] for place in hidden) < min_group_size or len(hidden) < 2):
        shown = [place for place, number in enumerate(counts) if number and place not in hidden]
        if not shown:
            return [None] * len(counts)
        hidden.add(min(shown, key=lambda place: counts[place]))
    return [None if place in hidden else number for place, number in enumerate(counts)]


def make_functioning_rows(store: StudyStore, *, free_text: bool) -> Iterator[FunctioningRow]:
    """Yields each participant's answers about functioning. The diagnosis is included only with ``free_text``."""
    for person in store.read_participants():
        answers = _answers(person)
        if answers is not None:
            yield FunctioningRow(
                participant=person.pseudonym,
                site=person.site,
                **{question: answers.levels[question] for question in FUNCTIONING_QUESTIONS},
                devices=", ".join(answers.devices) or None,
                diagnosis=(answers.diagnosis or None) if free_text else None,
            )


def _answers(person: Participant) -> FunctioningAnswers | None:
    return None if person.functioning is None else FunctioningAnswers(**person.functioning)


def _is_analysed(store: StudyStore, person: Participant) -> bool:
    """Returns whether a real participant takes part and has a completed trial that is not a practice trial."""
    return (
        not person.simulated
        and person.state in ALLOCATED_STATES
        and any(
            each.state == "completed" and not each.practice for each in store.read_trials(person.pseudonym)
        )
    )


def _shown(number: int | None) -> str:
    return SUPPRESSED_COUNT if number is None else str(number)
