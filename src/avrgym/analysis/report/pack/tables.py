"""The tables of a publication: participants, reward and success, primary results, other tests, and models."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean

from avrgym.analysis.page import brief, quantity
from avrgym.analysis.report.models import effect
from avrgym.analysis.report.primary import CAPTION, HEADS, NUMERIC_COLUMNS, primary_rows
from avrgym.analysis.report.results import probability, values_given, with_interval
from avrgym.analysis.statistics.families import PARTICIPANT
from avrgym.analysis.statistics.models.effects import POLICIES
from avrgym.analysis.statistics.primary import PRIMARY
from avrgym.analysis.study import Analysis


@dataclass(frozen=True)
class ShownTable:
    """A table as people read it; ``numbers`` are the columns to align at their ends."""

    name: str
    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[object]]
    numbers: Sequence[int]


def shown_tables(analysis: Analysis, simulated: bool) -> Iterator[ShownTable]:
    """The tables that have rows; captions say what is about simulated participants."""
    for table in (_participants, _functioning, _primary, _objective, _tests, _models):
        shown = table(analysis, simulated)
        if shown.rows:
            yield shown


def _marked(caption: str, simulated: bool) -> str:
    return f"{caption} (SIMULATED PARTICIPANTS)" if simulated else caption


def _participants(analysis: Analysis, simulated: bool) -> ShownTable:
    people = analysis.observed.analysed_people(simulated=simulated)
    rows: list[tuple[object, ...]] = []
    for sex in dict.fromkeys(row.sex for row in people):
        own = [row for row in people if row.sex == sex]
        ages = [float(row.age_years) for row in own if row.age_years is not None]
        heights = [row.torso_height_m for row in own if row.torso_height_m is not None]
        rows.append(
            (sex, len(own), _spread(ages, 0), _spread(heights, 3), sum(row.trials_completed for row in own))
        )
    heads = ("Body model", "n", "Age / years", "Torso / m", "Trials completed")
    return ShownTable(
        "participants", _marked("Participants in the analysis", simulated), heads, rows, (1, 2, 3, 4)
    )


def _functioning(analysis: Analysis, simulated: bool) -> ShownTable:
    """Of people alone, without groups of fewer than five and what they would follow from."""
    rows = [] if simulated else [tuple(row.values()) for row in analysis.functioning if row["people"] != "0"]
    caption = (
        "Functioning (Washington Group Short Set) and devices (ISO 9999) of people with a completed trial"
    )
    return ShownTable("functioning", caption, ("Question", "Answer", "n"), rows, (2,))


def _spread(values: Sequence[float], digits: int) -> str:
    if not values:
        return "–"
    ends = f"{min(values):.{digits}f} to {max(values):.{digits}f}"
    return f"{fmean(values):.{max(digits, 1)}f} ({ends})"


def _objective(analysis: Analysis, simulated: bool) -> ShownTable:
    rows = [
        (
            row.task, row.robot, row.policy, row.trials,
            _interval(row.reward_mean, row.reward_low, row.reward_high, 1, 1),
            _interval(row.success_rate, row.success_low, row.success_high, 100, 0),
        )
        for row in analysis.objective
        if row.simulated is simulated
    ]  # fmt: skip
    heads = ("Task", "Robot", "Policy", "Trials", "Reward [95 %]", "Success / % [95 %]")
    return ShownTable("objective", _marked("Reward and success", simulated), heads, rows, (3, 4, 5))


def _interval(mean: float | None, low: float | None, high: float | None, factor: float, digits: int) -> str:
    if mean is None:
        return "–"
    ends = [quantity(factor * end, digits=digits) for end in (low, high) if end is not None]
    return quantity(factor * mean, digits=digits) + (f" [{', '.join(ends)}]" if ends else "")


def _primary(analysis: Analysis, simulated: bool) -> ShownTable:
    rows = primary_rows(analysis, simulated)
    return ShownTable("primary", _marked(CAPTION, simulated), HEADS, rows, NUMERIC_COLUMNS)


def _tests(analysis: Analysis, simulated: bool) -> ShownTable:
    """The other tests by participant."""
    rows = [
        (
            row.family, row.quantity, f"{row.group_a} / {row.group_b}", values_given(row),
            f"{brief(row.median_a)} / {brief(row.median_b)}",
            with_interval(row.effect, row.effect_low, row.effect_high), probability(row.p), probability(row.p_holm),
            row.role,
        )
        for row in analysis.tests
        if row.simulated is simulated and row.unit == PARTICIPANT and row.role != PRIMARY
    ]  # fmt: skip
    heads = ("Family", "What", "Groups", "n", "Medians", "Effect [95 %]", "p", "p, Holm", "Role")
    caption = _marked("Other tests by participant: no primary results", simulated)
    return ShownTable("tests", caption, heads, rows, (3, 4, 5, 6, 7))


def _models(analysis: Analysis, simulated: bool) -> ShownTable:
    rows = [
        (
            row.quantity, f"{row.group_a} / {row.group_b}", row.model, row.participants, effect(row),
            probability(row.p), probability(row.p_holm), row.role, row.planned, row.note,
        )
        for row in analysis.models
        if row.simulated is simulated and row.effect == POLICIES
    ]  # fmt: skip
    heads = ("What", "Groups", "Model", "n", "Effect [95 %]", "p", "p, Holm", "Role", "By plan", "Remark")
    return ShownTable(
        "models", _marked("Policies in models: sensitivity analyses", simulated), heads, rows, (3, 4, 5, 6)
    )
