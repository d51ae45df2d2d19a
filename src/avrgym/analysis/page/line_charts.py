"""Line charts of trials as small SVG elements in the colours of the page.

A report has up to three charts for each trial. This module draws a chart in 0.4 ms; Matplotlib needs 60 ms.
"""

import math
from collections.abc import Mapping, Sequence
from html import escape
from itertools import accumulate

from avrgym.analysis.page.html_elements import Markup, render_figure, tag
from avrgym.recording.schema import Control

CHART_WIDTH_PX, CHART_HEIGHT_PX = 460, 200
LEFT_MARGIN_PX, RIGHT_MARGIN_PX, TOP_MARGIN_PX, BOTTOM_MARGIN_PX = 52, 8, 10, 38
LINE_COLOUR_COUNT = 6
LEGEND_LINE_HEIGHT_PX = 16
"""Height of one line of the legend below a chart, in SVG units (pixels)."""


def draw_trial_charts(
    times_s: Sequence[float], steps: Sequence[Control], weights: Mapping[str, float]
) -> Markup:
    """Returns line charts over time: distance, contact force and accumulated reward terms of a trial.

    Reward terms are multiplied by their weights. A term without a weight has weight 1. Terms that are always zero are
    omitted.
    """
    terms = {
        name: list(accumulate(weights.get(name, 1.0) * step.reward_terms.get(name, 0.0) for step in steps))
        for name in dict.fromkeys(name for step in steps for name in step.reward_terms)
    }
    moved = {name: sums for name, sums in terms.items() if any(sums)}
    charts = [
        draw_line_chart("Distance to the target", "m", times_s, {"": [step.distance_m for step in steps]}),
        draw_line_chart(
            "Force on the person", "N", times_s, {"": [step.force_on_person_n for step in steps]}
        ),
    ]
    if moved:
        charts.append(draw_line_chart("Reward so far, by weighted term", "reward", times_s, moved))
    return tag("div", *charts, class_="figures")


def draw_line_chart(
    caption: str, unit: str, times_s: Sequence[float], lines: Mapping[str, Sequence[float]]
) -> Markup:
    """Returns a line chart of values over time, with a line for each name. A chart of several lines has a legend.

    Values that are not finite are omitted.
    """
    shown = {name: _finite(times_s, values) for name, values in lines.items()}
    values = [value for points in shown.values() for _, value in points]
    low, high, step = _axis(min([0.0, *values]), max([0.0, *values]))
    begin, end = min(times_s), max(times_s)
    scale_x = (CHART_WIDTH_PX - LEFT_MARGIN_PX - RIGHT_MARGIN_PX) / max(end - begin, 1e-9)
    scale_y = (CHART_HEIGHT_PX - TOP_MARGIN_PX - BOTTOM_MARGIN_PX) / (high - low)

    def point(time_s: float, value: float) -> str:
        return f"{LEFT_MARGIN_PX + (time_s - begin) * scale_x:.1f},{TOP_MARGIN_PX + (high - value) * scale_y:.1f}"

    ticks = [low + step * k for k in range(round((high - low) / step) + 1)]
    parts = [_grid_line(TOP_MARGIN_PX + (high - tick) * scale_y, _short(tick, step)) for tick in ticks]
    parts += [
        _time_tick(LEFT_MARGIN_PX + (second - begin) * scale_x, second) for second in _seconds(begin, end)
    ]
    for index, points in enumerate(shown.values()):
        path = " ".join(point(*each) for each in _without_plateaus(points))
        parts.append(f'<polyline points="{path}" fill="none" stroke="{_colour(index)}" stroke-width="1.5"/>')
    height = CHART_HEIGHT_PX + (LEGEND_LINE_HEIGHT_PX * math.ceil(len(lines) / 2) if len(lines) > 1 else 0)
    parts += _key(list(lines)) if len(lines) > 1 else []
    parts.append(
        _text(14, (TOP_MARGIN_PX + CHART_HEIGHT_PX - BOTTOM_MARGIN_PX) / 2, unit, "middle", turned=True)
    )
    parts.append(
        _text(
            (LEFT_MARGIN_PX + CHART_WIDTH_PX - RIGHT_MARGIN_PX) / 2, CHART_HEIGHT_PX - 6, "time / s", "middle"
        )
    )
    svg = f'<svg viewBox="0 0 {CHART_WIDTH_PX} {height}" role="img" aria-label="{escape(caption)}" font-size="11">'
    return render_figure(Markup(f"{svg}{''.join(parts)}</svg>"), caption)


def _finite(times_s: Sequence[float], values: Sequence[float]) -> list[tuple[float, float]]:
    return [(t, v) for t, v in zip(times_s, values, strict=True) if math.isfinite(v)]


def _without_plateaus(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Returns the points. Points with the same value as both neighbours are omitted."""
    inner = zip(points, points[1:], points[2:], strict=False)
    kept = [here for before, here, after in inner if not before[1] == here[1] == after[1]]
    return [*points[:1], *kept, *points[1:][-1:]]


def _axis(low: float, high: float) -> tuple[float, float, float]:
    """Returns lower limit, upper limit and tick distance of an axis from ``low`` to ``high``.

    All three are round numbers. The axis has about four ticks.
    """
    span = max(high - low, 1e-3)
    power = 10.0 ** math.floor(math.log10(span / 4.0))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if span / step <= 5.0)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return first * step, max(last, first + 1) * step, step


def _seconds(begin: float, end: float) -> list[float]:
    _, _, step = _axis(0.0, end - begin)
    first = math.ceil(begin / step - 1e-9)
    return [k * step for k in range(first, math.floor(end / step + 1e-9) + 1)]


def _short(value: float, step: float) -> str:
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value:z.{digits}f}".replace("-", "−")


def _grid_line(y: float, text: str) -> str:
    line = f'<path d="M{LEFT_MARGIN_PX} {y:.1f}H{CHART_WIDTH_PX - RIGHT_MARGIN_PX}" stroke="var(--rule)"/>'
    return line + _text(LEFT_MARGIN_PX - 5, y + 4, text, "end")


def _time_tick(x: float, second: float) -> str:
    return _text(x, CHART_HEIGHT_PX - BOTTOM_MARGIN_PX + 16, f"{second:g}", "middle")


def _key(names: list[str]) -> list[str]:
    parts: list[str] = []
    for index, name in enumerate(names):
        x, y = (
            LEFT_MARGIN_PX + index % 2 * (CHART_WIDTH_PX - LEFT_MARGIN_PX) / 2,
            CHART_HEIGHT_PX + LEGEND_LINE_HEIGHT_PX * (index // 2) + 6,
        )
        parts.append(f'<path d="M{x:g} {y - 4}h18" stroke="{_colour(index)}" stroke-width="2"/>')
        parts.append(_text(x + 23, y, name, "start"))
    return parts


def _colour(index: int) -> str:
    return f"var(--line-{index % LINE_COLOUR_COUNT + 1})"


def _text(x: float, y: float, text: str, anchor: str, turned: bool = False) -> str:
    turn = f' transform="rotate(-90 {x:g} {y:g})"' if turned else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="currentColor"{turn}>{escape(text)}</text>'
