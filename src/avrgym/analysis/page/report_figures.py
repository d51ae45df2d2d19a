"""Figures of a report: as SVG and PDF files, and as SVG elements in the colours of the page."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import io
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from avrgym.analysis.page.html_elements import Markup, render_figure, tag

TEXT_COLOUR, BACKGROUND_COLOUR, RULE_COLOUR, WARNING_COLOUR = "#1c2024", "#ffffff", "#d5dae0", "#8a3b00"
LINE_COLOURS = ("#0b62a8", "#b1560f", "#1b7a43", "#8b3a8f", "#6b6b00", "#b3263a")
TEXT_ON_DARK_COLOUR, TEXT_ON_LIGHT_COLOUR = "#fffffe", "#1c2025"
"""Text colours on dark and on light bars. They are the same in light mode and in dark mode of the page."""
_IN_PAGE = {
    TEXT_COLOUR: "currentColor",
    BACKGROUND_COLOUR: "none",
    RULE_COLOUR: "var(--rule)",
    WARNING_COLOUR: "var(--warning)",
} | {colour: f"var(--line-{index})" for index, colour in enumerate(LINE_COLOURS, start=1)}
"""CSS colours for a page, by the colour in the figure's file that they replace."""
FIGURE_WIDTH_INCH = 5.0
CHARACTER_WIDTH_INCH = 0.066
"""Estimated character width in inches in tick labels, legends and item texts; slightly above the mean width."""
BAR_GROUP_WIDTH = 0.8
"""Width of a group of bars, divided by the distance between group centres."""
MATPLOTLIB_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "avrgym",
    "pdf.fonttype": 42,
    "font.family": "sans-serif",
    "font.size": 9,
    "text.color": TEXT_COLOUR,
    "text.parse_math": False,
    "axes.labelcolor": TEXT_COLOUR,
    "axes.edgecolor": TEXT_COLOUR,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": BACKGROUND_COLOUR,
    "axes.facecolor": "none",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "xtick.color": TEXT_COLOUR,
    "ytick.color": TEXT_COLOUR,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}


class ReportFigure:
    """A Matplotlib figure with file name and caption. SVG files contain text elements. PDF files contain the fonts."""

    def __init__(self, name: str, caption: str, figure: Figure) -> None:
        """Store a finished figure. ``name``: file name without suffix. ``caption``: description of the figure."""
        self.name, self.caption, self.figure = name, caption, figure
        self._svg = self._saved("svg", Creator=None, Date=None, Format=None, Type=None)

    def to_svg(self) -> bytes:
        """Returns the contents of the SVG file, in colours for a white background."""
        return self._svg

    def to_pdf(self) -> bytes:
        """Returns the contents of the PDF file. The file contains no date: the bytes of equal figures are equal."""
        return self._saved("pdf", Creator=None, Producer=None, CreationDate=None)

    def write(self, folder: Path) -> None:
        """Write the figure as SVG and as PDF into a folder."""
        (folder / f"{self.name}.svg").write_bytes(self.to_svg())
        (folder / f"{self.name}.pdf").write_bytes(self.to_pdf())

    def to_inline_svg(self) -> Markup:
        """Returns an SVG element for a page, with unique ids, page colours, and a caption for screen readers."""
        svg = self._svg.decode()
        svg = re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{self.name}-", svg[svg.index("<svg") :])
        for colour, shown in _IN_PAGE.items():
            svg = svg.replace(colour, shown)
        return Markup(svg.replace("<svg", f'<svg role="img" aria-label="{escape(self.caption)}"', 1))

    def _saved(self, kind: str, **metadata: None) -> bytes:
        buffer = io.BytesIO()
        with matplotlib.rc_context(MATPLOTLIB_STYLE):
            self.figure.savefig(buffer, format=kind, metadata=metadata)
        return buffer.getvalue()


def add_legend(figure: Figure, columns: int) -> None:
    """Add a legend below the figure, with each label once. A figure without labels gets no legend.

    ``columns``: maximum number of legend columns.
    """
    named: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if not isinstance(handle, Line2D) or np.size(handle.get_xdata()):
                named.setdefault(label, handle)
    if named:
        room = figure.get_figwidth() / (0.6 + CHARACTER_WIDTH_INCH * max(map(len, named)))
        ncols = max(1, min(columns, int(room)))
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=ncols)


def label_x_ticks(axes: Axes, names: Sequence[str], width_in: float) -> None:
    """Label the positions 0, 1, … of the x axis. Labels are vertical if their total width exceeds ``width_in``
    inches."""
    longest = CHARACTER_WIDTH_INCH * (1 + max(map(len, names)))
    axes.set_xticks(range(len(names)), names, rotation=90 if longest * len(names) > width_in else 0)


def make_report_figure(
    simulated: bool, kind: str, caption: str, figure: Figure, note: str = ""
) -> ReportFigure:
    """Returns the figure with its file name and caption.

    A figure of simulated participants is marked in the figure, in the file name and in the caption. ``note``: another
    text, in the figure and in the caption.
    """
    marks = [*(["SIMULATED PARTICIPANTS"] if simulated else []), *([note] if note else [])]
    if marks:
        figure.suptitle("; ".join(marks), color=WARNING_COLOUR, fontsize=8, x=0.01, ha="left")
    caption = f"{caption}; {note}" if note else caption
    suffix, group = ("simulated", "simulated participants") if simulated else ("people", "people")
    return ReportFigure(f"{kind}-{suffix}", f"{caption} ({group})", figure)


ReportFiguresByKind = Mapping[str, ReportFigure]
"""Figures by kind of figure, such as "success"."""


def render_inline_figures(drawings: ReportFiguresByKind, *kinds: str) -> Markup:
    """Returns the figures of these kinds as HTML elements with captions. Missing kinds are omitted."""
    present = [drawings[kind] for kind in kinds if kind in drawings]
    shown = [
        render_figure(tag("div", each.to_inline_svg(), class_="scroll", tabindex=0), each.caption)
        for each in present
    ]
    return tag("div", *shown, class_="figures")
