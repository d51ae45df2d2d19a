"""Report section about torso heights, head positions and waist angles."""

from collections.abc import Sequence

from avrgym.analysis.biomechanics.body_measures import BodyMeasureRangeRow, BodyMeasureRow
from avrgym.analysis.biomechanics.population_tests import (
    HEAD_POSITION_BY_AXIS_QUESTION,
    TORSO_HEIGHT_QUESTION,
)
from avrgym.analysis.page.html_elements import (
    Markup,
    format_group_caption,
    format_number,
    format_short_number,
    render_details,
    render_empty_section,
    render_table,
    tag,
)
from avrgym.analysis.page.hypothesis_test_tables import TestTables
from avrgym.analysis.page.report_figures import ReportFiguresByKind, render_inline_figures


def render_biomechanics_section(
    distributions: Sequence[BodyMeasureRow],
    ranges: Sequence[BodyMeasureRangeRow],
    simulated: bool,
    drawings: ReportFiguresByKind,
    tests: TestTables,
) -> Markup:
    """Returns the report section: figures, ranges, tests and distributions.

    Each of them compares participants with training populations.
    """
    own_ranges = [row for row in ranges if row.simulated is simulated]
    if not own_ranges:
        return render_empty_section(
            "Biomechanics", "No analysed trial has a complete recording of the body posture."
        )
    return tag(
        "section",
        tag("h3", "Biomechanics: participants and training populations"),
        render_inline_figures(drawings, "torso-heights", "head-positions"),
        _ranges(own_ranges, simulated),
        tests.pop(TORSO_HEIGHT_QUESTION.table_caption, Markup()),
        render_details(
            "Head positions, axis by axis", tests.pop(HEAD_POSITION_BY_AXIS_QUESTION.table_caption, Markup())
        ),
        render_details("The distributions in numbers", _distributions(distributions, simulated)),
    )


def _ranges(rows: Sequence[BodyMeasureRangeRow], simulated: bool) -> Markup:
    heads = ("Measure", "n", "Participants", "Original", "covers", "Revised", "covers")
    body = [
        (
            row.quantity, row.n, _ends(row.minimum, row.maximum),
            _ends(row.original_low, row.original_high), f"{100 * row.original_share:.0f} %",
            _ends(row.revised_low, row.revised_high), f"{100 * row.revised_share:.0f} %",
        )
        for row in rows
    ]  # fmt: skip
    caption = (
        "Ranges that cover the participants, and shares within the ranges of the training populations: of "
        "participants for torso heights, of trials for waist angles"
    )
    return render_table(format_group_caption(caption, simulated), heads, body, numbers=range(1, 7))


def _ends(low: float, high: float) -> str:
    return f"{format_short_number(low)} to {format_short_number(high)}"


def _distributions(rows: Sequence[BodyMeasureRow], simulated: bool) -> Markup:
    heads = (
        "Measure",
        "Posture",
        "People",
        "n",
        "Mean",
        "Standard deviation",
        "Minimum",
        "Median",
        "Maximum",
    )
    body = [
        (
            row.quantity, row.posture, row.population, row.n, format_number(row.mean, digits=3),
            format_number(row.deviation, digits=3, absent="–"),
            *(format_number(value, digits=3) for value in (row.minimum, row.median, row.maximum)),
        )
        for row in rows
        if row.population != "participants" or row.simulated is simulated
    ]  # fmt: skip
    return render_table(
        format_group_caption("Distributions; training populations are simulated", simulated),
        heads,
        body,
        numbers=range(3, 9),
    )
