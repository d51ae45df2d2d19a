"""How packaged policies do with people of every kind: those like their own, participants, the zoo, and impaired ones.

    python research/partners.py measure [KIND ...]   measures what is not yet, of `adaptive` unless other
                                                            kinds of policies are named; goes on where it stopped
    python research/partners.py table [KIND ...]     prints the tables of docs/adaptive.md
    python research/partners.py guard                prints that of docs/policies.md: with the force guard

Episodes are of the stream that no choice has seen, seed 0. Figures lie in `research/partners.json`.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from avrgym.learning.evaluation import Evaluation, evaluate_all
from avrgym.people.population_names import IMPAIRMENTS
from avrgym.policies.trained import packaged_policies
from avrgym.tasks.registry import ENVIRONMENTS
from figures_file import add, cells, chosen, name_of, read, success_and_force
from papers_results import row, short

SEED = 0
EPISODES, FEWER = 1000, 100
"""Of policies that remember, and of the others; some cells of the former have fewer, which they say."""


class Group(NamedTuple):
    """Whom policies meet, and whether a force guard is between."""

    people: str
    impairment: str = "none"
    force_guard: bool = False


GROUPS = {
    "zoo/unseen": Group("zoo/unseen"),
    "participants": Group("participants"),
    **{
        impairment: Group("participants", impairment)
        for impairment in reversed(IMPAIRMENTS)
        if impairment != "none"
    },
    "guarded": Group("participants", force_guard=True),
    "revised": Group("revised"),
}
"""By the names of columns; impaired and guarded are people who move."""
FIGURES_FILE = Path(__file__).with_suffix(".json")
FIGURES = (
    "episodes", "split", "success_rate", "success_ci95", "reward_mean", "force_mean_newton", "episodes_over_limit",
)  # fmt: skip
OF_REGION = ("mean_n", "peak_n", "limit_n", "exceedances")


def main() -> None:
    """Do one of the three."""
    do = {
        "measure": measure,
        "table": print_tables,
        "guard": lambda _: print(*table_of_the_guard(), sep="\n"),
    }
    if len(sys.argv) < 2 or sys.argv[1] not in do:
        sys.exit(__doc__)
    do[sys.argv[1]](sys.argv[2:] or ["adaptive"])


def measure(kinds: Sequence[str]) -> None:
    """Measure what is not measured yet."""
    for name, (environment, kind, group) in _cells(kinds).items():
        if name not in read(FIGURES_FILE):
            people, impairment, force_guard = GROUPS[group]
            (found,) = evaluate_all(
                [environment],
                kind,
                people,
                EPISODES if kind == "adaptive" else FEWER,
                SEED,
                impairment=impairment,
                force_guard=force_guard,
            )
            add(FIGURES_FILE, name, _told(found))


def _cells(kinds: Sequence[str]) -> dict[str, tuple[str, str, str]]:
    """Environment, kind and group of all that there is to measure, by name."""
    return {
        name_of(environment, kind, group): (environment, kind, group)
        for group in GROUPS
        for kind in kinds
        for environment in _environments(kind)
    }


def _told(found: Evaluation) -> dict[str, object]:
    """What is kept of an evaluation: its figures, and those of the regions that were touched."""
    regions = {
        name: {figure: getattr(region, figure) for figure in OF_REGION}
        for name, region in found.force_regions.items()
        if region.peak_n > 0.0
    }
    return {**chosen(found, FIGURES), "regions": regions}


def print_tables(kinds: Sequence[str]) -> None:
    """Print the tables of each kind."""
    for kind in kinds:
        print(kind, *table(kind), "", *table_of_forces(kind), sep="\n")


def table(kind: str) -> Iterator[str]:
    """Success with its interval and mean force, a line for each environment and a column for each group of people."""
    return _table(kind, success_and_force)


def table_of_forces(kind: str) -> Iterator[str]:
    """How many episodes exceeded a limit, and the region that came closest to its own."""
    return _table(kind, _hardest)


def table_of_the_guard() -> Iterator[str]:
    """What the force guard is worth with participants, where mouths are served or a limit was exceeded without it."""
    told = read(FIGURES_FILE)
    yield row("environment", "policy", "episodes", *2 * ("without the guard", "with it"))
    yield row(*["---"] * 7)
    for kind in ("original", "revised", "adaptive"):
        for environment in _environments(kind):
            both = [told[name_of(environment, kind, group)] for group in ("participants", "guarded")]
            name = short(environment)
            if both[0]["episodes_over_limit"] or name.startswith(("Feeding", "Drinking")):
                episodes = " and ".join(dict.fromkeys(str(each["episodes"]) for each in both))
                shown = [cell(each) for cell in (success_and_force, _hardest) for each in both]
                yield row(name, kind, episodes, *shown)


def _table(kind: str, cell: Callable[[Mapping], str]) -> Iterator[str]:
    told = read(FIGURES_FILE)
    yield row("environment", *GROUPS)
    yield row(*["---"] * (1 + len(GROUPS)))
    for environment in _environments(kind):
        found = (told.get(name_of(environment, kind, group)) for group in GROUPS)
        yield row(short(environment), *cells(found, cell))


def _environments(kind: str) -> list[str]:
    return [environment for environment in ENVIRONMENTS if kind in packaged_policies(environment)]


def _hardest(found: Mapping) -> str:
    if not found["regions"]:
        return f"{found['episodes_over_limit']}; no touch"
    name, region = max(found["regions"].items(), key=lambda each: each[1]["peak_n"] / each[1]["limit_n"])
    share = 100.0 * region["peak_n"] / region["limit_n"]
    return f"{found['episodes_over_limit']}; {name.replace('_', ' ')} {region['peak_n']:.0f} N, {share:.0f} %"


if __name__ == "__main__":
    main()
