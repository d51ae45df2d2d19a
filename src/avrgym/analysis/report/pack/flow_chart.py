"""The flow of participants as a picture, after CONSORT (Schulz et al., BMJ 340, 2010, c332): who left, and when."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping, Sequence
from textwrap import wrap

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from avrgym.analysis.figures.drawing import INK, STYLE, Drawing, finished
from avrgym.analysis.reading.flow import Flow

BOX_IN, SIDE_IN, GAP_IN, LINE_IN = 2.9, 2.9, 0.22, 0.17
"""Widths of the boxes of steps and of those who leave, the space between boxes, and the height of a line."""
LETTERS = 42
"""Number of letters that fit in a line of a box."""
UNKNOWN = "consent or withdrawal unknown, database lost"


def steps(flow: Flow) -> list[tuple[str, list[str]]]:
    """Each step with those who leave after it; nobody is told of where nobody left."""
    before = f"withdrew before the first trial was planned{_why(flow.withdrew_before_for)}"
    unfinished = f", of them {flow.analysed_unfinished} not finished yet" if flow.analysed_unfinished else ""
    return [
        (
            f"Enrolled: {flow.enrolled}",
            _some(
                {
                    f"excluded by the inclusion questions{_why(flow.excluded_by)}": flow.excluded,
                    before: flow.withdrew_before,
                    UNKNOWN: flow.unknown_before,
                    "no consent yet": flow.no_consent,
                    "inclusion questions not answered yet": flow.waiting,
                    "deleted with all data": flow.deleted,
                }
            ),
        ),
        (
            f"Given an order of trials: {flow.allocated}",
            _some(
                {
                    f"withdrew{_why(flow.withdrew_for)}": flow.withdrew,
                    UNKNOWN: flow.unknown,
                    "not finished yet": flow.unfinished,
                }
            ),
        ),
        (
            f"Completed the study: {flow.completed}",
            _some({"without a trial or answer that counts": flow.completed_without_data}),
        ),
        (f"In the analysis: {flow.analysed}{unfinished}", []),
    ]


def _why(reasons: Mapping[str, int]) -> str:
    """How often each reason was given, in brackets."""
    return f" ({'; '.join(f'{reason}: {number}' for reason, number in reasons.items())})" if reasons else ""


def _some(left: dict[str, int]) -> list[str]:
    return [f"{number} {why}" for why, number in left.items() if number]


def flow_chart(flow: Flow) -> Drawing:
    """The flow as a figure; one of simulated participants names them as such."""
    width_in, shown = BOX_IN + SIDE_IN + 3 * GAP_IN, steps(flow)
    boxes = [_tall(_lines([words])) for words, _ in shown]
    beside = [_tall(lines) + GAP_IN if (lines := _lines(left)) else 0.0 for _, left in shown]
    height_in = 0.3 + sum(boxes) + sum(beside) + GAP_IN * len(shown)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width_in, height_in))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0.0, width_in), ylim=(height_in, 0.0))
        axes.set_axis_off()
        top, middle = 0.3, GAP_IN + BOX_IN / 2
        for (words, left), tall, aside in zip(shown, boxes, beside, strict=True):
            _box(axes, GAP_IN, top, BOX_IN, _lines([words]))
            below = top + tall
            if left:
                at = below + GAP_IN / 2 + aside / 2
                _box(axes, BOX_IN + 2 * GAP_IN, at - (aside - GAP_IN) / 2, SIDE_IN, _lines(left))
                _arrow(axes, (middle, at), (BOX_IN + 2 * GAP_IN, at))
            top = below + aside + GAP_IN
            if words != shown[-1][0]:
                _arrow(axes, (middle, below), (middle, top))
    return finished(flow.simulated, "flow", "Flow of participants", figure)


def _lines(texts: Sequence[str]) -> list[str]:
    return [line for text in texts for line in wrap(text, LETTERS)]


def _tall(lines: Sequence[str]) -> float:
    """The height of a box with these lines."""
    return LINE_IN * (len(lines) + 1)


def _box(axes: Axes, x: float, y: float, width: float, lines: Sequence[str]) -> None:
    tall = _tall(lines)
    axes.add_patch(Rectangle((x, y), width, tall, fill=False, edgecolor=INK, linewidth=0.8))
    axes.text(x + 0.1, y + tall / 2, "\n".join(lines), fontsize=8, va="center", linespacing=1.2)


def _arrow(axes: Axes, begin: tuple[float, float], end: tuple[float, float]) -> None:
    axes.annotate("", end, begin, arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 0.8})
