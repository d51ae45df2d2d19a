"""Figures of questionnaire answers, for people or for simulated participants."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterable, Iterator, Mapping, Sequence
from textwrap import fill, wrap

import matplotlib
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from avrgym.analysis.answers.session_answers import (
    MOMENT_LABELS,
    find_session_questionnaires,
    make_session_change_question,
)
from avrgym.analysis.answers.trial_answers import (
    AFTER_TRIAL,
    AnswerFrequencyRow,
    AnswerSummaryRow,
    find_questionnaires_at_moment,
    make_policy_comparison_question,
)
from avrgym.analysis.page.hypothesis_test_tables import format_corrected_p_with_stars
from avrgym.analysis.page.report_figures import (
    BAR_GROUP_WIDTH,
    CHARACTER_WIDTH_INCH,
    FIGURE_WIDTH_INCH,
    LINE_COLOURS,
    MATPLOTLIB_STYLE,
    RULE_COLOUR,
    TEXT_COLOUR,
    TEXT_ON_DARK_COLOUR,
    TEXT_ON_LIGHT_COLOUR,
    ReportFigure,
    add_legend,
    label_x_ticks,
    make_report_figure,
)
from avrgym.analysis.reading.table_rows import ALL_LABEL
from avrgym.analysis.statistics.comparisons import (
    MIN_PARTICIPANTS,
    PARTICIPANT_UNIT,
    PRIMARY_ROLE,
    ComparisonRow,
)
from avrgym.questionnaires.questionnaire import SESSION_QUESTION_MOMENTS, Item, Questionnaire
from avrgym.study.design.design import Design

TEXT_LINE_HEIGHT = 0.55
"""Height of a text line, in units of the height of a bar."""
TEST_BRACKET_WIDTH_INCH = 0.62
"""Width of the bracket of a test in inches, including the text of its result."""
MAX_TEST_BRACKETS = 6
"""Maximum number of test brackets for one item. If an item has more tests, the figure contains no tests."""


def draw_trial_answer_figures(
    design: Design, simulated: bool, likert: Sequence[AnswerFrequencyRow], tests: Sequence[ComparisonRow]
) -> Iterator[ReportFigure]:
    """Yields a figure for each questionnaire after trials: distribution of answers by policy, and tests of the
    paper."""
    for questionnaire in find_questionnaires_at_moment(design, AFTER_TRIAL):
        own = [row for row in likert if (row.questionnaire, row.moment) == (questionnaire.name, AFTER_TRIAL)]
        groups = {policy: [row for row in own if row.policy == policy] for policy in design.policies}
        if own:
            name, differ = (
                make_trial_answer_figure_name(design, questionnaire),
                _differences(design, questionnaire, tests),
            )
            yield _likert_figure(simulated, name, questionnaire, groups, differ, ("policy", "trials"))


def draw_mean_answer_figures(
    design: Design, simulated: bool, rows: Sequence[AnswerSummaryRow], tests: Sequence[ComparisonRow]
) -> Iterator[ReportFigure]:
    """Yields a bar chart for each questionnaire after trials: mean answer to each item by policy (paper, Figure 8)."""
    for questionnaire in find_questionnaires_at_moment(design, AFTER_TRIAL):
        items = {item.id: item for item in questionnaire.items}
        own = [
            row for row in rows
            if (row.simulated, row.task, row.robot) == (simulated, ALL_LABEL, ALL_LABEL) and row.item in items
        ]  # fmt: skip
        if own:
            differ = _differences(design, questionnaire, tests) if len(design.policies) == 2 else []
            tested = "; p over participants, corrected over all primary results" if differ else ""
            caption = f"{questionnaire.name}: mean answers over all trials, as in the paper{tested}"
            figure = draw_mean_answer_chart(design, questionnaire, own, differ)
            yield make_report_figure(
                simulated,
                f"{make_trial_answer_figure_name(design, questionnaire)}-means",
                caption,
                figure,
                format_proxy_answer_note(sum(row.by_proxy for row in own), sum(row.n for row in own)),
            )


def _differences(
    design: Design, questionnaire: Questionnaire, tests: Sequence[ComparisonRow]
) -> list[ComparisonRow]:
    """Returns the tests between policies, by participant: each participant has one value, the mean over trials."""
    family = make_policy_comparison_question(design, questionnaire).make_family_name(PARTICIPANT_UNIT)
    return _shown(row for row in tests if row.family == family)


def _shown(tests: Iterable[ComparisonRow]) -> list[ComparisonRow]:
    """Returns the tests to draw: the primary tests with at least ``MIN_PARTICIPANTS`` participants."""
    return [row for row in tests if row.role == PRIMARY_ROLE and row.n_a >= MIN_PARTICIPANTS]


def draw_session_answer_figures(
    design: Design, simulated: bool, likert: Sequence[AnswerFrequencyRow], tests: Sequence[ComparisonRow]
) -> Iterator[ReportFigure]:
    """Yields a figure for each questionnaire about sessions: answers before and after the sessions, and tests of the
    change."""
    for questionnaire in find_session_questionnaires(design):
        own = [row for row in likert if row.questionnaire == questionnaire.name]
        groups = {
            MOMENT_LABELS[moment]: [row for row in own if row.moment == moment]
            for moment in SESSION_QUESTION_MOMENTS
            if moment in questionnaire.moments
        }
        family = make_session_change_question(questionnaire).make_family_name(PARTICIPANT_UNIT)
        differ = _shown(row for row in tests if row.family == family)
        if any(groups.values()):
            name, words = make_session_answer_figure_name(questionnaire), ("session", "participants")
            yield _likert_figure(simulated, name, questionnaire, groups, differ, words)


def make_trial_answer_figure_name(design: Design, questionnaire: Questionnaire) -> str:
    """Returns the file name (without suffix) of the figure of the answers after trials.

    With several questionnaires after trials, the file name contains the questionnaire's name.
    """
    return (
        "likert"
        if len(find_questionnaires_at_moment(design, AFTER_TRIAL)) == 1
        else f"likert-{questionnaire.name}"
    )


def make_session_answer_figure_name(questionnaire: Questionnaire) -> str:
    """Returns the file name (without suffix) of the figure of the answers about sessions."""
    return f"sessions-{questionnaire.name}"


def _likert_figure(
    simulated: bool,
    name: str,
    questionnaire: Questionnaire,
    groups: Mapping[str, Sequence[AnswerFrequencyRow]],
    tests: Sequence[ComparisonRow],
    words: tuple[str, str],
) -> ReportFigure:
    """Returns a figure of the distribution of answers to each item: a bar for each group, and tests between groups.

    ``words``: a noun for the groups (such as "policy"), and a noun for the numbers in the bars (such as "trials").
    """
    what, counted = words
    by_item = {item.id: [row for row in tests if row.quantity == item.id] for item in questionnaire.items}
    brackets = max(map(len, by_item.values()))
    brackets = brackets if brackets <= MAX_TEST_BRACKETS else 0
    width_in = FIGURE_WIDTH_INCH + TEST_BRACKET_WIDTH_INCH * max(0, brackets - 1)
    axes_in = width_in - 0.45 - CHARACTER_WIDTH_INCH * max(map(len, groups))
    share_in = (axes_in - TEST_BRACKET_WIDTH_INCH * brackets) / 2.04
    common = _common_scale(questionnaire)
    heads = [
        _head(questionnaire, item, int(axes_in / CHARACTER_WIDTH_INCH), common)
        for item in questionnaire.items
    ]
    spaces = [TEXT_LINE_HEIGHT * head.count("\n") + TEXT_LINE_HEIGHT + 0.9 for head in heads]
    tops = [sum(spaces[: index + 1]) + len(groups) * index for index in range(len(heads))]
    bottom = tops[-1] + len(groups)
    with matplotlib.rc_context(MATPLOTLIB_STYLE):
        figure = Figure(figsize=(width_in, 0.8 + 0.25 * bottom), layout="constrained")
        axes = figure.add_subplot()
        for item, head, top in zip(questionnaire.items, heads, tops, strict=True):
            axes.text(-1.0, top - 0.62, head, fontsize=8, va="bottom", linespacing=1.2)
            _bars(axes, top, item, questionnaire.find_response_scale(item).middle_value, groups, share_in)
            _brackets(
                axes,
                top,
                list(groups),
                by_item[item.id] if brackets else (),
                TEST_BRACKET_WIDTH_INCH / share_in,
            )
        places = [top + place for top in tops for place in range(len(groups))]
        axes.set_yticks(places, list(groups) * len(tops))
        scale = f"answers {common}" if common else "each item on its own scale"
        label = f"{counted} / %, the scale's middle at 0\n{fill(scale, min(66, int(axes_in / CHARACTER_WIDTH_INCH)))}"
        _axis(axes, brackets * TEST_BRACKET_WIDTH_INCH / share_in, label)
        axes.set_ylabel(what)
        axes.set_ylim(bottom - 0.4, 0.0)
    rows = [row for own in groups.values() for row in own]
    note = format_proxy_answer_note(sum(row.by_proxy for row in rows), sum(row.count for row in rows))
    return make_report_figure(simulated, name, _caption(questionnaire, counted, bool(brackets)), figure, note)


def format_proxy_answer_note(by_proxy: int, answers: int) -> str:
    """Returns a note such as "3 of 40 answers by a proxy"; empty without answers by a proxy."""
    return f"{by_proxy} of {answers} answers by a proxy" if by_proxy else ""


def _axis(axes: Axes, beside: float, label: str) -> None:
    """Draw the x axis (share of answers, 0 to 1). ``beside``: width of the space for tests on the right, in units of
    the axis."""
    axes.set(xlim=(-1.0, 1.04 + beside), xlabel=label)
    axes.set_xticks([-1.0, -0.5, 0.0, 0.5, 1.0], ["100", "50", "0", "50", "100"])
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(length=0)
    axes.axvline(0.0, color=RULE_COLOUR, linewidth=0.8, zorder=0)


def _caption(questionnaire: Questionnaire, unit: str, tested: bool) -> str:
    scale = _common_scale(questionnaire) or "on each item's own scale"
    tests = (
        "; p by Wilcoxon's signed-rank test over participants, corrected over all primary results; * < 0.05, "
        "** < 0.01, *** < 0.001"
        if tested
        else ""
    )
    colours = "from brown to purple"
    return (
        f"{questionnaire.name}: answers {scale}, {colours}, centred on the middle, numbers of {unit}{tests}"
    )


def _common_scale(questionnaire: Questionnaire) -> str:
    """Returns a text with the response scale of all items; empty if the items have different scales."""
    scales = dict.fromkeys(questionnaire.describe_response_scale(item) for item in questionnaire.items)
    return next(iter(scales)) if len(scales) == 1 else ""


def _head(questionnaire: Questionnaire, item: Item, letters: int, common: str) -> str:
    """Returns the item text in lines of at most ``letters`` characters.

    If ``common`` (see ``_common_scale``) is empty, the text also contains the item's response scale.
    """
    words = [f"{item.id}  {item.text}", *([] if common else [questionnaire.describe_response_scale(item)])]
    return "\n".join(line for each in words for line in wrap(each, letters))


def _bars(
    axes: Axes,
    top: float,
    item: Item,
    neutral: float,
    groups: Mapping[str, Sequence[AnswerFrequencyRow]],
    share_in: float,
) -> None:
    """Draw a stacked bar of the answers to ``item`` for each group. ``top``: y coordinate of the first bar."""
    for place, rows in enumerate(groups.values()):
        own = sorted((row for row in rows if row.item == item.id), key=lambda row: row.value)
        _stack(axes, top + place, own, neutral, share_in)


def _stack(axes: Axes, y: float, rows: Sequence[AnswerFrequencyRow], neutral: float, share_in: float) -> None:
    """Draw one stacked bar with the neutral value at x = 0. ``share_in``: length in inches of a share of 1."""
    below = sum(row.share for row in rows if row.value < neutral)
    at = sum(row.share for row in rows if row.value == neutral)
    left = -(below + at / 2)
    colours = colormaps["PuOr"](np.linspace(0.08, 0.92, len(rows)))
    for row, colour in zip(rows, colours, strict=True):
        axes.barh(y, row.share, 0.86, left, color=to_hex(colour))
        number = str(row.count)
        if row.share * share_in > CHARACTER_WIDTH_INCH * len(number):
            shade = TEXT_ON_DARK_COLOUR if np.dot(colour[:3], (0.3, 0.6, 0.1)) < 0.5 else TEXT_ON_LIGHT_COLOUR
            axes.text(left + row.share / 2, y, number, color=shade, fontsize=7, ha="center", va="center")
        left += row.share


def _brackets(
    axes: Axes, top: float, groups: Sequence[str], tests: Sequence[ComparisonRow], width: float
) -> None:
    """Draw a bracket with p value and significance stars for each tested pair of groups."""
    for index, row in enumerate(tests):
        first, second = (top + groups.index(group) for group in (row.group_b, row.group_a))
        x = 1.02 + width * index
        axes.plot(
            [x, x + 0.02, x + 0.02, x], [first, first, second, second], color=TEXT_COLOUR, linewidth=0.8
        )
        axes.text(x + 0.04, (first + second) / 2, format_corrected_p_with_stars(row), fontsize=7, va="center")


BAR_ROW_WIDTH_INCH = 4.2
"""Width in inches of a row of bars (all bars of one subplot)."""
MIN_BAR_WIDTH_INCH = 0.34
"""Minimum width of a bar in inches. The mean is printed above the bar."""


def draw_mean_answer_chart(
    design: Design,
    questionnaire: Questionnaire,
    rows: Sequence[AnswerSummaryRow],
    tests: Sequence[ComparisonRow],
) -> Figure:
    """Returns a bar chart: mean answer to each item for each policy. Many items are divided into several rows."""
    items, count = questionnaire.items, _items_in_row(design, questionnaire.items)
    parts = [items[begin : begin + count] for begin in range(0, len(items), count)]
    with matplotlib.rc_context(MATPLOTLIB_STYLE):
        figure = Figure(figsize=(FIGURE_WIDTH_INCH, 0.4 + 2.4 * len(parts)), layout="constrained")
        for number, part in enumerate(parts, start=1):
            axes = figure.add_subplot(len(parts), 1, number)
            _mean_bars(axes, design, part, rows)
            _mean_axis(axes, questionnaire, part, tests if len(design.policies) == 2 else ())
            axes.set(xlim=(-0.5, len(parts[0]) - 0.5), xlabel="item")
        add_legend(figure, columns=len(design.policies))
    return figure


def _items_in_row(design: Design, items: Sequence[Item]) -> int:
    """Returns the maximum number of items in a row of bars, at the minimum width of a bar."""
    item_in = max(
        MIN_BAR_WIDTH_INCH * len(design.policies) / BAR_GROUP_WIDTH,
        CHARACTER_WIDTH_INCH * (1 + max(len(item.id) for item in items)),
    )
    return max(1, int(BAR_ROW_WIDTH_INCH / item_in))


def _mean_bars(axes: Axes, design: Design, items: Sequence[Item], rows: Sequence[AnswerSummaryRow]) -> None:
    """Draw a bar for the mean answer to each item with each policy."""
    width = BAR_GROUP_WIDTH / len(design.policies)
    ids = [item.id for item in items]
    for index, policy in enumerate(design.policies):
        own = {row.item: row.mean for row in rows if row.policy == policy and row.item in ids}
        if own:
            places = [ids.index(item) + width * (index - (len(design.policies) - 1) / 2) for item in own]
            colour = LINE_COLOURS[index % len(LINE_COLOURS)]
            bars = axes.bar(places, list(own.values()), 0.9 * width, color=colour, alpha=0.55, label=policy)
            axes.bar_label(bars, fmt="%.1f", fontsize=7)
    label_x_ticks(axes, ids, BAR_ROW_WIDTH_INCH)


def _mean_axis(
    axes: Axes, questionnaire: Questionnaire, items: Sequence[Item], tests: Sequence[ComparisonRow]
) -> None:
    """Set the y axis to the range of the response scales, and print the tests above the bars."""
    scales = [questionnaire.find_response_scale(item) for item in items]
    minimum, maximum = (
        min(scale.lowest_value for scale in scales),
        max(scale.highest_value for scale in scales),
    )
    ids = [item.id for item in items]
    for row in tests:
        if row.quantity in ids:
            y = maximum + 0.1 * (maximum - minimum)
            axes.text(ids.index(row.quantity), y, format_corrected_p_with_stars(row), fontsize=7, ha="center")
    axes.set_ylim(minimum, maximum)
    ticks = [tick for tick in axes.get_yticks() if minimum <= tick <= maximum]
    label = f"mean answer\n({minimum} to {maximum})" if len(set(scales)) == 1 else "mean answer\n(own scales)"
    axes.set(
        ylim=(minimum, maximum + (0.35 if tests else 0.12) * (maximum - minimum)), yticks=ticks, ylabel=label
    )
