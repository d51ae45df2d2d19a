"""Report section about torso heights, head positions and waist angles."""

from collections.abc import Sequence

from avrgym.analysis.biomechanics.biomechanics import BiomechanicsRow, MeasureRangeRow
from avrgym.analysis.biomechanics.tests import HEAD_AXIS_QUESTION, TORSO_HEIGHT_QUESTION
from avrgym.analysis.page.comparisons import TestTables
from avrgym.analysis.page.drawing import ReportFigures, inline_figures
from avrgym.analysis.page.elements import (
    Markup,
    details,
    empty_section,
    group_caption,
    number_text,
    short_number_text,
    table,
    tag,
)


def biomechanics_section(
    distributions: Sequence[BiomechanicsRow],
    ranges: Sequence[MeasureRangeRow],
    simulated: bool,
    drawings: ReportFigures,
    tests: TestTables,
) -> Markup:
    """Returns the report section: figures, ranges, tests and distributions.

    Each of them compares participants with training populations.
    """
    own_ranges = [row for row in ranges if row.simulated is simulated]
    if not own_ranges:
        return empty_section(
            "Biomechanics", "No analysed trial has a complete recording of the body posture."
        )
    return tag(
        "section",
        tag("h3", "Biomechanics: participants and training populations"),
        inline_figures(drawings, "torso-heights", "head-positions"),
        _ranges(own_ranges, simulated),
        tests.pop(TORSO_HEIGHT_QUESTION.table_caption, Markup()),
        details("Head positions, axis by axis", tests.pop(HEAD_AXIS_QUESTION.table_caption, Markup())),
        details("The distributions in numbers", _distributions(distributions, simulated)),
    )


def _ranges(rows: Sequence[MeasureRangeRow], simulated: bool) -> Markup:
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
    return table(group_caption(caption, simulated), heads, body, numbers=range(1, 7))


def _ends(low: float, high: float) -> str:
    return f"{short_number_text(low)} to {short_number_text(high)}"


def _distributions(rows: Sequence[BiomechanicsRow], simulated: bool) -> Markup:
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
            row.quantity, row.posture, row.population, row.n, number_text(row.mean, digits=3),
            number_text(row.deviation, digits=3, absent="–"),
            *(number_text(value, digits=3) for value in (row.minimum, row.median, row.maximum)),
        )
        for row in rows
        if row.population != "participants" or row.simulated is simulated
    ]  # fmt: skip
    return table(
        group_caption("Distributions; training populations are simulated", simulated),
        heads,
        body,
        numbers=range(3, 9),
    )
