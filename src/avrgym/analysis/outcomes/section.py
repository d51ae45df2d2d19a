"""Report section about success and reward."""

from collections.abc import Sequence

from avrgym.analysis.outcomes.condition_outcomes import OBJECTIVE_QUESTION, ObjectiveOutcomeRow
from avrgym.analysis.outcomes.paper_tables import PaperTable, make_paper_tables
from avrgym.analysis.page.html_elements import (
    Markup,
    format_group_caption,
    format_number,
    format_percentage,
    render_bullet_list,
    render_details,
    render_empty_section,
    render_table,
    tag,
)
from avrgym.analysis.page.hypothesis_test_tables import TestTables
from avrgym.analysis.page.report_figures import ReportFiguresByKind, render_inline_figures
from avrgym.analysis.reading.table_rows import ALL_LABEL
from avrgym.study.design.design import Design


def render_outcomes_section(
    design: Design,
    outcomes: Sequence[ObjectiveOutcomeRow],
    simulated: bool,
    drawings: ReportFiguresByKind,
    tests: TestTables,
) -> Markup:
    """Returns the report section: tables of the paper, figures, tables with confidence intervals, and tests."""
    rows = [row for row in outcomes if row.simulated is simulated]
    if not rows:
        return render_empty_section("Objective measures", "No trial was completed yet.")
    return tag(
        "section",
        tag("h3", "Objective measures"),
        *(_paper_table(each) for each in make_paper_tables(design, rows)),
        _remarks(rows),
        render_inline_figures(drawings, "success", "reward"),
        render_details("With 95 % intervals", _intervals(rows, simulated)),
        tests.pop(OBJECTIVE_QUESTION.table_caption, Markup()),
    )


def _paper_table(shown: PaperTable) -> Markup:
    body = [
        (
            "Success over all tasks" if task == ALL_LABEL else task,
            *(_reward(cell.mean_reward, cell.success_rate) for cell in cells),
        )
        for task, cells in shown.cells_by_task.items()
    ]
    caption = format_group_caption(shown.caption, shown.is_simulated)
    return render_table(
        caption, ("Task", *shown.column_headings), body, numbers=range(1, len(shown.column_headings) + 1)
    )


def _reward(mean: float | None, rate: float | None) -> str:
    if rate is None:
        return "–"
    share = f"{100 * rate:.0f} %"
    return share if mean is None else f"{format_number(mean, digits=0)} ({share})"


def _intervals(rows: Sequence[ObjectiveOutcomeRow], simulated: bool) -> Markup:
    simulation = any(row.simulation_episodes for row in rows)
    heads = (
        "Task", "Robot", "Policy", "Trials", "Reward", "Success",
        *(("Simulated with", "Episodes", "Reward", "Success") if simulation else ()),
    )  # fmt: skip
    body = [
        (
            row.task, row.robot, row.policy, row.trials,
            _interval(row.reward_mean, row.reward_low, row.reward_high, row.trials),
            format_percentage(row.success_rate, row.success_low, row.success_high),
            *(_simulation_cells(row) if simulation else ()),
        )
        for row in rows
    ]  # fmt: skip
    numbers = (3, 4, 5, 7, 8, 9) if simulation else (3, 4, 5)
    return render_table(
        format_group_caption("Objective measures with 95 % intervals", simulated),
        heads,
        body,
        numbers=numbers,
    )


def _simulation_cells(row: ObjectiveOutcomeRow) -> tuple[object, ...]:
    """Returns the table cells with the simulation results of a condition."""
    return (
        row.simulation_population or "–",
        row.simulation_episodes or "–",
        _interval(
            row.simulation_reward_mean,
            row.simulation_reward_low,
            row.simulation_reward_high,
            row.simulation_episodes or 0,
        ),
        format_percentage(
            row.simulation_success_rate, row.simulation_success_low, row.simulation_success_high
        ),
    )


def _remarks(rows: Sequence[ObjectiveOutcomeRow]) -> Markup:
    """Returns a bullet list of notes about simulation results. Each note is listed once, with all conditions that have
    it."""
    about: dict[str, list[str]] = {}
    for row in rows:
        if row.simulation_note:
            about.setdefault(row.simulation_note, []).append(f"{row.task} {row.robot} {row.policy}")
    return render_bullet_list([f"Simulation of {', '.join(which)}: {note}." for note, which in about.items()])


def _interval(mean: float | None, low: float | None, high: float | None, count: int) -> str:
    """Returns mean and confidence interval as text.

    Several equal values have no interval; the text then contains "all equal".
    """
    if mean is None:
        return "–"
    without = " (all equal)" if count > 1 else ""
    ends = (
        without
        if low is None or high is None
        else f" [{format_number(low, digits=1)}, {format_number(high, digits=1)}]"
    )
    return format_number(mean, digits=1) + ends
