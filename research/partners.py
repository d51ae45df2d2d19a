"""Evaluates packaged policies with every population: held-out ones, impaired ones, and with the force guard.

    python research/partners.py measure [KIND ...]   evaluates what has no results yet, of `adaptive` by default
    python research/partners.py clinical             the same for adaptive policies and people with clinical impairments
    python research/partners.py guard                prints results with and without the force guard

Episodes are of the test split, seed 0. Results are in `research/partners.json`; the reference of policies shows them.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from avrgym.learning.evaluation import EvaluationResult, evaluate_all
from avrgym.people.population_names import ASSISTIVE_GYM_IMPAIRMENTS, SEVERITIES
from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.tasks.registry import ENVIRONMENTS
from figures_file import add, chosen, name_of, read, success_and_force
from papers_results import row, short

SEED = 0
EPISODES, FEWER = 1000, 100
"""Of Adaptive policies and of the others; some results of Adaptive policies have fewer episodes. ``FEWER`` also with
clinical impairments."""


class Group(NamedTuple):
    """A population, an impairment, and whether the force guard is on."""

    people: str
    impairment: str = "none"
    force_guard: bool = False


GROUPS = {
    "zoo/unseen": Group("zoo/unseen"),
    "participants": Group("participants"),
    **{
        impairment: Group("participants", impairment)
        for impairment in reversed(ASSISTIVE_GYM_IMPAIRMENTS)
        if impairment != "none"
    },
    "guarded": Group("participants", force_guard=True),
    "revised": Group("revised"),
}
"""By column. Impairments and the guard are with `participants`, who move."""
CLINICAL = {
    f"{name}:{severities[1]}": Group("participants", f"{name}:{severities[1]}")
    for name, severities in SEVERITIES.items()
}
"""Clinical impairments of the middle severity."""
FIGURES_FILE = Path(__file__).with_suffix(".json")
FIGURES = (
    "episodes", "split", "success_rate", "success_ci95", "reward_mean", "force_mean_newton", "episodes_over_limit",
)  # fmt: skip
OF_REGION = ("mean_n", "peak_n", "quasi_static_limit_n", "exceedances")


def main() -> None:
    """Run one of the commands."""
    do = {
        "measure": measure,
        "clinical": lambda _: measure(["adaptive"], CLINICAL, FEWER),
        "guard": lambda _: print(*guard_table(), sep="\n"),
    }
    if len(sys.argv) < 2 or sys.argv[1] not in do:
        sys.exit(__doc__)
    do[sys.argv[1]](sys.argv[2:] or ["adaptive"])


def measure(kinds: Sequence[str], groups: Mapping[str, Group] = GROUPS, episodes: int = EPISODES) -> None:
    """Evaluate what has no results yet, with ``episodes`` of Adaptive policies."""
    for name, (environment, kind, group) in _cells(kinds, groups).items():
        if name not in read(FIGURES_FILE):
            people, impairment, force_guard = groups[group]
            (found,) = evaluate_all(
                [environment],
                kind,
                people,
                episodes if kind == "adaptive" else FEWER,
                SEED,
                impairment=impairment,
                force_guard=force_guard,
            )
            add(FIGURES_FILE, name, _stored(found))


def _cells(kinds: Sequence[str], groups: Mapping[str, Group]) -> dict[str, tuple[str, str, str]]:
    """Environment, kind and group of every result, by name."""
    return {
        name_of(environment, kind, group): (environment, kind, group)
        for group in groups
        for kind in kinds
        for environment in _environments(kind)
    }


def _stored(found: EvaluationResult) -> dict[str, object]:
    """The stored results of an evaluation: its figures, and those of regions with contact."""
    regions = {
        name: {figure: getattr(region, figure) for figure in OF_REGION}
        for name, region in found.force_regions.items()
        if region.peak_n > 0.0
    }
    return {**chosen(found, FIGURES), "regions": regions}


def guard_table() -> Iterator[str]:
    """Results with and without the guard, of feeding, drinking and policies that exceed a limit without it."""
    figures = read(FIGURES_FILE)
    yield row("environment", "policy", "episodes", *2 * ("without the guard", "with it"))
    yield row(*["---"] * 7)
    for kind in ("original", "revised", "adaptive"):
        for environment in _environments(kind):
            both = [figures[name_of(environment, kind, group)] for group in ("participants", "guarded")]
            name = short(environment)
            if both[0]["episodes_over_limit"] or name.startswith(("Feeding", "Drinking")):
                episodes = " and ".join(dict.fromkeys(str(each["episodes"]) for each in both))
                shown = [cell(each) for cell in (success_and_force, _hardest) for each in both]
                yield row(name, kind, episodes, *shown)


def _environments(kind: str) -> list[str]:
    return [environment for environment in ENVIRONMENTS if kind in find_packaged_policies(environment)]


def _hardest(found: Mapping) -> str:
    if not found["regions"]:
        return f"{found['episodes_over_limit']}; no touch"
    name, region = max(
        found["regions"].items(), key=lambda each: each[1]["peak_n"] / each[1]["quasi_static_limit_n"]
    )
    share = 100.0 * region["peak_n"] / region["quasi_static_limit_n"]
    return f"{found['episodes_over_limit']}; {name.replace('_', ' ')} {region['peak_n']:.0f} N, {share:.0f} %"


if __name__ == "__main__":
    main()
