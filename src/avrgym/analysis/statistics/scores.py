"""The scores of instruments: how they are distributed, whether policies differ, and how sessions changed them."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, product

from avrgym.analysis.score_rows import ScoreRow, ScoreSummaryRow
from avrgym.analysis.statistics.families import PARTICIPANT, TRIAL, Family, Question, corrected
from avrgym.analysis.statistics.session_answers import AFTER, BEFORE, CHANGE, changed, values_at
from avrgym.analysis.statistics.subjective import AFTER_TRIAL, Key, between_policies
from avrgym.analysis.statistics.tests import spread
from avrgym.questionnaires.questionnaire import SESSION_MOMENTS, Questionnaire
from avrgym.study.design.design import Design


def score_summary_rows(design: Design, scores: Sequence[ScoreRow]) -> list[ScoreSummaryRow]:
    """How each scale came out with each policy, before and after sessions, and how sessions changed it."""
    rows: list[ScoreSummaryRow] = []
    for simulated, questionnaire, own in _by_questionnaire(design, scores):
        for scale, policy in product(_scales(own), design.policies):
            values = list(_with_policy(own, scale, policy).values())
            rows += _summary(simulated, questionnaire, scale, AFTER_TRIAL, policy, values)
        given = _about_sessions(own)
        for scale, moment in product(_scales(own), (BEFORE, AFTER, CHANGE)):
            values = values_at(moment, scale, given)
            rows += _summary(simulated, questionnaire, scale, moment, None, values)
    return rows


def score_families(design: Design, scores: Sequence[ScoreRow]) -> list[Family]:
    """Wilcoxon's signed-rank tests of every scale, each questionnaire a family.

    Policies are paired within participant × task × robot, over trials and over participants; about sessions each
    participant after against before.
    """
    families: list[Family] = []
    for simulated, questionnaire, own in _by_questionnaire(design, scores):
        if AFTER_TRIAL in questionnaire.moments:
            families += [
                _policies(simulated, questionnaire, design, own, unit) for unit in (TRIAL, PARTICIPANT)
            ]
        if set(SESSION_MOMENTS) <= set(questionnaire.moments):
            given = _about_sessions(own)
            tests = [changed(scale, given) for scale in _scales(own)]
            families.append(corrected(simulated, scores_change_question(questionnaire), PARTICIPANT, tests))
    return families


def scores_policies_question(questionnaire: Questionnaire) -> Question:
    """Whether policies differ in a questionnaire's scores."""
    return Question(f"policies, scores of {questionnaire.name}", tests_of(questionnaire), primary=True)


def scores_change_question(questionnaire: Questionnaire) -> Question:
    """Whether sessions change a questionnaire's scores."""
    name = f"before and after sessions, scores of {questionnaire.name}"
    return Question(name, tests_of(questionnaire), primary=True)


def tests_of(questionnaire: Questionnaire) -> str:
    """The caption of the table with the tests of a questionnaire's scores."""
    return f"{questionnaire.name}: tests of scores"


def _policies(
    simulated: bool, questionnaire: Questionnaire, design: Design, own: Sequence[ScoreRow], unit: str
) -> Family:
    tests = [
        between_policies(scale, (a, b), (_with_policy(own, scale, a), _with_policy(own, scale, b)), unit)
        for (a, b), scale in product(combinations(design.policies, 2), _scales(own))
    ]
    return corrected(simulated, scores_policies_question(questionnaire), unit, tests)


def _by_questionnaire(
    design: Design, scores: Sequence[ScoreRow]
) -> Iterator[tuple[bool, Questionnaire, list[ScoreRow]]]:
    """For people and simulated participants each instrument's counted scores that there are."""
    counted = [row for row in scores if row.counted and row.score is not None]
    for simulated in sorted({row.simulated for row in counted}):
        for questionnaire in design.questionnaires:
            own = [
                row
                for row in counted
                if (row.simulated, row.questionnaire) == (simulated, questionnaire.name)
            ]
            if own:
                yield simulated, questionnaire, own


def _scales(rows: Sequence[ScoreRow]) -> list[str]:
    return list(dict.fromkeys(row.scale for row in rows))


def _with_policy(rows: Sequence[ScoreRow], scale: str, policy: str) -> dict[Key, float]:
    """The scores of trials by participant, task and robot."""
    return {
        (row.participant, row.task or "", row.robot or ""): row.score
        for row in rows
        if (row.moment, row.scale, row.policy) == (AFTER_TRIAL, scale, policy) and row.score is not None
    }


def _about_sessions(rows: Sequence[ScoreRow]) -> Mapping[tuple[str, str], Mapping[str, float]]:
    given: dict[tuple[str, str], dict[str, float]] = {}
    for row in rows:
        if row.moment in SESSION_MOMENTS and row.score is not None:
            given.setdefault((row.moment, row.scale), {})[row.participant] = row.score
    return given


def _summary(
    simulated: bool,
    questionnaire: Questionnaire,
    scale: str,
    moment: str,
    policy: str | None,
    values: Sequence[float],
) -> list[ScoreSummaryRow]:
    """One row, or none where nobody has a score."""
    if not values:
        return []
    return [
        ScoreSummaryRow(
            simulated=simulated,
            questionnaire=questionnaire.name,
            scale=scale,
            moment=moment,
            policy=policy,
            **spread(values),
        )
    ]
