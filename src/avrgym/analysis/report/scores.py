"""The scores of instruments on the page."""

from collections.abc import Sequence

from avrgym.analysis.page import Markup, brief, quantity, table, tag
from avrgym.analysis.report.results import TestTables
from avrgym.analysis.score_rows import ScoreRow, ScoreSummaryRow
from avrgym.analysis.statistics.scores import tests_of
from avrgym.analysis.statistics.session_answers import CHANGE, WORDS
from avrgym.analysis.study import Analysis
from avrgym.questionnaires.instrument import Instrument
from avrgym.questionnaires.questionnaire import Questionnaire

NOTE = (
    "A scale of one item has the values and the p of that item, which the section Answers tests too. After correction "
    "p differs, because families differ. Without a plan only the score is a primary result."
)


def scores(analysis: Analysis, simulated: bool, tests: TestTables) -> Markup:
    """What each instrument's scales came out as, with tests; nothing where a study uses none."""
    parts = [
        _of_instrument(analysis, simulated, tests, questionnaire, questionnaire.instrument)
        for questionnaire in analysis.design.questionnaires
        if questionnaire.instrument is not None
    ]
    shown = [part for part in parts if part]
    return tag("section", tag("h3", "Scores"), tag("p", NOTE), *shown) if shown else Markup()


def _of_instrument(
    analysis: Analysis,
    simulated: bool,
    tests: TestTables,
    questionnaire: Questionnaire,
    instrument: Instrument,
) -> Markup:
    name = questionnaire.name
    own = [row for row in analysis.observed.scores if (row.simulated, row.questionnaire) == (simulated, name)]
    if not own:
        return Markup()
    summaries = [
        row for row in analysis.score_summaries if (row.simulated, row.questionnaire) == (simulated, name)
    ]
    mark = " (simulated participants)" if simulated else ""
    each = tag(
        "details", tag("summary", "Each participant's scores"), _each(f"{name}: each score{mark}", own)
    )
    return tag(
        "section",
        tag("h4", f"{name}: {instrument.title}"),
        tag("p", f"{instrument.source}. Licence: {instrument.licence}."),
        _summaries(f"{name}: scores, n of trials or of participants{mark}", summaries, instrument),
        tests.pop(tests_of(questionnaire), Markup()),
        each,
    )


def _summaries(caption: str, rows: Sequence[ScoreSummaryRow], instrument: Instrument) -> Markup:
    heads = ("Scale", "From", "to", "Policy", "When", "n", "Median", "Quartiles", "Mean", "Range")
    body = [
        (
            row.scale, *_ends(row, instrument), row.policy or "",
            WORDS.get(row.moment, "after trials"), row.n, brief(row.median),
            f"{brief(row.lower_quartile)} to {brief(row.upper_quartile)}", quantity(row.mean),
            f"{brief(row.least)} to {brief(row.most)}",
        )
        for row in rows
    ]  # fmt: skip
    return table(caption, heads, body, numbers=(1, 2, 5, 6, 7, 8, 9))


def _ends(row: ScoreSummaryRow, instrument: Instrument) -> tuple[str, str]:
    """Between which scores a scale's lie; changes have no ends of their own."""
    least, most = instrument.range_of(row.scale)
    return ("", "") if row.moment == CHANGE else (brief(least), brief(most))


def _each(caption: str, rows: Sequence[ScoreRow]) -> Markup:
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
        "Counted",
    )
    body = [
        (
            row.participant, row.moment.replace("_", " "), row.position or "", row.task or "", row.robot or "",
            row.policy or "", row.scale, quantity(row.score, absent="–"), f"{row.answered} of {row.items}",
            "yes" if row.counted else "no",
        )
        for row in rows
    ]  # fmt: skip
    return table(caption, heads, body, numbers=(2, 7, 8))
