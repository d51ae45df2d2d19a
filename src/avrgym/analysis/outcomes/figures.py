"""Figures of success and reward."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Sequence

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from avrgym.analysis.outcomes.condition_outcomes import ObjectiveOutcomeRow
from avrgym.analysis.page.report_figures import (
    BAR_GROUP_WIDTH,
    FIGURE_WIDTH_INCH,
    LINE_COLOURS,
    MATPLOTLIB_STYLE,
    TEXT_COLOUR,
    ReportFigure,
    add_legend,
    label_x_ticks,
    make_report_figure,
)
from avrgym.study.design.design import Design

SUCCESS_RATE_TICKS = (0.0, 0.25, 0.5, 0.75, 1.0)
SIMULATION_LABEL = "simulation"
"""Label of simulation results in the legend."""


def draw_success_figure(design: Design, simulated: bool, rows: Sequence[ObjectiveOutcomeRow]) -> ReportFigure:
    """Returns a figure of the success rates of all conditions in VR and in simulation, with confidence intervals."""
    caption = _objective_caption("Success", simulated, rows)
    return _objective_figure(design, simulated, rows, "success", "success", "success_rate", caption)


def draw_reward_figure(design: Design, simulated: bool, rows: Sequence[ObjectiveOutcomeRow]) -> ReportFigure:
    """Returns a figure of the mean rewards of all conditions in VR and in simulation, with confidence intervals."""
    caption = _objective_caption("Mean reward", simulated, rows)
    return _objective_figure(design, simulated, rows, "reward", "reward", "reward_mean", caption)


def _objective_caption(what: str, simulated: bool, rows: Sequence[ObjectiveOutcomeRow]) -> str:
    measured = any(row.simulation_episodes for row in rows if row.simulated is simulated)
    return f"{what} in VR (bars){' and in simulation (diamonds)' if measured else ''}, with 95 % intervals"


def _objective_figure(
    design: Design,
    simulated: bool,
    rows: Sequence[ObjectiveOutcomeRow],
    kind: str,
    interval: str,
    mean: str,
    caption: str,
) -> ReportFigure:
    columns = min(2, len(design.tasks))
    lines = -(-len(design.tasks) // columns)
    label = {"success": "success / %", "reward": "mean reward"}[kind]
    with matplotlib.rc_context(MATPLOTLIB_STYLE):
        figure = Figure(figsize=(FIGURE_WIDTH_INCH, 0.6 + 2.1 * lines), layout="constrained")
        for place, task in enumerate(design.tasks):
            axes = figure.add_subplot(lines, columns, place + 1)
            own = [row for row in rows if (row.simulated, row.task) == (simulated, task)]
            _conditions(axes, design, own, interval, mean)
            label_x_ticks(axes, design.robots, 0.8 * FIGURE_WIDTH_INCH / columns)
            axes.set(title=task, xlabel="robot", ylabel=label)
            if interval == "success":
                axes.set_ylim(0.0, 1.05)
                axes.set_yticks(SUCCESS_RATE_TICKS, [f"{100 * share:g}" for share in SUCCESS_RATE_TICKS])
        add_legend(figure, columns=3)
    return make_report_figure(simulated, kind, caption, figure)


def _conditions(
    axes: Axes, design: Design, rows: Sequence[ObjectiveOutcomeRow], interval: str, mean: str
) -> None:
    width = BAR_GROUP_WIDTH / len(design.policies)
    for row in rows:
        policy = design.policies.index(row.policy)
        x = design.robots.index(row.robot) + width * (policy - (len(design.policies) - 1) / 2)
        colour = LINE_COLOURS[policy % len(LINE_COLOURS)]
        if getattr(row, mean) is not None:
            axes.bar(x, getattr(row, mean), 0.9 * width, color=colour, alpha=0.55, label=row.policy)
            _interval(axes, x - 0.12 * width, row, interval, "")
        if getattr(row, f"simulation_{mean}") is not None:
            value = getattr(row, f"simulation_{mean}")
            label = f"{SIMULATION_LABEL}: {row.simulation_note}" if row.simulation_note else SIMULATION_LABEL
            axes.plot(x + 0.2 * width, value, "D", color=TEXT_COLOUR, markersize=4, label=label)
            _interval(axes, x + 0.2 * width, row, interval, "simulation_")
    axes.axhline(0.0, color=TEXT_COLOUR, linewidth=0.6)


def _interval(axes: Axes, x: float, row: ObjectiveOutcomeRow, interval: str, prefix: str) -> None:
    low, high = getattr(row, f"{prefix}{interval}_low"), getattr(row, f"{prefix}{interval}_high")
    if low is not None and high is not None:
        axes.plot([x, x], [low, high], color=TEXT_COLOUR, linewidth=1.0, label="95 % interval")
