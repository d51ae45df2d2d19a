"""Answers after trials: summaries, frequencies, and the two tests of the paper."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Annotated

from avrgym.analysis.column_types import (
    AT_LEAST_0_TEXT,
    FRACTION_RANGE_TEXT,
    IsSimulated,
    ItemName,
    LowerQuartile,
    Maximum,
    Mean,
    Median,
    Minimum,
    PolicyName,
    PolicyNameOrNone,
    ProxyAnswerCount,
    QuestionMoment,
    QuestionnaireName,
    RobotName,
    TaskName,
    UpperQuartile,
    ValueCount,
)
from avrgym.analysis.reading.table_rows import ALL_LABEL, AnswerRow
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    TRIAL_UNIT,
    AnalysisUnitKey,
    Comparison,
    ComparisonFamily,
    ResearchQuestion,
    average_by_analysis_unit,
    compare_policies,
    make_holm_corrected_family,
    summarise_participant_differences,
)
from avrgym.analysis.statistics.rank_tests import compute_summary_statistics, run_signed_rank_test
from avrgym.commands.respondents import PROXY_RESPONDENT
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.study.design.design import Design
from avrgym.study.storage.item_versions import parse_design_name
from avrgym.system.columns import Column


@dataclass(frozen=True, kw_only=True)
class AnswerSummaryRow:
    """Summary of the analysed answers to one item with one policy. ``all`` means all tasks or all robots together."""

    simulated: IsSimulated
    item: ItemName
    policy: PolicyName
    task: TaskName
    robot: RobotName
    n: ValueCount
    by_proxy: ProxyAnswerCount
    mean: Mean
    minimum: Minimum
    lower_quartile: LowerQuartile
    median: Median
    upper_quartile: UpperQuartile
    maximum: Maximum


@dataclass(frozen=True, kw_only=True)
class AnswerFrequencyRow:
    """Frequency of one value in the analysed answers to an item.

    The answers are from trials with one policy, or from before or after sessions.
    """

    simulated: IsSimulated
    questionnaire: QuestionnaireName
    moment: QuestionMoment
    item: ItemName
    policy: PolicyNameOrNone
    value: Annotated[int, Column("Value on the item's scale.")]
    count: Annotated[int, Column("Number of answers with this value.", allowed=AT_LEAST_0_TEXT)]
    by_proxy: Annotated[int, Column("Number of these answers by a proxy.", allowed="0 to count")]
    share: Annotated[float, Column("Share of answers with this value.", allowed=FRACTION_RANGE_TEXT)]


AFTER_TRIAL = "after_trial"


def make_answer_summary_rows(design: Design, answers: Sequence[AnswerRow]) -> list[AnswerSummaryRow]:
    """Returns summary rows of each item and policy: over all trials, by task, by robot, and by task and robot."""
    tasks, robots = (ALL_LABEL, *design.tasks), (ALL_LABEL, *design.robots)
    rows: list[AnswerSummaryRow] = []
    for simulated in _groups(answers):
        for item, policy, task, robot in product(list_trial_items(design), design.policies, tasks, robots):
            own = [
                row
                for row in _counted_answers(answers, simulated, item.id, policy)
                if task in (row.task, ALL_LABEL) and robot in (row.robot, ALL_LABEL)
            ]
            if own:
                rows.append(_summary(simulated, item.id, policy, task, robot, own))
    return rows


def make_answer_frequency_rows(design: Design, answers: Sequence[AnswerRow]) -> list[AnswerFrequencyRow]:
    """Returns a row with the frequency of each value of each item after trials, by policy."""
    rows: list[AnswerFrequencyRow] = []
    for simulated, questionnaire in product(
        _groups(answers), find_questionnaires_at_moment(design, AFTER_TRIAL)
    ):
        for item, policy in product(questionnaire.items, design.policies):
            own = _counted_answers(answers, simulated, item.id, policy)
            rows += count_value_frequencies(simulated, questionnaire, AFTER_TRIAL, item, policy, own)
    return rows


def count_value_frequencies(
    simulated: bool,
    questionnaire: Questionnaire,
    moment: str,
    item: Item,
    policy: str | None,
    answers: Sequence[AnswerRow],
) -> list[AnswerFrequencyRow]:
    """Returns the frequency in ``answers`` of each value on the scale of ``item``."""
    values = [row.value for row in answers]
    of_proxies = [row.value for row in answers if row.respondent == PROXY_RESPONDENT]
    return [
        AnswerFrequencyRow(
            simulated=simulated,
            questionnaire=questionnaire.name,
            moment=moment,
            item=item.id,
            policy=policy,
            value=value,
            count=values.count(value),
            by_proxy=of_proxies.count(value),
            share=values.count(value) / len(values) if values else 0.0,
        )
        for value in questionnaire.find_response_scale(item).values
    ]


def compute_answer_test_families(design: Design, answers: Sequence[AnswerRow]) -> list[ComparisonFamily]:
    """Returns the two tests of the paper. The unit of analysis is the trial (as in the paper), or the participant.

    Test 1: for each policy, the first item after a trial (L1: success) is compared with the midpoint of its scale. Test
    2: for each item, policies are compared. A pair contains answers of one participant with the same task and robot.
    The tests of one questionnaire form a family. Trials of one participant are not independent: if participants differ,
    the p value by trial is too small. In tests by participant, each participant has one value: the mean over trials.
    """
    families: list[ComparisonFamily] = []
    for simulated in _groups(answers):
        rated = find_questionnaires_at_moment(design, AFTER_TRIAL)
        for questionnaire, unit in product(rated[:1], (TRIAL_UNIT, PARTICIPANT_UNIT)):
            question = make_midpoint_question(questionnaire)
            tests = [
                _against_middle(questionnaire, policy, answers, simulated, unit) for policy in design.policies
            ]
            families.append(make_holm_corrected_family(simulated, question, unit, tests))
        for questionnaire, unit in product(rated, (TRIAL_UNIT, PARTICIPANT_UNIT)):
            tests = [
                compare_policies(item.id, pair, _values(answers, simulated, item.id, pair), unit)
                for pair, item in product(combinations(design.policies, 2), questionnaire.items)
            ]
            families.append(
                make_holm_corrected_family(
                    simulated, make_policy_comparison_question(design, questionnaire), unit, tests
                )
            )
    return families


def find_questionnaires_at_moment(design: Design, moment: str) -> list[Questionnaire]:
    """Returns the questionnaires at ``moment`` (such as "after_trial"), in the order of the design."""
    return [questionnaire for questionnaire in design.questionnaires if moment in questionnaire.moments]


def list_trial_items(design: Design) -> tuple[Item, ...]:
    """Returns the items of all questionnaires after trials, in the order of the design."""
    return tuple(
        item
        for questionnaire in find_questionnaires_at_moment(design, AFTER_TRIAL)
        for item in questionnaire.items
    )


def make_midpoint_question(questionnaire: Questionnaire) -> ResearchQuestion:
    """Returns the research question: do the answers to the first item differ from the midpoint of its scale?"""
    name = f"{questionnaire.items[0].id} against the middle"
    return ResearchQuestion(name, _table_caption(questionnaire), questionnaire.instrument is None)


def make_policy_comparison_question(design: Design, questionnaire: Questionnaire) -> ResearchQuestion:
    """Returns the research question: do the answers to a questionnaire differ between policies?

    With several questionnaires after trials, the question's name contains the questionnaire's name.
    """
    names = {parse_design_name(each.name) for each in find_questionnaires_at_moment(design, AFTER_TRIAL)}
    several = len(names) > 1 or questionnaire.name not in names
    name = f"policies, {questionnaire.name}" if several else "policies"
    return ResearchQuestion(name, _table_caption(questionnaire), questionnaire.instrument is None)


def _table_caption(questionnaire: Questionnaire) -> str:
    return f"{questionnaire.name}: tests of answers"


def _against_middle(
    questionnaire: Questionnaire, policy: str, answers: Sequence[AnswerRow], simulated: bool, unit: str
) -> Comparison:
    item = questionnaire.items[0]
    neutral = questionnaire.find_response_scale(item).middle_value
    values = average_by_analysis_unit(
        unit, {_key(row): row.value for row in _counted_answers(answers, simulated, item.id, policy)}
    )
    differences = {key: value - neutral for key, value in values.items()}
    return Comparison(
        item.id,
        (policy, list(values.values())),
        (f"{neutral:g}, the middle", [neutral] * len(values)),
        run_signed_rank_test(list(differences.values())),
        *summarise_participant_differences(unit, differences),
    )


def _values(
    answers: Sequence[AnswerRow], simulated: bool, item: str, policies: tuple[str, str]
) -> tuple[dict[AnalysisUnitKey, float], dict[AnalysisUnitKey, float]]:
    """Returns the answers to an item with the first and with the second policy, by (participant, task, robot)."""
    first, second = (_counted_answers(answers, simulated, item, policy) for policy in policies)
    return {_key(row): row.value for row in first}, {_key(row): row.value for row in second}


def _groups(answers: Sequence[AnswerRow]) -> list[bool]:
    return sorted({row.simulated for row in answers if row.counted})


def _counted_answers(
    answers: Sequence[AnswerRow], simulated: bool, item: str, policy: str
) -> list[AnswerRow]:
    wanted = (True, simulated, item, policy)
    return [row for row in answers if (row.counted, row.simulated, row.item, row.policy) == wanted]


def _key(row: AnswerRow) -> AnalysisUnitKey:
    return row.participant, row.task or "", row.robot or ""


def _summary(
    simulated: bool, item: str, policy: str, task: str, robot: str, answers: Sequence[AnswerRow]
) -> AnswerSummaryRow:
    return AnswerSummaryRow(
        simulated=simulated,
        item=item,
        policy=policy,
        task=task,
        robot=robot,
        by_proxy=sum(row.respondent == PROXY_RESPONDENT for row in answers),
        **compute_summary_statistics([row.value for row in answers]),
    )
