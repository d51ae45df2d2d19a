"""All figures of a study; those of objective measures, torso heights and head positions of one group."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Sequence
from itertools import product
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from avrgym.analysis.figures.answer_figures import (
    mean_answers_figures,
    session_answers_figures,
    trial_answers_figures,
)
from avrgym.analysis.figures.drawing import (
    GROUP_WIDTH,
    INK,
    LINES,
    STYLE,
    WIDTH_IN,
    Drawing,
    finished,
    name_marks,
    name_places,
)
from avrgym.analysis.reading.trained_people import HEIGHTS_OF, head_of
from avrgym.analysis.rows import ObjectiveRow, PersonRow
from avrgym.analysis.statistics.biomechanics import Measures, heights
from avrgym.analysis.study import Analysis
from avrgym.models.human import SEXES
from avrgym.study.design.design import Design

SHOWN_PEOPLE = 150
"""How many of the people drawn for each distribution and posture a figure shows."""
BIN_M = 0.01
PERCENTS = (0.0, 0.25, 0.5, 0.75, 1.0)
SIMULATION = "simulation"
"""The name of the marks of policies in simulation."""


def draw_study(analysis: Analysis) -> list[Drawing]:
    """All figures that there are data for, people's first."""
    drawings: list[Drawing] = []
    for simulated in sorted({row.simulated for row in analysis.objective}):
        drawings += [
            success_figure(analysis.design, simulated, analysis.objective),
            reward_figure(analysis.design, simulated, analysis.objective),
        ]
    for simulated in sorted({row.simulated for row in analysis.likert}):
        own = [row for row in analysis.likert if row.simulated is simulated]
        tests = [row for row in analysis.tests if row.simulated is simulated]
        drawings += trial_answers_figures(analysis.design, simulated, own, tests)
        drawings += session_answers_figures(analysis.design, simulated, own, tests)
        drawings += mean_answers_figures(analysis.design, simulated, analysis.subjective, tests)
    for group in analysis.groups:
        drawings.append(height_figure(group, analysis.people))
        drawings.append(head_figure(group, analysis.people))
    return drawings


# Objective measures


def success_figure(design: Design, simulated: bool, rows: Sequence[ObjectiveRow]) -> Drawing:
    """Success of each condition with its interval, beside simulation."""
    caption = _objective_caption("Success", simulated, rows)
    return _objective_figure(design, simulated, rows, "success", "success", "success_rate", caption)


def reward_figure(design: Design, simulated: bool, rows: Sequence[ObjectiveRow]) -> Drawing:
    """Mean reward of each condition with its interval, beside simulation."""
    caption = _objective_caption("Mean reward", simulated, rows)
    return _objective_figure(design, simulated, rows, "reward", "reward", "reward_mean", caption)


def _objective_caption(what: str, simulated: bool, rows: Sequence[ObjectiveRow]) -> str:
    measured = any(row.simulation_episodes for row in rows if row.simulated is simulated)
    return f"{what} in VR (bars){' and in simulation (diamonds)' if measured else ''}, with 95 % intervals"


def _objective_figure(
    design: Design,
    simulated: bool,
    rows: Sequence[ObjectiveRow],
    kind: str,
    interval: str,
    mean: str,
    caption: str,
) -> Drawing:
    columns = min(2, len(design.tasks))
    lines = -(-len(design.tasks) // columns)
    label = {"success": "success / %", "reward": "mean reward"}[kind]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.6 + 2.1 * lines), layout="constrained")
        for place, task in enumerate(design.tasks):
            axes = figure.add_subplot(lines, columns, place + 1)
            own = [row for row in rows if (row.simulated, row.task) == (simulated, task)]
            _conditions(axes, design, own, interval, mean)
            name_places(axes, design.robots, 0.8 * WIDTH_IN / columns)
            axes.set(title=task, xlabel="robot", ylabel=label)
            if interval == "success":
                axes.set_ylim(0.0, 1.05)
                axes.set_yticks(PERCENTS, [f"{100 * share:g}" for share in PERCENTS])
        name_marks(figure, columns=3)
    return finished(simulated, kind, caption, figure)


def _conditions(axes: Axes, design: Design, rows: Sequence[ObjectiveRow], interval: str, mean: str) -> None:
    width = GROUP_WIDTH / len(design.policies)
    for row in rows:
        policy = design.policies.index(row.policy)
        x = design.robots.index(row.robot) + width * (policy - (len(design.policies) - 1) / 2)
        colour = LINES[policy % len(LINES)]
        if getattr(row, mean) is not None:
            axes.bar(x, getattr(row, mean), 0.9 * width, color=colour, alpha=0.55, label=row.policy)
            _interval(axes, x - 0.12 * width, row, interval, "")
        if getattr(row, f"simulation_{mean}") is not None:
            value = getattr(row, f"simulation_{mean}")
            label = f"{SIMULATION}: {row.simulation_note}" if row.simulation_note else SIMULATION
            axes.plot(x + 0.2 * width, value, "D", color=INK, markersize=4, label=label)
            _interval(axes, x + 0.2 * width, row, interval, "simulation_")
    axes.axhline(0.0, color=INK, linewidth=0.6)


def _interval(axes: Axes, x: float, row: ObjectiveRow, interval: str, prefix: str) -> None:
    low, high = getattr(row, f"{prefix}{interval}_low"), getattr(row, f"{prefix}{interval}_high")
    if low is not None and high is not None:
        axes.plot([x, x], [low, high], color=INK, linewidth=1.0, label="95 % interval")


# Biomechanics


def height_figure(group: Measures, people: Sequence[PersonRow]) -> Drawing:
    """Torso heights of the participants, one mark each, above those of the training's people."""
    own = heights(group)
    trained = {name: [row.torso_height_m for row in people if row.people == name] for name in HEIGHTS_OF}
    samples = {"participants": own, **trained}
    edges = np.arange(
        min(map(min, samples.values())) - 2 * BIN_M, max(map(max, samples.values())) + 2 * BIN_M, BIN_M
    )
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.0), layout="constrained")
        axes = figure.add_subplot()
        for (name, values), colour in zip(samples.items(), (INK, LINES[0], LINES[1]), strict=True):
            label = name if name == "participants" else f"{name} people (simulation)"
            weights = np.full(len(values), 1.0 / len(values))
            axes.hist(values, edges.tolist(), weights=weights, histtype="step", color=colour, label=label)
        for sex, marker in zip(SEXES, "so", strict=True):
            marks = heights(group, sex)
            label = {"man": "a man", "woman": "a woman"}[sex]
            axes.plot(marks, [-0.05] * len(marks), marker, color=INK, markersize=5, alpha=0.7, label=label)
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.set(xlabel="torso height / m", ylabel="share per cm")
        name_marks(figure, columns=2)
    return finished(
        group.simulated, "torso-heights", "Torso heights of participants and of the training's people", figure
    )


def head_figure(group: Measures, people: Sequence[PersonRow]) -> Drawing:
    """Where heads were, in the mean of each trial, among those of the training's people; from front and side."""
    postures = group.postures()
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.7 + 2.4 * len(postures)), layout="constrained")
        for place, (posture, (axis, view)) in enumerate(product(postures, ((0, "x"), (1, "y")))):
            axes = figure.add_subplot(len(postures), 2, place + 1)
            _heads(axes, group, people, posture, axis)
            words = {"x": "from the front", "y": "from the side"}[view]
            axes.set(
                xlabel=f"{view} / m",
                ylabel="z / m",
                title=f"{posture}, {words}",
                aspect="equal",
                adjustable="datalim",
            )
        name_marks(figure, columns=2)
    caption = (
        "Centres of heads, in the mean of each trial, among the training's people (up to "
        f"{SHOWN_PEOPLE} of each distribution)"
    )
    return finished(group.simulated, "head-positions", caption, figure)


def _heads(axes: Axes, group: Measures, people: Sequence[PersonRow], posture: str, axis: int) -> None:
    for name, colour in zip(reversed(HEIGHTS_OF), (LINES[1], LINES[0]), strict=True):
        drawn = [row for row in people if (row.people, row.posture) == (name, posture)][:SHOWN_PEOPLE]
        _cloud(
            axes, drawn, axis, color=colour, alpha=0.4, markersize=2.5, label=f"{name} people (simulation)"
        )
    _cloud(axes, group.in_posture(posture), axis, color=INK, markersize=3.5, label="a participant's trial")


def _cloud(axes: Axes, rows: Sequence[Any], axis: int, **style: Any) -> None:
    places = np.array([head_of(row) for row in rows])
    axes.plot(places[:, axis], places[:, 2], "o", markeredgewidth=0, **style)
