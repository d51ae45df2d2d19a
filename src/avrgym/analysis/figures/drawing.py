"""The figures of a study, drawn once: as files of their own, and inside a page in its colours."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import io
import re
from collections.abc import Mapping
from html import escape
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from avrgym.analysis.page import Markup

# Colours that matplotlib writes; a file has those of a white page, a page its own, light or dark.
INK, GROUND, RULE, WARNING = "#00000a", "#00000b", "#00000c", "#00000d"
LINES = tuple(f"#00001{index}" for index in range(1, 7))
_ON_WHITE = {INK: "#1c2024", GROUND: "#ffffff", RULE: "#d5dae0", WARNING: "#8a3b00"} | dict(
    zip(LINES, ("#0b62a8", "#b1560f", "#1b7a43", "#8b3a8f", "#6b6b00", "#b3263a"), strict=True)
)
_IN_PAGE = {INK: "currentColor", GROUND: "none", RULE: "var(--rule)", WARNING: "var(--warning)"} | {
    colour: f"var(--line-{index})" for index, colour in enumerate(LINES, start=1)
}
WIDTH_IN = 5.0
GROUP_WIDTH = 0.8
"""What the bars of one group take of the space from one group to the next."""
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "avrgym",
    "font.family": "sans-serif",
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": GROUND,
    "axes.facecolor": "none",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}


class Drawing:
    """A figure as SVG, whose colours are still to be chosen."""

    def __init__(self, name: str, caption: str, figure: Figure) -> None:
        """Take what was drawn; ``name`` is the file's, ``caption`` says in words what is to be seen."""
        self.name, self.caption = name, caption
        buffer = io.StringIO()
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        with matplotlib.rc_context(STYLE):
            figure.savefig(buffer, format="svg", metadata=nothing)
        self._svg = buffer.getvalue()

    def file(self) -> bytes:
        """The file, in the colours of a white page."""
        return _coloured(self._svg, _ON_WHITE).encode()

    def inline(self) -> Markup:
        """The figure as part of a page: its own ids, the page's colours, a name for screen readers."""
        svg = self._svg[self._svg.index("<svg") :]
        svg = re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{self.name}-", svg)
        svg = _coloured(svg, _IN_PAGE)
        return Markup(svg.replace("<svg", f'<svg role="img" aria-label="{escape(self.caption)}"', 1))


def _coloured(svg: str, colours: Mapping[str, str]) -> str:
    for colour, shown in colours.items():
        svg = svg.replace(colour, shown)
    return svg


def name_marks(figure: Figure, columns: int) -> None:
    """Add a legend below that names the marks which are drawn anywhere in a figure, each once; none without marks."""
    named: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if not isinstance(handle, Line2D) or np.size(handle.get_xdata()):
                named.setdefault(label, handle)
    if named:
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=columns)


def finished(simulated: bool, kind: str, caption: str, figure: Figure) -> Drawing:
    """Finish a figure: what was simulated says so in it."""
    if simulated:
        figure.suptitle("SIMULATED PARTICIPANTS", color=WARNING, fontsize=8, x=0.01, ha="left")
    suffix, group = ("simulated", "simulated participants") if simulated else ("people", "people")
    return Drawing(f"{kind}-{suffix}", f"{caption} ({group})", figure)
