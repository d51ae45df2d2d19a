"""Evaluates adaptive policies over bodies: success and reach by stature and body mass index.

    python research/bodies.py measure [ENVIRONMENT ...]   evaluates what has no results yet, of the paper's environments
    python research/bodies.py figure OUT.svg              draws success and reach

People are those of `anthropometric`: 100 episodes of 200 steps each, seeds 0 to 99. *Reach* is the share of episodes in
which the tool came within 5 cm of its target. Results are in `research/bodies.json`.
"""

import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from avrgym.models.human import REFERENCE_STATURE_M
from avrgym.policies import registry
from avrgym.policies.trained_policies import Policy
from avrgym.tasks.constants import PAPER_ENVIRONMENTS
from avrgym.tasks.episodes import Episodes
from figures_file import add, read
from papers_results import short

EPISODES, WORLDS, STEPS, REACHED_M = 100, 50, 200, 0.05
FIGURES_FILE = Path(__file__).with_suffix(".json")
STATURE_EDGES = (-np.inf, -0.04, 0.04, np.inf)
STATURES = ("short", "medium", "tall")
"""Stature relative to the median of the sex, in metres."""
BMI_EDGES = (17.0, 22.0, 27.0, 34.0, 40.0)


def main() -> None:
    """Run one of the commands."""
    match sys.argv[1:]:
        case ["measure", *chosen]:
            measure(chosen or PAPER_ENVIRONMENTS)
        case ["figure", out]:
            draw(Path(out))
        case _:
            sys.exit(__doc__)


def measure(environments: Sequence[str]) -> None:
    """Evaluate environments that have no results yet."""
    for environment in environments:
        if short(environment) not in read(FIGURES_FILE):
            parts = [
                _episodes(environment, range(first, first + WORLDS)) for first in range(0, EPISODES, WORLDS)
            ]
            found = {name: [each for part in parts for each in part[name]] for name in parts[0]}
            add(FIGURES_FILE, short(environment), {"success_rate": float(np.mean(found["success"])), **found})


def _episodes(environment: str, seeds: Sequence[int]) -> dict[str, list]:
    """Sex, stature, body mass index, success and reach of each episode."""
    worlds = Episodes(environment, len(seeds), people="anthropometric", num_threads=1)
    policy = registry.resolve_policy("adaptive", environment)
    assert isinstance(policy, Policy)
    generators = [np.random.default_rng(seed) for seed in seeds]
    observation = worlds.reset(np.arange(len(seeds)), generators)
    act = registry.make_action_function(policy, worlds, generators)
    nearest_m, success = np.full(len(seeds), np.inf), np.zeros(len(seeds), bool)
    for _ in range(STEPS):
        step = worlds.step(act(observation))
        observation, success = step.observation, step.success
        nearest_m = np.minimum(nearest_m, step.distance_m)
    people = worlds.people
    return {
        "is_woman": people.is_woman.tolist(),
        "stature_m": people.stature_m.round(4).tolist(),
        "bmi": people.bmi_kg_m2.round(2).tolist(),
        "success": success.tolist(),
        "reached": (nearest_m < REACHED_M).tolist(),
    }


def shares(found: Mapping, measure: str) -> np.ndarray:
    """Share in percent by stature and body mass index (3, 4); NaN without episodes."""
    median_m = np.where(found["is_woman"], REFERENCE_STATURE_M["woman"], REFERENCE_STATURE_M["man"])
    row = np.digitize(np.array(found["stature_m"]) - median_m, STATURE_EDGES) - 1
    column = np.clip(np.digitize(found["bmi"], BMI_EDGES) - 1, 0, len(BMI_EDGES) - 2)
    values = np.array(found[measure], float)
    table = np.full((len(STATURES), len(BMI_EDGES) - 1), np.nan)
    for place in np.ndindex(table.shape):
        cell = (row == place[0]) & (column == place[1])
        if cell.any():
            table[place] = 100.0 * values[cell].mean()
    return table


def draw(out: Path) -> None:
    """Draw success above reach, one column for each environment."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    figures = read(FIGURES_FILE)
    labels = [f"{low:g}–{high:g}" for low, high in pairwise(BMI_EDGES)]
    size = 2.1 * len(figures) + 0.9, 4.2
    _, axes = pyplot.subplots(2, len(figures), figsize=size, squeeze=False, layout="constrained")
    for column, (name, found) in enumerate(figures.items()):
        for row, what in enumerate(("success", "reached")):
            plot, table = axes[row, column], shares(found, what)
            plot.imshow(table, vmin=0.0, vmax=100.0, cmap="viridis", aspect="auto", origin="lower")
            for (y, x), value in np.ndenumerate(table):
                if np.isfinite(value):
                    plot.text(
                        x,
                        y,
                        f"{value:.0f}",
                        ha="center",
                        va="center",
                        color="white" if value < 60 else "black",
                    )
            plot.set_xticks(range(len(labels)), labels if row else [], fontsize=7)
            plot.set_yticks(range(len(STATURES)), [] if column else STATURES, fontsize=7)
            plot.set_title(name if not row else "", fontsize=9)
        axes[1, column].set_xlabel("BMI, kg/m²", fontsize=8)
    axes[0, 0].set_ylabel("success, %", fontsize=8)
    axes[1, 0].set_ylabel("reach, %", fontsize=8)
    pyplot.savefig(out)


if __name__ == "__main__":
    main()
