"""The primary results on the page and in tables for publications: one for each question, with stars."""

from collections.abc import Iterator, Sequence
from itertools import chain

from avrgym.analysis.model_rows import ModelRow
from avrgym.analysis.page import Markup, badge, brief, table, tag
from avrgym.analysis.report.models import effect
from avrgym.analysis.report.results import captioned, probability, values_given, with_interval
from avrgym.analysis.rows import TestedRow
from avrgym.analysis.statistics.families import LEAST_PARTICIPANTS, PARTICIPANT, TOO_FEW
from avrgym.analysis.statistics.primary import PRIMARY
from avrgym.analysis.study import Analysis

HEADS = ("Question", "What", "Groups", "n", "Medians", "Effect [95 %]", "p", "p, corrected", "")
NUMERIC_COLUMNS = (3, 4, 5, 6, 7)
CAPTION = "Primary results, each participant one value; p corrected over all of them"
WITHOUT_PLAN = (
    "Each question has one primary result. No plan names hypotheses, so these are the tests by participant of whether "
    "policies differ in each answer, score and objective measure, of the first answer against the middle of its "
    "scale, and of changes over sessions."
)
WITH_PLAN = "The primary results are the tests of the plan's hypotheses, each participant one value."
OTHERS = (
    "Only primary results have stars: * < 0.05, ** < 0.01, *** < 0.001 after correction over all of them. All other "
    "results are sensitivity analyses, secondary, or a supplement, and have none. Stars and figures use "
    "“p, corrected”. “p, Holm” in other tables is corrected within one family only and has another value."
)


def primary(analysis: Analysis, simulated: bool) -> Markup:
    """The primary results of a group of participants; nothing where there are none."""
    rows = primary_rows(analysis, simulated)
    if not rows:
        return Markup()
    planned = analysis.plan is not None and analysis.plan.confirmed is not None
    mark = [badge("SIMULATED PARTICIPANTS")] if simulated else []
    limits = [tag("p", words) for words in _limits(analysis, simulated)]
    return tag(
        "section",
        tag("h3", "Primary results"),
        *mark,
        tag("p", f"{WITH_PLAN if planned else WITHOUT_PLAN} {OTHERS}"),
        *limits,
        table(captioned(CAPTION, simulated), HEADS, rows, NUMERIC_COLUMNS),
    )


def primary_rows(analysis: Analysis, simulated: bool) -> list[tuple[object, ...]]:
    """The cells of the table of primary results."""
    tests, effects = _primary(analysis, simulated)
    return [*map(_tested, tests), *map(_modelled, effects)]


def _primary(analysis: Analysis, simulated: bool) -> tuple[list[TestedRow], list[ModelRow]]:
    def wanted(row: TestedRow | ModelRow) -> bool:
        return row.simulated is simulated and row.role == PRIMARY

    return list(filter(wanted, analysis.tests)), list(filter(wanted, analysis.models))


def _tested(row: TestedRow) -> tuple[object, ...]:
    return (
        row.family.removesuffix(f", by {PARTICIPANT}"), row.quantity, f"{row.group_a} / {row.group_b}",
        values_given(row), f"{brief(row.median_a)} / {brief(row.median_b)}",
        with_interval(row.effect, row.effect_low, row.effect_high),
        row.note if row.p is None else probability(row.p), probability(row.p_primary), row.mark,
    )  # fmt: skip


def _modelled(row: ModelRow) -> tuple[object, ...]:
    return (
        row.family, row.quantity, f"{row.group_a} / {row.group_b}", row.participants, "–", effect(row),
        row.note if row.p is None else probability(row.p), probability(row.p_primary), row.mark,
    )  # fmt: skip


def _limits(analysis: Analysis, simulated: bool) -> Iterator[str]:
    """Limits of tests with few participants."""
    rows = [*chain(*_primary(analysis, simulated))]
    if any(row.note == TOO_FEW for row in rows):
        yield f"Fewer than {LEAST_PARTICIPANTS} participants are described and not tested."
    elif most := _most_participants(rows):
        least = 2.0 / 2.0**most
        if least >= 0.05:
            yield f"With {most} participants p of a paired test is never below {least:.3g}: no star is possible."


def _most_participants(rows: Sequence[TestedRow | ModelRow]) -> int:
    if any(isinstance(row, ModelRow) for row in rows):
        return 0
    return max((row.n_a for row in rows if isinstance(row, TestedRow)), default=0)
