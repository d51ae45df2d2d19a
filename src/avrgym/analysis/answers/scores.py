"""Scores of validated questionnaires: summaries, tests and the report section."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Annotated

from avrgym.analysis.answers.session_answers import (
    AFTER_SESSION,
    BEFORE_SESSION,
    CHANGE_LABEL,
    MOMENT_LABELS,
    compare_before_after,
    find_values_at_moment,
)
from avrgym.analysis.answers.trial_answers import AFTER_TRIAL
from avrgym.analysis.column_types import (
    IsSimulated,
    LowerQuartile,
    Maximum,
    Mean,
    Median,
    Minimum,
    PolicyNameOrNone,
    ProxyAnswerCount,
    QuestionnaireName,
    UpperQuartile,
    ValueCount,
)
from avrgym.analysis.page.html_elements import Markup, format_number, format_short_number, render_table, tag
from avrgym.analysis.page.hypothesis_test_tables import TestTables
from avrgym.analysis.reading.table_rows import ScoreRow
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    TRIAL_UNIT,
    AnalysisUnitKey,
    ComparisonFamily,
    ResearchQuestion,
    compare_policies,
    make_holm_corrected_family,
)
from avrgym.analysis.statistics.rank_tests import compute_summary_statistics
from avrgym.commands.respondents import PROXY_RESPONDENT
from avrgym.questionnaires.instrument import Instrument
from avrgym.questionnaires.questionnaire import SESSION_QUESTION_MOMENTS, Questionnaire
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.system.columns import Column


@dataclass(frozen=True, kw_only=True)
class ScoreSummaryRow:
    """Summary of the analysed scores of one scale.

    The scores are from trials with one policy, from before sessions, or from after sessions. They can also be changes
    over sessions.
    """

    simulated: IsSimulated
    questionnaire: QuestionnaireName
    scale: Annotated[str, COLUMNS_BY_TABLE["scores"]["scale"]]
    moment: Annotated[
        str,
        Column(
            "Moment of the answers.",
            allowed=f"{BEFORE_SESSION}, {AFTER_TRIAL}, {AFTER_SESSION}, {CHANGE_LABEL}",
        ),
    ]
    policy: PolicyNameOrNone
    n: ValueCount
    by_proxy: ProxyAnswerCount
    mean: Mean
    minimum: Minimum
    lower_quartile: LowerQuartile
    median: Median
    upper_quartile: UpperQuartile
    maximum: Maximum


def make_score_summary_rows(design: Design, scores: Sequence[ScoreRow]) -> list[ScoreSummaryRow]:
    """Returns summary rows of each scale: for each policy, before sessions, after sessions, and for the change."""
    rows: list[ScoreSummaryRow] = []
    for simulated, questionnaire, own in _by_questionnaire(design, scores):
        for scale, policy in product(_scales(own), design.policies):
            values = list(_with_policy(own, scale, policy).values())
            proxies = _by_proxy(own, scale, (AFTER_TRIAL,), policy)
            rows += _summary_rows(simulated, questionnaire, scale, AFTER_TRIAL, policy, values, len(proxies))
        given = _about_sessions(own)
        for scale, moment in product(_scales(own), (BEFORE_SESSION, AFTER_SESSION, CHANGE_LABEL)):
            values = find_values_at_moment(moment, scale, given)
            moments = SESSION_QUESTION_MOMENTS if moment == CHANGE_LABEL else (moment,)
            people = {row.participant for row in _by_proxy(own, scale, moments, None)}
            if moment == CHANGE_LABEL:
                people &= set(given.get((BEFORE_SESSION, scale), {})) & set(
                    given.get((AFTER_SESSION, scale), {})
                )
            rows += _summary_rows(simulated, questionnaire, scale, moment, None, values, len(people))
    return rows


def compute_score_test_families(design: Design, scores: Sequence[ScoreRow]) -> list[ComparisonFamily]:
    """Returns Wilcoxon signed-rank tests of every scale. The tests of one questionnaire form a family.

    Scores after trials: the tests compare policies. A pair contains scores of one participant with the same task and
    robot. In one family, the unit of analysis is the trial; in the other, the participant. Scores about sessions: the
    tests compare each participant's scores after sessions with those before sessions.
    """
    families: list[ComparisonFamily] = []
    for simulated, questionnaire, own in _by_questionnaire(design, scores):
        if AFTER_TRIAL in questionnaire.moments:
            families += [
                _policy_family(simulated, questionnaire, design, own, unit)
                for unit in (TRIAL_UNIT, PARTICIPANT_UNIT)
            ]
        if set(SESSION_QUESTION_MOMENTS) <= set(questionnaire.moments):
            given = _about_sessions(own)
            tests = [compare_before_after(scale, given) for scale in _scales(own)]
            families.append(
                make_holm_corrected_family(
                    simulated, make_score_change_question(questionnaire), PARTICIPANT_UNIT, tests
                )
            )
    return families


def make_score_policy_question(questionnaire: Questionnaire) -> ResearchQuestion:
    """Returns the research question: do the scores of a questionnaire differ between policies?"""
    return ResearchQuestion(
        f"policies, scores of {questionnaire.name}", make_score_tests_caption(questionnaire), is_primary=True
    )


def make_score_change_question(questionnaire: Questionnaire) -> ResearchQuestion:
    """Returns the research question: do the scores of a questionnaire change over sessions?"""
    name = f"before and after sessions, scores of {questionnaire.name}"
    return ResearchQuestion(name, make_score_tests_caption(questionnaire), is_primary=True)


def make_score_tests_caption(questionnaire: Questionnaire) -> str:
    """Returns the caption of the table with the tests of a questionnaire's scores."""
    return f"{questionnaire.name}: tests of scores"


def _policy_family(
    simulated: bool, questionnaire: Questionnaire, design: Design, own: Sequence[ScoreRow], unit: str
) -> ComparisonFamily:
    tests = [
        compare_policies(scale, (a, b), (_with_policy(own, scale, a), _with_policy(own, scale, b)), unit)
        for (a, b), scale in product(combinations(design.policies, 2), _scales(own))
    ]
    return make_holm_corrected_family(simulated, make_score_policy_question(questionnaire), unit, tests)


def _by_questionnaire(
    design: Design, scores: Sequence[ScoreRow]
) -> Iterator[tuple[bool, Questionnaire, list[ScoreRow]]]:
    """Yields (simulated, questionnaire, analysed scores): first for people, then for simulated participants."""
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


def _with_policy(rows: Sequence[ScoreRow], scale: str, policy: str) -> dict[AnalysisUnitKey, float]:
    """Returns the scores of one scale after trials with ``policy``; keys are (participant, task, robot)."""
    return {
        (row.participant, row.task or "", row.robot or ""): row.score
        for row in rows
        if (row.moment, row.scale, row.policy) == (AFTER_TRIAL, scale, policy) and row.score is not None
    }


def _by_proxy(
    rows: Sequence[ScoreRow], scale: str, moments: Sequence[str], policy: str | None
) -> list[ScoreRow]:
    """Returns the rows with scores that are computed from at least one answer of a proxy."""
    return [
        row
        for row in rows
        if (row.respondent, row.scale, row.policy) == (PROXY_RESPONDENT, scale, policy)
        and row.moment in moments
        and row.score is not None
    ]


def _about_sessions(rows: Sequence[ScoreRow]) -> Mapping[tuple[str, str], Mapping[str, float]]:
    given: dict[tuple[str, str], dict[str, float]] = {}
    for row in rows:
        if row.moment in SESSION_QUESTION_MOMENTS and row.score is not None:
            given.setdefault((row.moment, row.scale), {})[row.participant] = row.score
    return given


def _summary_rows(
    simulated: bool,
    questionnaire: Questionnaire,
    scale: str,
    moment: str,
    policy: str | None,
    values: Sequence[float],
    by_proxy: int,
) -> list[ScoreSummaryRow]:
    """Returns one row with the summary of ``values``; an empty list if there are no values."""
    if not values:
        return []
    return [
        ScoreSummaryRow(
            simulated=simulated,
            questionnaire=questionnaire.name,
            scale=scale,
            moment=moment,
            policy=policy,
            by_proxy=by_proxy,
            **compute_summary_statistics(values),
        )
    ]


SCORES_NOTE = (
    "A scale of one item has the same values and p as the item in the section Answers. Corrected p differs because the "
    "families differ. Without a plan, only the score is a primary result."
)


def render_scores_section(
    design: Design,
    scores: Sequence[ScoreRow],
    summaries: Sequence[ScoreSummaryRow],
    simulated: bool,
    tests: TestTables,
) -> Markup:
    """Returns the report section: summaries and tests of each validated questionnaire. Empty without scores."""
    own_scores = [row for row in scores if row.simulated is simulated]
    own_summaries = [row for row in summaries if row.simulated is simulated]
    parts = [
        _of_instrument(own_scores, own_summaries, simulated, tests, questionnaire, questionnaire.instrument)
        for questionnaire in design.questionnaires
        if questionnaire.instrument is not None
    ]
    shown = [part for part in parts if part]
    return tag("section", tag("h3", "Scores"), tag("p", SCORES_NOTE), *shown) if shown else Markup()


def _of_instrument(
    scores: Sequence[ScoreRow],
    summaries: Sequence[ScoreSummaryRow],
    simulated: bool,
    tests: TestTables,
    questionnaire: Questionnaire,
    instrument: Instrument,
) -> Markup:
    name = questionnaire.name
    own = [row for row in scores if row.questionnaire == name]
    if not own:
        return Markup()
    own_summaries = [row for row in summaries if row.questionnaire == name]
    mark = " (simulated participants)" if simulated else ""
    each = tag(
        "details", tag("summary", "Each participant's scores"), _score_table(f"{name}: each score{mark}", own)
    )
    return tag(
        "section",
        tag("h4", f"{name}: {instrument.title}"),
        tag("p", f"{instrument.citation}. Licence: {instrument.licence}."),
        _summary_table(f"{name}: scores, n of trials or of participants{mark}", own_summaries, instrument),
        tests.pop(make_score_tests_caption(questionnaire), Markup()),
        each,
    )


def _summary_table(caption: str, rows: Sequence[ScoreSummaryRow], instrument: Instrument) -> Markup:
    heads = ("Scale", "From", "to", "Policy", "When", "n", "Proxy", "Median", "Quartiles", "Mean", "Range")
    body = [
        (
            row.scale, *_range_cells(row, instrument), row.policy or "",
            MOMENT_LABELS.get(row.moment, "after trials"), row.n, row.by_proxy, format_short_number(row.median),
            f"{format_short_number(row.lower_quartile)} to {format_short_number(row.upper_quartile)}",
            format_number(row.mean),
            f"{format_short_number(row.minimum)} to {format_short_number(row.maximum)}",
        )
        for row in rows
    ]  # fmt: skip
    return render_table(caption, heads, body, numbers=(1, 2, 5, 6, 7, 8, 9, 10))


def _range_cells(row: ScoreSummaryRow, instrument: Instrument) -> tuple[str, str]:
    """Returns the lowest and the highest possible score of a scale as cells; empty cells for changes."""
    minimum, maximum = instrument.compute_score_range(row.scale)
    return (
        ("", "")
        if row.moment == CHANGE_LABEL
        else (format_short_number(minimum), format_short_number(maximum))
    )


def _score_table(caption: str, rows: Sequence[ScoreRow]) -> Markup:
    heads = (
        "Participant",
        "When",
        "Trial",
        "Task",
        "Robot",
        "Policy",
        "Scale",
        "Score",
        "Answered",
        "Analysed",
        "Answered by",
    )
    body = [
        (
            row.participant, row.moment.replace("_", " "), row.position or "", row.task or "", row.robot or "",
            row.policy or "", row.scale, format_number(row.score, absent="–"), f"{row.answered} of {row.items}",
            "yes" if row.counted else "no", row.respondent,
        )
        for row in rows
    ]  # fmt: skip
    return render_table(caption, heads, body, numbers=(2, 7, 8))
