"""Tables of statistical tests in the report."""

from collections.abc import Sequence

from avrgym.analysis.page.html_elements import (
    Markup,
    format_effect_size,
    format_group_caption,
    format_p_value,
    format_short_number,
    render_details,
    render_table,
    tag,
)
from avrgym.analysis.statistics.comparisons import TRIAL_UNIT, ComparisonFamily, ComparisonRow
from avrgym.analysis.statistics.rank_tests import MANN_WHITNEY_TEST_NAME

TestTables = dict[str, Markup]
"""Tables of tests, by caption. Each report section removes the tables that it contains."""


def render_hypothesis_test_tables(families: Sequence[ComparisonFamily], simulated: bool) -> TestTables:
    """Returns the tables of all tests of people (or of simulated participants), by caption."""
    own = [family for family in families if family.is_simulated is simulated]
    rows = {
        caption: [row for family in own if family.question.table_caption == caption for row in family.rows]
        for caption in dict.fromkeys(family.question.table_caption for family in own)
    }
    return {
        caption: render_hypothesis_test_table(caption, tests, simulated) for caption, tests in rows.items()
    }


def render_other_tests_section(tests: TestTables) -> Markup:
    """Returns a report section with all tables that are in no other section; empty without such tables."""
    return tag("section", tag("h3", "Other tests"), *tests.values()) if tests else Markup()


def render_hypothesis_test_table(caption: str, rows: Sequence[ComparisonRow], simulated: bool) -> Markup:
    """Returns a table of the tests by participant, and a folded supplementary table of the tests by trial."""
    by_trial = [row for row in rows if row.unit == TRIAL_UNIT]
    by_participant = [row for row in rows if row.unit != TRIAL_UNIT]
    main = _table_of_tests(caption, by_participant, simulated) if by_participant else Markup()
    supplement = _table_of_tests(f"{caption}, by trial", by_trial, simulated)
    return Markup(main + render_details(TESTS_BY_TRIAL_TEXT, supplement)) if by_trial else main


TESTS_BY_TRIAL_TEXT = (
    "Supplement: the paper's tests by trial. Trials of one participant are not independent; p is too small if "
    "participants differ"
)


def _table_of_tests(caption: str, rows: Sequence[ComparisonRow], simulated: bool) -> Markup:
    """Returns a table of tests. With a plan, it has a column for the plan status."""
    planned, corrected = any(row.plan_status for row in rows), any(row.p_primary is not None for row in rows)
    heads = (
        "Quantity", "Groups", "Unit", "n", "Medians", "p", "p, Holm", *(["p, corrected"] if corrected else []),
        "Effect size [95 % CI]", "Test", "Role", *(["Plan"] if planned else []),
    )  # fmt: skip
    body = [
        (
            row.quantity, f"{row.group_a} / {row.group_b}", row.unit,
            format_sample_size(row),
            f"{format_short_number(row.median_a)} / {format_short_number(row.median_b)}",
            format_p_value(row.p), format_p_value(row.p_holm),
            *([format_corrected_p(row.p_primary)] if corrected else []),
            format_effect_size(row.effect, row.effect_low, row.effect_high),
            f"{row.test}, {row.note or row.method}", row.role, *([row.plan_status] if planned else []),
        )
        for row in rows
    ]  # fmt: skip
    return render_table(
        format_group_caption(caption, simulated), heads, body, numbers=range(3, 9 if corrected else 8)
    )


def format_corrected_p(p_primary: float | None) -> str:
    """Returns the corrected p value of a primary result as text; a dash for ``None`` (other results)."""
    return "–" if p_primary is None else format_p_value(p_primary)


def format_sample_size(row: ComparisonRow) -> str:
    """Returns the sample size as text.

    For unpaired groups, the text contains the size of each group. For pairs, it contains the number of differences, and
    the number of omitted zero differences.
    """
    if row.n_a != row.n_b or row.test == MANN_WHITNEY_TEST_NAME:
        return f"{row.n_a} / {row.n_b}"
    return f"{row.n} + {row.zeros} zero" if row.zeros else str(row.n)


def format_corrected_p_with_stars(row: ComparisonRow) -> str:
    """Returns the corrected p value and significance stars as text for a figure."""
    if row.p_primary is None:
        return "no test"
    shown = "p < 0.001" if row.p_primary < 0.001 else f"p = {row.p_primary:.3f}"
    return f"{shown}\n{row.stars}" if row.stars else shown
