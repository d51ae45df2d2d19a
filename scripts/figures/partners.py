"""How packaged policies do with people of every kind: those like their own, participants, the zoo, and impaired ones.

    python scripts/figures/partners.py measure [KIND ...]   measures what is not yet, of `adaptive` unless other
                                                            kinds of policies are named; goes on where it stopped
    python scripts/figures/partners.py table [KIND ...]     prints the tables of docs/policies.md

300 episodes each, of the stream that no choice has seen, seed 0. Figures lie in `scripts/figures/partners.json`.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from avrgym.learning.evaluation import evaluate_all
from avrgym.people.names import IMPAIRMENTS
from avrgym.policies.trained import packaged_policies
from avrgym.system.files import write_whole
from avrgym.tasks.registry import ENVIRONMENTS
from papers_results import row, short

EPISODES, SEED = 300, 0
GROUPS = {
    "participants": ("participants", "none"),
    "zoo/unseen": ("zoo/unseen", "none"),
    "revised": ("revised", "none"),
    **{impairment: ("participants", impairment) for impairment in IMPAIRMENTS if impairment != "none"},
}
"""Whom policies meet, people and impairment, by the names of columns; impaired are people who move."""
FIGURES_FILE = Path(__file__).with_suffix(".json")
FIGURES = (
    "episodes", "stream", "success_rate", "success_ci95", "reward_mean", "force_mean_newton", "episodes_over_limit",
)  # fmt: skip


def main() -> None:
    """Do one of the two."""
    do = {"measure": measure, "table": print_tables}
    if len(sys.argv) < 2 or sys.argv[1] not in do:
        sys.exit(__doc__)
    do[sys.argv[1]](sys.argv[2:] or ["adaptive"])


def measure(kinds: Sequence[str]) -> None:
    """Measure what is not measured yet."""
    for group, (people, impairment) in GROUPS.items():
        for environment in ENVIRONMENTS:
            for kind in kinds:
                name = _name(environment, kind, group)
                if kind in packaged_policies(environment) and name not in figures():
                    (found,) = evaluate_all(
                        [environment], kind, people, EPISODES, SEED, impairment=impairment
                    )
                    told = {figure: getattr(found, figure) for figure in FIGURES}
                    all_told = msgspec.json.encode(figures() | {name: told})
                    write_whole(FIGURES_FILE, msgspec.json.format(all_told))
                    print(name, found.success_rate, found.force_mean_newton, flush=True)


def print_tables(kinds: Sequence[str]) -> None:
    """Print a table for each kind."""
    for kind in kinds:
        print(kind, *table(kind), sep="\n")


def table(kind: str) -> Iterator[str]:
    """Success with its interval and mean force, a line for each environment and a column for each group of people."""
    told = figures()
    yield row("environment", *GROUPS)
    yield row(*["---"] * (1 + len(GROUPS)))
    for environment in (each for each in ENVIRONMENTS if kind in packaged_policies(each)):
        cells = (_cell(told.get(_name(environment, kind, group))) for group in GROUPS)
        yield row(short(environment), *cells)


def figures() -> dict[str, Mapping]:
    """All that is measured so far, by environment, kind and group."""
    return msgspec.json.decode(FIGURES_FILE.read_bytes()) if FIGURES_FILE.exists() else {}


def _name(environment: str, kind: str, group: str) -> str:
    return f"{short(environment)} {kind} {group}"


def _cell(found: Mapping | None) -> str:
    if found is None:
        return "–"
    low, high = (100.0 * end for end in found["success_ci95"])
    return (
        f"{100.0 * found['success_rate']:.1f} % [{low:.0f}, {high:.0f}]; {found['force_mean_newton']:.1f} N"
    )


if __name__ == "__main__":
    main()
