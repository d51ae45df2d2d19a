"""Answers before and after sessions with their changes, after breaks, and of caregivers: summaries and tests."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from statistics import fmean
from typing import Annotated

import numpy as np

from avrgym.analysis.answers.trial_answers import AnswerFrequencyRow, count_value_frequencies
from avrgym.analysis.column_types import (
    IsSimulated,
    ItemName,
    LowerQuartile,
    Maximum,
    Mean,
    Median,
    Minimum,
    ProxyAnswerCount,
    QuestionnaireName,
    UpperQuartile,
    ValueCount,
)
from avrgym.analysis.reading.table_rows import AnswerRow
from avrgym.analysis.statistics.comparisons import (
    MEAN_DECIMALS,
    PARTICIPANT_UNIT,
    Comparison,
    ComparisonFamily,
    ResearchQuestion,
    make_holm_corrected_family,
)
from avrgym.analysis.statistics.rank_tests import compute_summary_statistics, run_signed_rank_test
from avrgym.commands.respondents import PROXY_RESPONDENT
from avrgym.questionnaires.questionnaire import (
    REPEATABLE_QUESTION_MOMENTS,
    SESSION_QUESTION_MOMENTS,
    Questionnaire,
)
from avrgym.study.design.design import Design
from avrgym.system.columns import Column

BEFORE_SESSION, AFTER_SESSION = SESSION_QUESTION_MOMENTS
CHANGE_LABEL = "change"
MOMENT_LABELS = {
    BEFORE_SESSION: "before",
    AFTER_SESSION: "after",
    CHANGE_LABEL: "change",
    "after_break": "after breaks",
    "caregiver": "caregivers",
}
"""Labels of moments in tests, tables and figures."""


@dataclass(frozen=True, kw_only=True)
class SessionAnswerSummaryRow:
    """Summary of the analysed answers to one item at one moment, or of their change over sessions.

    Each participant has one value. Several answers after breaks, or of caregivers, are averaged. The change is the
    answer after sessions minus the answer before sessions. A participant without both answers has no change.
    """

    simulated: IsSimulated
    questionnaire: QuestionnaireName
    item: ItemName
    moment: Annotated[str, Column("Moment of the answers.", allowed=", ".join(MOMENT_LABELS))]
    n: ValueCount
    by_proxy: ProxyAnswerCount
    mean: Mean
    minimum: Minimum
    lower_quartile: LowerQuartile
    median: Median
    upper_quartile: UpperQuartile
    maximum: Maximum


ValuesByMoment = Mapping[tuple[str, str], Mapping[str, float]]
"""Values by (moment, item or scale), then by the participant's pseudonym."""


def find_session_questionnaires(design: Design) -> list[Questionnaire]:
    """Returns the questionnaires before or after sessions, in the order of the design."""
    return [each for each in design.questionnaires if set(SESSION_QUESTION_MOMENTS) & set(each.moments)]


def make_session_answer_rows(design: Design, answers: Sequence[AnswerRow]) -> list[SessionAnswerSummaryRow]:
    """Returns summary rows of each item: before sessions, after sessions, change, after breaks, and of caregivers."""
    rows: list[SessionAnswerSummaryRow] = []
    for simulated, questionnaire, given in _asked(design, answers):
        for item, moment in product(questionnaire.items, (BEFORE_SESSION, AFTER_SESSION, CHANGE_LABEL)):
            values = find_values_at_moment(moment, item.id, given)
            if values:
                proxies = _participants_with_proxy(answers, simulated, moment, item.id)
                rows.append(_summary(simulated, questionnaire.name, item.id, moment, values, len(proxies)))
    return [*rows, *_further_rows(design, answers)]


def find_repeatable_questionnaires(design: Design) -> list[tuple[Questionnaire, str]]:
    """Returns (questionnaire, moment) for questionnaires after breaks and for caregivers, in the order of the
    design."""
    return [
        (each, moment)
        for each in design.questionnaires
        for moment in REPEATABLE_QUESTION_MOMENTS
        if moment in each.moments
    ]


def _further_rows(design: Design, answers: Sequence[AnswerRow]) -> Iterator[SessionAnswerSummaryRow]:
    """Yields summary rows of the answers after breaks and of caregivers: first people, then simulated participants."""
    for simulated, (questionnaire, moment) in product((False, True), find_repeatable_questionnaires(design)):
        for item in questionnaire.items:
            given: dict[str, list[float]] = {}
            for row in _counted(answers, simulated, moment, item.id):
                given.setdefault(row.participant, []).append(row.value)
            if given:
                proxies = _participants_with_proxy(answers, simulated, moment, item.id)
                means = [fmean(values) for values in given.values()]
                yield _summary(simulated, questionnaire.name, item.id, moment, means, len(proxies))


def make_session_answer_frequency_rows(
    design: Design, answers: Sequence[AnswerRow]
) -> list[AnswerFrequencyRow]:
    """Returns a row with the frequency of each value of each item, before and after sessions."""
    return [
        row
        for simulated, questionnaire, _ in _asked(design, answers)
        for item, moment in product(questionnaire.items, SESSION_QUESTION_MOMENTS)
        if moment in questionnaire.moments
        for row in count_value_frequencies(
            simulated, questionnaire, moment, item, None, _counted(answers, simulated, moment, item.id)
        )
    ]


def compute_session_test_families(design: Design, answers: Sequence[AnswerRow]) -> list[ComparisonFamily]:
    """Returns Wilcoxon signed-rank tests of changes over sessions. The tests of one questionnaire form a family."""
    return [
        make_holm_corrected_family(
            simulated,
            make_session_change_question(questionnaire),
            PARTICIPANT_UNIT,
            [compare_before_after(item.id, given) for item in questionnaire.items],
        )
        for simulated, questionnaire, given in _asked(design, answers)
        if set(SESSION_QUESTION_MOMENTS) <= set(questionnaire.moments)
    ]


def find_values_at_moment(moment: str, quantity: str, given: ValuesByMoment) -> list[float]:
    """Returns the values of ``quantity`` (an item or a scale) at ``moment``.

    For ``CHANGE_LABEL``, the values are after minus before, for participants with both values.
    """
    if moment != CHANGE_LABEL:
        return list(given.get((moment, quantity), {}).values())
    before, after = given.get((BEFORE_SESSION, quantity), {}), given.get((AFTER_SESSION, quantity), {})
    return [round(after[name] - before[name], MEAN_DECIMALS) for name in after if name in before]


def compare_before_after(quantity: str, given: ValuesByMoment) -> Comparison:
    """Returns a signed-rank test of the values after sessions against the values before sessions.

    Only participants with both values are included.
    """
    before, after = given.get((BEFORE_SESSION, quantity), {}), given.get((AFTER_SESSION, quantity), {})
    both = [name for name in before if name in after]
    a, b = [after[name] for name in both], [before[name] for name in both]
    apart = np.round(np.subtract(a, b), MEAN_DECIMALS)
    differences = dict(zip(both, apart.tolist(), strict=True))
    return Comparison(
        quantity,
        (MOMENT_LABELS[AFTER_SESSION], a),
        (MOMENT_LABELS[BEFORE_SESSION], b),
        run_signed_rank_test(apart),
        len(both),
        differences,
    )


def make_session_change_question(questionnaire: Questionnaire) -> ResearchQuestion:
    """Returns the research question: do the answers to a questionnaire change over sessions?"""
    name = questionnaire.name
    table = f"{name}: after sessions against before"
    return ResearchQuestion(f"before and after sessions, {name}", table, questionnaire.instrument is None)


def _asked(
    design: Design, answers: Sequence[AnswerRow]
) -> Iterator[tuple[bool, Questionnaire, ValuesByMoment]]:
    """Yields (simulated, questionnaire, analysed answers): first for people, then for simulated participants."""
    counted = [row for row in answers if row.counted and row.moment in SESSION_QUESTION_MOMENTS]
    for simulated in sorted({row.simulated for row in counted}):
        given: dict[tuple[str, str], dict[str, float]] = {}
        for row in counted:
            if row.simulated is simulated:
                given.setdefault((row.moment, row.item), {})[row.participant] = row.value
        for questionnaire in find_session_questionnaires(design):
            yield simulated, questionnaire, given


def _counted(answers: Sequence[AnswerRow], simulated: bool, moment: str, quantity: str) -> list[AnswerRow]:
    wanted = (True, simulated, moment, quantity)
    return [row for row in answers if (row.counted, row.simulated, row.moment, row.item) == wanted]


def _participants_with_proxy(
    answers: Sequence[AnswerRow], simulated: bool, moment: str, quantity: str
) -> set[str]:
    """Returns the pseudonyms of participants with at least one answer by a proxy to ``quantity`` at ``moment``.

    For a change, these are the answers before and after sessions.
    """
    moments = SESSION_QUESTION_MOMENTS if moment == CHANGE_LABEL else (moment,)
    given = [_counted(answers, simulated, each, quantity) for each in moments]
    known = set[str].intersection(*({row.participant for row in own} for own in given))
    proxies = {row.participant for own in given for row in own if row.respondent == PROXY_RESPONDENT}
    return known & proxies


def _summary(
    simulated: bool, questionnaire: str, item: str, moment: str, values: Sequence[float], by_proxy: int
) -> SessionAnswerSummaryRow:
    return SessionAnswerSummaryRow(
        simulated=simulated,
        questionnaire=questionnaire,
        item=item,
        moment=moment,
        by_proxy=by_proxy,
        **compute_summary_statistics(values),
    )
