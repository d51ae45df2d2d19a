"""The flow of participants as a picture, after CONSORT (Schulz et al., BMJ 340, 2010, c332): who left, and when."""

from collections.abc import Sequence
from html import escape

from avrgym.analysis.page import Markup
from avrgym.analysis.reading.flow import Flow

WIDTH, HEIGHT, GAP, SIDE = 260, 44, 44, 330
LINE = 18


def steps(flow: Flow) -> list[tuple[str, list[str]]]:
    """Each step with those who leave after it; nobody is told of where nobody left."""
    return [
        (
            f"Enrolled: {flow.enrolled}",
            _some(
                {
                    "excluded by the inclusion questions": flow.excluded,
                    "withdrew before the first trial was planned": flow.withdrew_before,
                    "no consent yet": flow.no_consent,
                    "inclusion questions not answered yet": flow.waiting,
                    "deleted with all data": flow.deleted,
                }
            ),
        ),
        (
            f"Given an order of trials: {flow.allocated}",
            _some({"withdrew": flow.withdrew, "not finished yet": flow.unfinished}),
        ),
        (f"Completed the study: {flow.completed}", []),
        (f"In the analysis: {flow.analysed}", []),
    ]


def _some(left: dict[str, int]) -> list[str]:
    return [f"{number} {why}" for why, number in left.items() if number]


def flow_chart(flow: Flow) -> Markup:
    """The flow as SVG; simulated participants are named as such in the picture."""
    title = "SIMULATED PARTICIPANTS" if flow.simulated else "Participants"
    parts = [f'<text x="10" y="20" font-weight="bold">{title}</text>']
    top, last = 34, -1
    for words, left in steps(flow):
        if last >= 0:
            parts.append(_arrow(10 + WIDTH / 2, last, 10 + WIDTH / 2, top))
        parts.append(_box(10, top, WIDTH, HEIGHT, [words]))
        last = top + HEIGHT
        if left:
            tall = 14 + LINE * len(left)
            aside = last + 12
            parts.append(_arrow(10 + WIDTH / 2, aside + tall / 2, 10 + WIDTH + 40, aside + tall / 2))
            parts.append(_box(10 + WIDTH + 40, aside, SIDE, tall, left))
            top = int(aside + tall + 14)
        else:
            top = last + GAP
    return Markup(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH + SIDE + 60} {last + 10}" role="img" '
        f'aria-label="Flow of participants" font-family="system-ui, sans-serif" font-size="14" fill="currentColor">'
        f"{''.join(parts)}</svg>"
    )


def _box(x: float, y: float, width: float, height: float, lines: Sequence[str]) -> str:
    first = y + (height - LINE * len(lines)) / 2 + 13
    words = "".join(
        f'<text x="{x + 10:g}" y="{first + LINE * number:g}">{escape(line)}</text>'
        for number, line in enumerate(lines)
    )
    return f'<rect x="{x:g}" y="{y:g}" width="{width}" height="{height}" fill="none" stroke="currentColor"/>{words}'


def _arrow(x1: float, y1: float, x2: float, y2: float) -> str:
    across = y1 == y2
    tip = (
        f"{x2 - 7:g},{y2 - 4:g} {x2 - 7:g},{y2 + 4:g}"
        if across
        else f"{x2 - 4:g},{y2 - 7:g} {x2 + 4:g},{y2 - 7:g}"
    )
    return (
        f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" stroke="currentColor"/>'
        f'<polygon points="{x2:g},{y2:g} {tip}"/>'
    )
