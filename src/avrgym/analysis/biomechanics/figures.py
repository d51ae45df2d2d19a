"""Figures of torso heights and head positions, for people or for simulated participants."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Sequence
from itertools import product
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from avrgym.analysis.biomechanics.body_measures import PostureTrials, compute_torso_heights
from avrgym.analysis.biomechanics.training_populations import (
    HEIGHT_POPULATION_NAMES,
    SampledPersonRow,
    read_head_position,
)
from avrgym.analysis.page.report_figures import (
    FIGURE_WIDTH_INCH,
    LINE_COLOURS,
    MATPLOTLIB_STYLE,
    TEXT_COLOUR,
    ReportFigure,
    add_legend,
    make_report_figure,
)
from avrgym.models.human import SEXES

MAX_SHOWN_PEOPLE = 150
"""Maximum number of sampled people in a figure, for each population and posture."""
HISTOGRAM_BIN_WIDTH_M = 0.01


def draw_torso_height_figure(trials: PostureTrials, people: Sequence[SampledPersonRow]) -> ReportFigure:
    """Returns a figure of the torso height distributions in the training populations.

    Each marker below them shows the torso height of one participant.
    """
    own = compute_torso_heights(trials)
    trained = {
        name: [row.torso_height_m for row in people if row.population == name]
        for name in HEIGHT_POPULATION_NAMES
    }
    samples = {"participants": own, **trained}
    edges = np.arange(
        min(map(min, samples.values())) - 2 * HISTOGRAM_BIN_WIDTH_M,
        max(map(max, samples.values())) + 2 * HISTOGRAM_BIN_WIDTH_M,
        HISTOGRAM_BIN_WIDTH_M,
    )
    with matplotlib.rc_context(MATPLOTLIB_STYLE):
        figure = Figure(figsize=(FIGURE_WIDTH_INCH, 3.0), layout="constrained")
        axes = figure.add_subplot()
        for (name, values), colour in zip(
            samples.items(), (TEXT_COLOUR, LINE_COLOURS[0], LINE_COLOURS[1]), strict=True
        ):
            label = name if name == "participants" else f"{name} people (simulation)"
            weights = np.full(len(values), 1.0 / len(values))
            axes.hist(values, edges.tolist(), weights=weights, histtype="step", color=colour, label=label)
        for sex, marker in zip(SEXES, "so", strict=True):
            marks = compute_torso_heights(trials, sex)
            label = {"man": "a man", "woman": "a woman"}[sex]
            axes.plot(
                marks, [-0.05] * len(marks), marker, color=TEXT_COLOUR, markersize=5, alpha=0.7, label=label
            )
        axes.axhline(0.0, color=TEXT_COLOUR, linewidth=0.6)
        axes.set(xlabel="torso height / m", ylabel="share per cm")
        add_legend(figure, columns=2)
    return make_report_figure(
        trials.is_simulated,
        "torso-heights",
        "Torso heights of participants and of training populations",
        figure,
    )


def draw_head_position_figure(trials: PostureTrials, people: Sequence[SampledPersonRow]) -> ReportFigure:
    """Returns a figure of head positions from the front and from the side.

    Points are mean head positions in trials, and head positions of people sampled from the training populations.
    """
    postures = trials.list_postures()
    with matplotlib.rc_context(MATPLOTLIB_STYLE):
        figure = Figure(figsize=(FIGURE_WIDTH_INCH, 0.7 + 2.4 * len(postures)), layout="constrained")
        for place, (posture, (axis, view)) in enumerate(product(postures, ((0, "x"), (1, "y")))):
            axes = figure.add_subplot(len(postures), 2, place + 1)
            _heads(axes, trials, people, posture, axis)
            words = {"x": "from the front", "y": "from the side"}[view]
            axes.set(
                xlabel=f"{view} / m",
                ylabel="z / m",
                title=f"{posture}, {words}",
                aspect="equal",
                adjustable="datalim",
            )
        add_legend(figure, columns=2)
    caption = (
        "Head centres of participants (mean of each trial) and of training populations (up to "
        f"{MAX_SHOWN_PEOPLE} people of each)"
    )
    return make_report_figure(trials.is_simulated, "head-positions", caption, figure)


def _heads(
    axes: Axes, group: PostureTrials, people: Sequence[SampledPersonRow], posture: str, axis: int
) -> None:
    for name, colour in zip(
        reversed(HEIGHT_POPULATION_NAMES), (LINE_COLOURS[1], LINE_COLOURS[0]), strict=True
    ):
        drawn = [row for row in people if (row.population, row.posture) == (name, posture)][:MAX_SHOWN_PEOPLE]
        _cloud(
            axes, drawn, axis, color=colour, alpha=0.4, markersize=2.5, label=f"{name} people (simulation)"
        )
    _cloud(
        axes,
        group.find_trials_in_posture(posture),
        axis,
        color=TEXT_COLOUR,
        markersize=3.5,
        label="a participant's trial",
    )


def _cloud(axes: Axes, rows: Sequence[Any], axis: int, **style: Any) -> None:
    places = np.array([read_head_position(row) for row in rows])
    axes.plot(places[:, axis], places[:, 2], "o", markeredgewidth=0, **style)
