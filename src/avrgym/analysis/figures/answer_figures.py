"""How a study's questionnaires were answered, as figures of one group."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterable, Iterator, Mapping, Sequence
from textwrap import wrap

import matplotlib
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from avrgym.analysis.figures.drawing import (
    GROUP_WIDTH,
    INK,
    LINES,
    RULE,
    STYLE,
    WIDTH_IN,
    Drawing,
    finished,
    name_marks,
)
from avrgym.analysis.rows import LikertRow, SubjectiveRow, TestedRow
from avrgym.analysis.statistics.families import LEAST_PARTICIPANTS, PARTICIPANT
from avrgym.analysis.statistics.objective import ALL
from avrgym.analysis.statistics.session_answers import WORDS, about_sessions, change_question
from avrgym.analysis.statistics.subjective import AFTER_TRIAL, asked_at, policies_question
from avrgym.recording.questionnaire import SESSION_MOMENTS, Item, Questionnaire
from avrgym.study.design.design import Design

LETTERS = 66
"""How many fit a line above the bars of an item."""
LINE = 0.55
"""The height of such a line as a share of a bar's."""


def trial_answers_figures(
    design: Design, simulated: bool, likert: Sequence[LikertRow], tests: Sequence[TestedRow]
) -> Iterator[Drawing]:
    """The paper's figure for each questionnaire: its items with each policy, and which policies differ."""
    for questionnaire in asked_at(design, AFTER_TRIAL):
        own = [row for row in likert if (row.questionnaire, row.moment) == (questionnaire.name, AFTER_TRIAL)]
        groups = {policy: [row for row in own if row.policy == policy] for policy in design.policies}
        if own:
            name, differ = (
                trial_figure_name(design, questionnaire),
                _differences(design, questionnaire, tests),
            )
            yield _likert_figure(simulated, name, questionnaire, groups, differ, "trials")


def mean_answers_figures(
    design: Design, simulated: bool, rows: Sequence[SubjectiveRow], tests: Sequence[TestedRow]
) -> Iterator[Drawing]:
    """The paper's figure 8 as it was drawn: mean answers over all trials with each policy."""
    for questionnaire in asked_at(design, AFTER_TRIAL):
        items = {item.id: item for item in questionnaire.items}
        own = [
            row for row in rows
            if (row.simulated, row.task, row.robot) == (simulated, ALL, ALL) and row.item in items
        ]  # fmt: skip
        if own:
            name = f"{trial_figure_name(design, questionnaire)}-means"
            differ = _differences(design, questionnaire, tests)
            yield finished(simulated, name, *_means_figure(design, questionnaire, own, differ))


def _differences(design: Design, questionnaire: Questionnaire, tests: Sequence[TestedRow]) -> list[TestedRow]:
    """The tests between policies that a figure shows: each value is one participant's mean."""
    family = policies_question(design, questionnaire).by(PARTICIPANT)
    return _of_enough(row for row in tests if row.family == family)


def _of_enough(tests: Iterable[TestedRow]) -> list[TestedRow]:
    return [row for row in tests if row.n_a >= LEAST_PARTICIPANTS]


def _means_figure(
    design: Design, questionnaire: Questionnaire, rows: Sequence[SubjectiveRow], tests: Sequence[TestedRow]
) -> tuple[str, Figure]:
    width = GROUP_WIDTH / len(design.policies)
    ids = [item.id for item in questionnaire.items]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 2.8), layout="constrained")
        axes = figure.add_subplot()
        for index, policy in enumerate(design.policies):
            own = {row.item: row.mean for row in rows if row.policy == policy}
            places = [ids.index(item) + width * (index - (len(design.policies) - 1) / 2) for item in own]
            colour = LINES[index % len(LINES)]
            if own:
                bars = axes.bar(
                    places, list(own.values()), 0.9 * width, color=colour, alpha=0.55, label=policy
                )
                axes.bar_label(bars, fmt="%.1f", fontsize=7)
        scales = [questionnaire.scale_of(item) for item in questionnaire.items]
        least, most = min(scale.lowest for scale in scales), max(scale.highest for scale in scales)
        for row in tests if len(design.policies) == 2 else ():
            y = most + 0.05 * (most - least)
            axes.text(ids.index(row.quantity), y, _p_text(row), fontsize=7, ha="center")
        ticks = [tick for tick in axes.get_yticks() if least <= tick <= most]
        axes.set(ylim=(least, most + 0.2 * (most - least)), yticks=ticks, ylabel="mean answer")
        axes.set_xticks(range(len(ids)), ids)
        name_marks(figure, columns=len(design.policies))
    tested = "; p over participants, corrected by Holm" if tests and len(design.policies) == 2 else ""
    return f"{questionnaire.name}: mean answers over all trials, as the paper drew them{tested}", figure


def session_answers_figures(
    design: Design, simulated: bool, likert: Sequence[LikertRow], tests: Sequence[TestedRow]
) -> Iterator[Drawing]:
    """For each questionnaire about sessions its items before and after, and which changed."""
    for questionnaire in about_sessions(design):
        own = [row for row in likert if row.questionnaire == questionnaire.name]
        groups = {
            WORDS[moment]: [row for row in own if row.moment == moment]
            for moment in SESSION_MOMENTS
            if moment in questionnaire.moments
        }
        family = change_question(questionnaire).by(PARTICIPANT)
        differ = _of_enough(row for row in tests if row.family == family)
        if any(groups.values()):
            name = session_figure_name(questionnaire)
            yield _likert_figure(simulated, name, questionnaire, groups, differ, "participants")


def trial_figure_name(design: Design, questionnaire: Questionnaire) -> str:
    """The figure of answers after trials, named where there are several questionnaires."""
    return "likert" if len(asked_at(design, AFTER_TRIAL)) == 1 else f"likert-{questionnaire.name}"


def session_figure_name(questionnaire: Questionnaire) -> str:
    """The figure of answers about sessions."""
    return f"sessions-{questionnaire.name}"


def _likert_figure(
    simulated: bool,
    name: str,
    questionnaire: Questionnaire,
    groups: Mapping[str, Sequence[LikertRow]],
    tests: Sequence[TestedRow],
    unit: str,
) -> Drawing:
    """How each item of a questionnaire was answered in each group, in its own words, and which groups differ."""
    heads = [_head(questionnaire, item) for item in questionnaire.items]
    spaces = [LINE * head.count("\n") + LINE + 0.9 for head in heads]
    tops = [sum(spaces[: index + 1]) + len(groups) * index for index in range(len(heads))]
    bottom = tops[-1] + len(groups)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.3 + 0.25 * bottom), layout="constrained")
        axes = figure.add_subplot()
        for item, head, top in zip(questionnaire.items, heads, tops, strict=True):
            axes.text(-1.0, top - 0.62, head, fontsize=8, va="bottom", linespacing=1.2, parse_math=False)
            _bars(axes, top, item, questionnaire.scale_of(item).middle, groups)
            _brackets(axes, top, list(groups), [row for row in tests if row.quantity == item.id])
        places = [top + place for top in tops for place in range(len(groups))]
        axes.set_yticks(places, list(groups) * len(tops))
        axes.set(xlim=(-1.0, 1.4), ylim=(bottom - 0.4, 0.0), xticks=[])
        axes.spines[["left", "bottom"]].set_visible(False)
        axes.tick_params(length=0)
        axes.axvline(0.0, color=RULE, linewidth=0.8, zorder=0)
    return finished(simulated, name, _caption(questionnaire, unit, bool(tests)), figure)


def _caption(questionnaire: Questionnaire, unit: str, tested: bool) -> str:
    scales = dict.fromkeys(questionnaire.scale_words(item) for item in questionnaire.items)
    scale = next(iter(scales)) if len(scales) == 1 else "each item on its own scale"
    tests = (
        "; p by Wilcoxon's signed-rank test over participants, corrected by Holm; * < 0.05, ** < 0.01, *** < 0.001"
        if tested
        else ""
    )
    return f"{questionnaire.name}: answers {scale}, centred on the middle, numbers of {unit}{tests}"


def _head(questionnaire: Questionnaire, item: Item) -> str:
    """An item's words and scale in lines that fit the figure."""
    words = f"{item.id}  {item.text}", questionnaire.scale_words(item)
    return "\n".join(line for each in words for line in wrap(each, LETTERS))


def _bars(
    axes: Axes, top: float, item: Item, neutral: float, groups: Mapping[str, Sequence[LikertRow]]
) -> None:
    """A bar for each group."""
    for place, rows in enumerate(groups.values()):
        own = sorted((row for row in rows if row.item == item.id), key=lambda row: row.value)
        _stack(axes, top + place, own, neutral)


def _stack(axes: Axes, y: float, rows: Sequence[LikertRow], neutral: float) -> None:
    """A bar of shares by value, its neutral value centred on zero."""
    below = sum(row.share for row in rows if row.value < neutral)
    at = sum(row.share for row in rows if row.value == neutral)
    left = -(below + at / 2)
    colours = colormaps["PuOr"](np.linspace(0.08, 0.92, len(rows)))
    for row, colour in zip(rows, colours, strict=True):
        axes.barh(y, row.share, 0.86, left, color=to_hex(colour))
        if row.share > 0.04:
            shade = "#ffffff" if np.dot(colour[:3], (0.3, 0.6, 0.1)) < 0.5 else "#1c2025"
            axes.text(
                left + row.share / 2, y, str(row.count), color=shade, fontsize=7, ha="center", va="center"
            )
        left += row.share


def _brackets(axes: Axes, top: float, groups: Sequence[str], tests: Sequence[TestedRow]) -> None:
    """Which groups differ in an item, beside its bars."""
    for index, row in enumerate(tests):
        first, second = (top + groups.index(group) for group in (row.group_b, row.group_a))
        x = 1.02 + 0.2 * index
        axes.plot([x, x + 0.02, x + 0.02, x], [first, first, second, second], color=INK, linewidth=0.8)
        axes.text(x + 0.04, (first + second) / 2, _p_text(row), fontsize=7, va="center")


def _p_text(row: TestedRow) -> str:
    if row.p_holm is None:
        return "no test"
    shown = "p < 0.001" if row.p_holm < 0.001 else f"p = {row.p_holm:.3f}"
    return f"{shown}\n{row.mark}" if row.mark else shown
