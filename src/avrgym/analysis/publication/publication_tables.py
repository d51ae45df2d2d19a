"""Tables for a publication: participants, functioning, primary results, reward and success, other tests, models."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean

from avrgym.analysis.models.effects import POLICY_EFFECT
from avrgym.analysis.models.section import format_effect
from avrgym.analysis.page.html_elements import (
    format_effect_size,
    format_number,
    format_p_value,
    format_short_number,
)
from avrgym.analysis.page.hypothesis_test_tables import format_sample_size
from avrgym.analysis.primary_results import (
    PRIMARY_COLUMN_HEADINGS,
    PRIMARY_NUMERIC_COLUMNS,
    PRIMARY_TABLE_CAPTION,
    make_primary_rows,
)
from avrgym.analysis.statistics.comparisons import PARTICIPANT_UNIT, PRIMARY_ROLE
from avrgym.analysis.study_analysis import StudyAnalysis


@dataclass(frozen=True)
class PublicationTable:
    """A table for a publication. ``numeric_columns``: indices of the right-aligned columns."""

    name: str
    caption: str
    column_headings: Sequence[str]
    rows: Sequence[Sequence[object]]
    numeric_columns: Sequence[int]


def make_publication_tables(analysis: StudyAnalysis, simulated: bool) -> Iterator[PublicationTable]:
    """Yields the tables that have rows, of people or of simulated participants. Captions of the latter contain a
    mark."""
    for table in (
        _participants_table,
        _functioning_table,
        _primary_table,
        _outcomes_table,
        _tests_table,
        _models_table,
    ):
        shown = table(analysis, simulated)
        if shown.rows:
            yield shown


def _group_caption(caption: str, simulated: bool) -> str:
    return f"{caption} (SIMULATED PARTICIPANTS)" if simulated else caption


def _participants_table(analysis: StudyAnalysis, simulated: bool) -> PublicationTable:
    people = analysis.study_data.find_analysed_participants(simulated=simulated)
    rows: list[tuple[object, ...]] = []
    for sex in dict.fromkeys(row.sex for row in people):
        own = [row for row in people if row.sex == sex]
        ages = [float(row.age_years) for row in own if row.age_years is not None]
        heights = [row.torso_height_m for row in own if row.torso_height_m is not None]
        rows.append(
            (sex, len(own), _spread(ages, 0), _spread(heights, 3), sum(row.trials_completed for row in own))
        )
    heads = ("Body model", "n", "Age / years", "Torso / m", "Trials completed")
    return PublicationTable(
        "participants", _group_caption("Participants in the analysis", simulated), heads, rows, (1, 2, 3, 4)
    )


def _functioning_table(analysis: StudyAnalysis, simulated: bool) -> PublicationTable:
    """Returns the table of functioning, for people only.

    Counts below five are suppressed. If a suppressed count can be computed from another count, the other count is also
    suppressed.
    """
    rows = (
        []
        if simulated
        else [tuple(row.values()) for row in analysis.functioning_counts if row["people"] != "0"]
    )
    caption = (
        "Functioning (Washington Group Short Set) and devices (ISO 9999) of people with a completed trial"
    )
    return PublicationTable("functioning", caption, ("Question", "Answer", "n"), rows, (2,))


def _spread(values: Sequence[float], digits: int) -> str:
    if not values:
        return "–"
    ends = f"{min(values):.{digits}f} to {max(values):.{digits}f}"
    return f"{fmean(values):.{max(digits, 1)}f} ({ends})"


def _outcomes_table(analysis: StudyAnalysis, simulated: bool) -> PublicationTable:
    rows = [
        (
            row.task, row.robot, row.policy, row.trials,
            _interval(row.reward_mean, row.reward_low, row.reward_high, 1, 1),
            _interval(row.success_rate, row.success_low, row.success_high, 100, 0),
        )
        for row in analysis.objective_outcomes
        if row.simulated is simulated
    ]  # fmt: skip
    heads = ("Task", "Robot", "Policy", "Trials", "Reward [95 %]", "Success / % [95 %]")
    return PublicationTable(
        "objective", _group_caption("Reward and success", simulated), heads, rows, (3, 4, 5)
    )


def _interval(mean: float | None, low: float | None, high: float | None, factor: float, digits: int) -> str:
    if mean is None:
        return "–"
    ends = [format_number(factor * end, digits=digits) for end in (low, high) if end is not None]
    return format_number(factor * mean, digits=digits) + (f" [{', '.join(ends)}]" if ends else "")


def _primary_table(analysis: StudyAnalysis, simulated: bool) -> PublicationTable:
    rows = make_primary_rows(analysis.tests, analysis.model_effects, simulated)
    return PublicationTable(
        "primary",
        _group_caption(PRIMARY_TABLE_CAPTION, simulated),
        PRIMARY_COLUMN_HEADINGS,
        rows,
        PRIMARY_NUMERIC_COLUMNS,
    )


def _tests_table(analysis: StudyAnalysis, simulated: bool) -> PublicationTable:
    """Returns the table of all tests by participant that are not primary results."""
    rows = [
        (
            row.family, row.quantity, f"{row.group_a} / {row.group_b}", format_sample_size(row),
            f"{format_short_number(row.median_a)} / {format_short_number(row.median_b)}",
            format_effect_size(row.effect, row.effect_low, row.effect_high), format_p_value(row.p),
            format_p_value(row.p_holm),
            row.role,
        )
        for row in analysis.tests
        if row.simulated is simulated and row.unit == PARTICIPANT_UNIT and row.role != PRIMARY_ROLE
    ]  # fmt: skip
    heads = ("Family", "What", "Groups", "n", "Medians", "Effect [95 %]", "p", "p, Holm", "Role")
    caption = _group_caption("Other tests by participant: no primary results", simulated)
    return PublicationTable("tests", caption, heads, rows, (3, 4, 5, 6, 7))


def _models_table(analysis: StudyAnalysis, simulated: bool) -> PublicationTable:
    rows = [
        (
            row.quantity, f"{row.group_a} / {row.group_b}", row.model, row.participants, format_effect(row),
            format_p_value(row.p), format_p_value(row.p_holm), row.role, row.plan_status, row.note,
        )
        for row in analysis.model_effects
        if row.simulated is simulated and row.effect == POLICY_EFFECT
    ]  # fmt: skip
    heads = ("What", "Groups", "Model", "n", "Effect [95 %]", "p", "p, Holm", "Role", "By plan", "Remark")
    return PublicationTable(
        "models",
        _group_caption("Policies in models: sensitivity analyses", simulated),
        heads,
        rows,
        (3, 4, 5, 6),
    )


LATEX_ESCAPES = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$", "×": r"$\times$", "–": "--",
    "<": "$<$", ">": "$>$",
}  # fmt: skip


def escape_latex(text: object) -> str:
    """Returns the text with special characters escaped for LaTeX."""
    return "".join(LATEX_ESCAPES.get(letter, letter) for letter in str(text))


def format_latex_table(
    caption: str, heads: Sequence[str], rows: Sequence[Sequence[object]], numbers: Sequence[int]
) -> str:
    """Returns a LaTeX table. ``numbers``: indices of the right-aligned columns."""
    columns = "".join("r" if column in numbers else "l" for column in range(len(heads)))
    lines = [" & ".join(escape_latex(cell) for cell in row) + r" \\" for row in (heads, *rows)]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{escape_latex(caption)}}}",
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            lines[0],
            r"\midrule",
            *lines[1:],
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )
