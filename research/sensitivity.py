"""Sensitivity of adaptive policies to the behaviour parameters of the zoo.

    python research/sensitivity.py measure [ENVIRONMENT ...]   evaluates what has no results yet
    python research/sensitivity.py table                       prints success and force at both ends of each range
    python research/sensitivity.py figure OUT.svg              draws the change of success

The people have the styles of `zoo/train` that use the parameter. The parameter has one value in all episodes: an end of
the range from `zoo/extreme`. All other parameters vary as in `zoo/train`. 100 episodes of the test split, seed 0.
Results are in `research/sensitivity.json`.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from avrgym.learning.evaluation import evaluate
from avrgym.people.distributions import NAMED_DISTRIBUTIONS, PeopleDistribution
from avrgym.people.population_names import TRAIN_ZOO
from avrgym.people.zoo.partners import (
    DEFAULT_PARAMETER_BOUNDS,
    PARAMETER_BOUNDS,
    PARTNER_PARAMETERS,
    PARTNERS,
    SINGLE_STYLE_PARTNER_SETS,
    STYLE_LEVELS,
    PartnerSet,
)
from avrgym.people.zoo.styles import ASSUMPTION, PARAMETER_SOURCES, STYLES
from figures_file import add, chosen, read, success
from papers_results import row, short

ENVIRONMENTS = ("avrgym/FeedingJaco-v1", "avrgym/ScratchItchJaco-v1", "avrgym/BedBathingJaco-v1")
EPISODES, SEED = 100, 0
ENDS = {"low": -0.4, "high": 1.4}
"""Levels of `zoo/extreme` relative to the range of `zoo/train`."""
assert tuple(ENDS.values()) == STYLE_LEVELS["zoo/extreme"]
FIGURES_FILE = Path(__file__).with_suffix(".json")
FIGURES = ("episodes", "success_rate", "success_ci95", "force_mean_newton", "episodes_over_limit")


def main() -> None:
    """Run one of the commands."""
    match sys.argv[1:]:
        case ["measure", *environments]:
            measure(environments or ENVIRONMENTS)
        case ["table"]:
            print(*table(), sep="\n")
        case ["figure", out]:
            draw(Path(out))
        case _:
            sys.exit(__doc__)


def measure(environments: Sequence[str]) -> None:
    """Evaluate each parameter at both ends of its range."""
    for environment in environments:
        for parameter in PARAMETER_SOURCES:
            for end, level in ENDS.items():
                name = _name(environment, parameter, end)
                if name not in read(FIGURES_FILE):
                    _set_level(parameter, level)
                    result = evaluate(environment, "adaptive", TRAIN_ZOO, EPISODES, SEED)
                    add(FIGURES_FILE, name, chosen(result, FIGURES))


def _name(environment: str, parameter: str, end: str) -> str:
    return f"{short(environment)} {parameter} {end}"


def _ranges(parameter: str) -> dict[str, tuple[float, float]]:
    """First and last value of a parameter, by style that uses it."""
    return {
        name: axis[parameter]
        for name, style in STYLES.items()
        for axis in style.axis_ranges
        if parameter in axis
    }


def _value(ends: tuple[float, float], parameter: str, level: float) -> float:
    first, last = ends
    return float(
        np.clip(first + level * (last - first), *PARAMETER_BOUNDS.get(parameter, DEFAULT_PARAMETER_BOUNDS))
    )


def _set_level(parameter: str, level: float) -> None:
    """Restrict `zoo/train` to styles that use the parameter, and set it to a level of its range."""
    ranges = _ranges(parameter)
    values = getattr(PARTNER_PARAMETERS, parameter).copy()
    for index, partner in enumerate(PARTNERS):
        if partner.style in ranges:
            values[index] = _value(ranges[partner.style], parameter, level)
    partners = PartnerSet(
        replace(PARTNER_PARAMETERS, **{parameter: values}),
        tuple(
            SINGLE_STYLE_PARTNER_SETS[f"{TRAIN_ZOO}/{style}"].group_starts_and_sizes[0] for style in ranges
        ),
    )
    named = cast("dict[str, PeopleDistribution]", NAMED_DISTRIBUTIONS)
    named[TRAIN_ZOO] = replace(named[TRAIN_ZOO], partners=partners)


def _source(parameter: str) -> str:
    source = PARAMETER_SOURCES[parameter]
    return "assumption" if source.startswith(ASSUMPTION) else "source"


def _span(parameter: str, end: str) -> str:
    """The value of a parameter at an end of its range, or its values over the styles."""
    values = [_value(ends, parameter, ENDS[end]) for ends in _ranges(parameter).values()]
    low, high = min(values), max(values)
    return f"{low:.3g}" if high - low < 1e-9 else f"{low:.3g} to {high:.3g}"


def table() -> Iterator[str]:
    """Success, mean force and episodes over a limit at both ends of each parameter's range."""
    figures = read(FIGURES_FILE)
    yield row("parameter", "range from", "low", "high", *(short(name) for name in ENVIRONMENTS))
    yield row(*["---"] * (4 + len(ENVIRONMENTS)))
    for parameter in PARAMETER_SOURCES:
        cells = [_cell(figures, environment, parameter) for environment in ENVIRONMENTS]
        yield row(f"`{parameter}`", _source(parameter), *(_span(parameter, end) for end in ENDS), *cells)


def _cell(figures: Mapping[str, Mapping], environment: str, parameter: str) -> str:
    ends = [figures.get(_name(environment, parameter, end)) for end in ENDS]
    return "<br>".join(
        "–"
        if found is None
        else f"{success(found)}; {found['force_mean_newton']:.1f} N; {found['episodes_over_limit']}"
        for found in ends
    )


def draw(out: Path) -> None:
    """Draw success at the low and the high end of each range, one panel for each environment."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    figures = read(FIGURES_FILE)
    parameters = list(PARAMETER_SOURCES)[::-1]
    _, axes = pyplot.subplots(1, len(ENVIRONMENTS), figsize=(9.5, 5.2), sharey=True, layout="constrained")
    for plot, environment in zip(axes, ENVIRONMENTS, strict=True):
        for place, parameter in enumerate(parameters):
            for end, marker in zip(ENDS, ("o", "s"), strict=True):
                found = figures.get(_name(environment, parameter, end))
                if found is not None:
                    rate = 100.0 * found["success_rate"]
                    low, high = (100.0 * value for value in found["success_ci95"])
                    height = place + (0.16 if end == "low" else -0.16)
                    colour = "tab:blue" if end == "low" else "tab:orange"
                    plot.plot([low, high], [height, height], color=colour, linewidth=1.0)
                    plot.plot(
                        rate, height, marker, color=colour, markersize=4, label=end if not place else None
                    )
        plot.set_title(short(environment), fontsize=9)
        plot.set_xlabel("success, % (95 % interval)", fontsize=8)
        plot.grid(axis="x", linewidth=0.3)
        plot.tick_params(labelsize=7)
    labels = [f"{name}{' *' if _source(name) == 'assumption' else ''}" for name in parameters]
    axes[0].set_yticks(range(len(parameters)), labels)
    axes[0].legend(fontsize=7, title="end of the range (* assumption)", title_fontsize=7, loc="lower left")
    pyplot.savefig(out)


if __name__ == "__main__":
    main()
