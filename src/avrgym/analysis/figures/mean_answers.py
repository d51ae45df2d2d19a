"""Mean answers with each policy, as the paper's figure 8 was drawn."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Sequence

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from avrgym.analysis.figures.drawing import (
    GROUP_WIDTH,
    LETTER_WIDTH_IN,
    LINES,
    STYLE,
    WIDTH_IN,
    name_marks,
    name_places,
    p_words,
)
from avrgym.analysis.rows import SubjectiveRow, TestedRow
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.study.design.design import Design

ROW_WIDTH_IN = 4.2
"""The width of a row of bars."""
BAR_WIDTH_IN = 0.34
"""The least width of a bar, which has its mean above it."""


def means_figure(
    design: Design, questionnaire: Questionnaire, rows: Sequence[SubjectiveRow], tests: Sequence[TestedRow]
) -> Figure:
    """Mean answers to each item over all trials with each policy, in as many rows as they need."""
    items, count = questionnaire.items, _items_in_row(design, questionnaire.items)
    parts = [items[begin : begin + count] for begin in range(0, len(items), count)]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.4 + 2.4 * len(parts)), layout="constrained")
        for number, part in enumerate(parts, start=1):
            axes = figure.add_subplot(len(parts), 1, number)
            _bars(axes, design, part, rows)
            _scale(axes, questionnaire, part, tests if len(design.policies) == 2 else ())
            axes.set(xlim=(-0.5, len(parts[0]) - 0.5), xlabel="item")
        name_marks(figure, columns=len(design.policies))
    return figure


def _items_in_row(design: Design, items: Sequence[Item]) -> int:
    """How many items a row holds, by the width of their bars and names."""
    item_in = max(
        BAR_WIDTH_IN * len(design.policies) / GROUP_WIDTH,
        LETTER_WIDTH_IN * (1 + max(len(item.id) for item in items)),
    )
    return max(1, int(ROW_WIDTH_IN / item_in))


def _bars(axes: Axes, design: Design, items: Sequence[Item], rows: Sequence[SubjectiveRow]) -> None:
    """A bar for each item and policy, from the bottom of the axes on."""
    width = GROUP_WIDTH / len(design.policies)
    ids = [item.id for item in items]
    for index, policy in enumerate(design.policies):
        own = {row.item: row.mean for row in rows if row.policy == policy and row.item in ids}
        if own:
            places = [ids.index(item) + width * (index - (len(design.policies) - 1) / 2) for item in own]
            colour = LINES[index % len(LINES)]
            bars = axes.bar(places, list(own.values()), 0.9 * width, color=colour, alpha=0.55, label=policy)
            axes.bar_label(bars, fmt="%.1f", fontsize=7)
    name_places(axes, ids, ROW_WIDTH_IN)


def _scale(
    axes: Axes, questionnaire: Questionnaire, items: Sequence[Item], tests: Sequence[TestedRow]
) -> None:
    """The ends of the items' scales, with the tests above them."""
    scales = [questionnaire.scale_of(item) for item in items]
    least, most = min(scale.lowest for scale in scales), max(scale.highest for scale in scales)
    ids = [item.id for item in items]
    for row in tests:
        if row.quantity in ids:
            y = most + 0.1 * (most - least)
            axes.text(ids.index(row.quantity), y, p_words(row), fontsize=7, ha="center")
    axes.set_ylim(least, most)
    ticks = [tick for tick in axes.get_yticks() if least <= tick <= most]
    label = f"mean answer\n({least} to {most})" if len(set(scales)) == 1 else "mean answer\n(own scales)"
    axes.set(ylim=(least, most + (0.35 if tests else 0.12) * (most - least)), yticks=ticks, ylabel=label)
