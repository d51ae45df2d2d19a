"""Learning curves of the packaged policies, one panel per environment, from their files' metadata.

python scripts/figures/learning_curves.py docs/pictures/learning_curves.svg
"""

import sys
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from avrgym.policies.trained_policies import Policy, find_packaged_policies
from avrgym.tasks.constants import PAPER_ENVIRONMENTS, PAPER_TASKS

STYLES = {"original": ("#b3541e", "--"), "revised": ("#1f5f8b", "-")}
"""Colour and line style of each policy."""


def draw(path: Path) -> None:
    """Write the figure."""
    matplotlib.rcParams.update({"svg.hashsalt": "learning curves", "svg.fonttype": "none", "font.size": 9})
    figure, axes = plt.subplots(2, len(PAPER_TASKS), figsize=(11, 5), sharey=True, layout="constrained")
    for panel, environment in zip(axes.T.flat, PAPER_ENVIRONMENTS, strict=True):
        _draw_panel(panel, environment)
    next(panel for panel in axes.flat if panel.lines).legend(loc="lower right", frameon=False)
    figure.supxlabel("environment steps, millions")
    figure.supylabel("success of the latest training episodes, %")
    figure.savefig(path, metadata={"Date": None})


def _draw_panel(panel: Axes, environment: str) -> None:
    for kind, file in find_packaged_policies(environment).items():
        curve = Policy.load(file).metadata.curve
        if not curve:
            continue
        steps, _, successes = zip(*curve, strict=True)
        colour, line = STYLES[kind]
        millions, percent = [step / 1e6 for step in steps], [100.0 * success for success in successes]
        panel.plot(millions, percent, line, color=colour, label=kind)
    panel.set_title(environment.removeprefix("avrgym/").removesuffix("-v1"))
    panel.set_ylim(0, 100)
    panel.grid(alpha=0.3)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
