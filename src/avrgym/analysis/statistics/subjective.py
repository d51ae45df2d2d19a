"""What participants answered: how answers are distributed, and the paper's two questions about them."""

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from statistics import fmean

import numpy as np

from avrgym.analysis.rows import AnswerRow, LikertRow, SubjectiveRow
from avrgym.analysis.statistics.families import PARTICIPANT, TRIAL, Compared, Family, Question, corrected
from avrgym.analysis.statistics.objective import ALL
from avrgym.analysis.statistics.tests import signed_rank, spread
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.study.design.design import Design
from avrgym.study.storage.item_versions import first_name

AFTER_TRIAL = "after_trial"
DIGITS = 9
"""Means over a participant's trials are rounded to so many decimals, so that equal means are equal."""
Key = tuple[str, ...]


def subjective_rows(design: Design, answers: Sequence[AnswerRow]) -> list[SubjectiveRow]:
    """How each item was answered with each policy: over all, by task, by robot, and by both."""
    tasks, robots = (ALL, *design.tasks), (ALL, *design.robots)
    rows: list[SubjectiveRow] = []
    for simulated in _groups(answers):
        for item, policy, task, robot in product(rated_items(design), design.policies, tasks, robots):
            values = [
                row.value
                for row in _of(answers, simulated, item.id, policy)
                if task in (row.task, ALL) and robot in (row.robot, ALL)
            ]
            if values:
                rows.append(_summary(simulated, item.id, policy, task, robot, values))
    return rows


def likert_rows(design: Design, answers: Sequence[AnswerRow]) -> list[LikertRow]:
    """How often each value was answered to each item after trials, with each policy."""
    rows: list[LikertRow] = []
    for simulated, questionnaire in product(_groups(answers), asked_at(design, AFTER_TRIAL)):
        for item, policy in product(questionnaire.items, design.policies):
            values = [row.value for row in _of(answers, simulated, item.id, policy)]
            rows += counts(simulated, questionnaire, AFTER_TRIAL, item, policy, values)
    return rows


def counts(
    simulated: bool,
    questionnaire: Questionnaire,
    moment: str,
    item: Item,
    policy: str | None,
    values: Sequence[float],
) -> list[LikertRow]:
    """How often each value of an item's scale is among values."""
    return [
        LikertRow(
            simulated=simulated,
            questionnaire=questionnaire.name,
            moment=moment,
            item=item.id,
            policy=policy,
            value=value,
            count=values.count(value),
            share=values.count(value) / len(values) if values else 0.0,
        )
        for value in questionnaire.scale_of(item).values
    ]


def answer_families(design: Design, answers: Sequence[AnswerRow]) -> list[Family]:
    """The paper's tests, once over trials as in the paper and once over participants.

    The first item asked after a trial (L1: success) against the middle of its scale, for each policy; each item
    with one policy against another, paired within participant × task × robot, each questionnaire a family. Trials of
    one participant are not independent, so that p over trials is too small where participants differ in general; over
    participants each gives one value, the mean of their trials.
    """
    families: list[Family] = []
    for simulated in _groups(answers):
        rated = asked_at(design, AFTER_TRIAL)
        for questionnaire, unit in product(rated[:1], (TRIAL, PARTICIPANT)):
            question = middle_question(questionnaire)
            tests = [
                _against_middle(questionnaire, policy, answers, simulated, unit) for policy in design.policies
            ]
            families.append(corrected(simulated, question, unit, tests))
        for questionnaire, unit in product(rated, (TRIAL, PARTICIPANT)):
            tests = [
                between_policies(item.id, pair, _values(answers, simulated, item.id, pair), unit)
                for pair, item in product(combinations(design.policies, 2), questionnaire.items)
            ]
            families.append(corrected(simulated, policies_question(design, questionnaire), unit, tests))
    return families


def asked_at(design: Design, moment: str) -> list[Questionnaire]:
    """The questionnaires of a moment, in the design's order."""
    return [questionnaire for questionnaire in design.questionnaires if moment in questionnaire.moments]


def rated_items(design: Design) -> tuple[Item, ...]:
    """The items that are asked after each trial, in the design's order."""
    return tuple(item for questionnaire in asked_at(design, AFTER_TRIAL) for item in questionnaire.items)


def middle_question(questionnaire: Questionnaire) -> Question:
    """What the tests of a questionnaire's first item against the middle of its scale ask."""
    name = f"{questionnaire.items[0].id} against the middle"
    return Question(name, _table(questionnaire), questionnaire.instrument is None)


def policies_question(design: Design, questionnaire: Questionnaire) -> Question:
    """What the tests between policies of a questionnaire's items ask; named where there are several."""
    names = {first_name(each.name) for each in asked_at(design, AFTER_TRIAL)}
    several = len(names) > 1 or questionnaire.name not in names
    name = f"policies, {questionnaire.name}" if several else "policies"
    return Question(name, _table(questionnaire), questionnaire.instrument is None)


def _table(questionnaire: Questionnaire) -> str:
    return f"{questionnaire.name}: tests of answers"


def _against_middle(
    questionnaire: Questionnaire, policy: str, answers: Sequence[AnswerRow], simulated: bool, unit: str
) -> Compared:
    item = questionnaire.items[0]
    neutral = questionnaire.scale_of(item).middle
    values = _per(unit, {_key(row): row.value for row in _of(answers, simulated, item.id, policy)})
    differences = {key: value - neutral for key, value in values.items()}
    return Compared(
        item.id,
        (policy, list(values.values())),
        (f"{neutral:g}, the middle", [neutral] * len(values)),
        signed_rank(list(differences.values())),
        *_by_participant(unit, differences),
    )


def between_policies(
    name: str, policies: tuple[str, str], given: tuple[Mapping[Key, float], Mapping[Key, float]], unit: str
) -> Compared:
    """A quantity with the second policy against the first; ``given`` holds its value in each participant's trials."""
    first, second = policies
    a, b = given
    pairs = [key for key in a if key in b]
    before = _per(unit, {key: a[key] for key in pairs})
    after = _per(unit, {key: b[key] for key in pairs})
    x, y = list(after.values()), list(before.values())
    apart = np.round(np.subtract(x, y), DIGITS)
    differences = dict(zip(after, apart.tolist(), strict=True))
    return Compared(name, (second, x), (first, y), signed_rank(apart), *_by_participant(unit, differences))


def _values(
    answers: Sequence[AnswerRow], simulated: bool, item: str, policies: tuple[str, str]
) -> tuple[dict[Key, float], dict[Key, float]]:
    """The answers to an item with each of two policies, by participant, task and robot."""
    first, second = (_of(answers, simulated, item, policy) for policy in policies)
    return {_key(row): row.value for row in first}, {_key(row): row.value for row in second}


def _per(unit: str, values: Mapping[Key, float]) -> dict[Key, float]:
    """The values of trials, or their means for each participant."""
    if unit == TRIAL:
        return {key: float(value) for key, value in values.items()}
    own: dict[Key, list[float]] = {}
    for key, value in values.items():
        own.setdefault(key[:1], []).append(value)
    return {key: round(fmean(given), DIGITS) for key, given in own.items()}


def _by_participant(unit: str, differences: Mapping[Key, float]) -> tuple[int, dict[str, float]]:
    """The number of participants, and for a test by participant the difference of each."""
    participants = len({key[0] for key in differences})
    if unit == TRIAL:
        return participants, {}
    return participants, {key[0]: value for key, value in differences.items()}


def _groups(answers: Sequence[AnswerRow]) -> list[bool]:
    return sorted({row.simulated for row in answers if row.counted})


def _of(answers: Sequence[AnswerRow], simulated: bool, item: str, policy: str) -> list[AnswerRow]:
    wanted = (True, simulated, item, policy)
    return [row for row in answers if (row.counted, row.simulated, row.item, row.policy) == wanted]


def _key(row: AnswerRow) -> Key:
    return row.participant, row.task or "", row.robot or ""


def _summary(
    simulated: bool, item: str, policy: str, task: str, robot: str, values: Sequence[int]
) -> SubjectiveRow:
    return SubjectiveRow(
        simulated=simulated,
        item=item,
        policy=policy,
        task=task,
        robot=robot,
        **spread(values),
    )
