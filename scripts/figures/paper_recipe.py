"""The paper's own recipe in all eight environments: PPO alone, ten million steps, on Original and on Revised people.

    python scripts/figures/paper_recipe.py train [ENVIRONMENT ...]   trains what is not trained yet, in all environments
                                                                     unless some are named, and goes on where it stopped
    python scripts/figures/paper_recipe.py measure                   has each meet people like its own, and
                                                                     `participants`
    python scripts/figures/paper_recipe.py table                     prints the table of docs/policies.md

Policies and figures lie in `scripts/figures/paper_recipe/`, what trainings under way need in `runs/`. Needs the extra
`train`.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from avrgym.learning.evaluation import evaluate
from avrgym.policies.trained import Policy
from avrgym.system.files import write_whole
from avrgym.tasks.registry import ENVIRONMENTS
from papers_results import SIMULATION, VIRTUAL_REALITY, Reached, row, short

PEOPLE = ("original", "revised")
TRAINING_SEED, SHOWN_SEED, EPISODES = 1, 0, 1000
FOLDER, UNDER_WAY = Path(__file__).with_suffix(""), Path("runs/paper_recipe")
FIGURES_FILE = FOLDER / "figures.json"
FIGURES = ("episodes", "stream", "success_rate", "success_ci95", "reward_mean", "force_mean_newton")
"""Of each policy with each people, as ``evaluate`` has them."""
HEAD = (
    "environment", "people", "steps", "with people like these", "paper, in simulation",
    "with `participants`", "paper, with people",
)  # fmt: skip


class Run(NamedTuple):
    """One training."""

    environment: str
    people: str

    @property
    def name(self) -> str:
        """Of the environment and the people."""
        return f"{short(self.environment)}-{self.people}"

    @property
    def policy(self) -> Path:
        """The file of what was trained."""
        return FOLDER / f"{self.name}.safetensors"


RUNS = [Run(environment, people) for environment in ENVIRONMENTS for people in PEOPLE]


def main() -> None:
    """Do one of the three."""
    do: dict[str, Callable[[Sequence[str]], None]] = {
        "train": train,
        "measure": measure,
        "table": print_table,
    }
    if len(sys.argv) < 2 or sys.argv[1] not in do:
        sys.exit(__doc__)
    do[sys.argv[1]](sys.argv[2:])


def train(environments: Sequence[str]) -> None:
    """Train what is not trained yet, in all environments unless some are named."""
    from avrgym.learning import training
    from avrgym.learning.configuration import PAPER_SETTINGS, PAPER_STEPS

    FOLDER.mkdir(exist_ok=True)
    for run in RUNS:
        if run.policy.exists() or (environments and run.environment not in environments):
            continue
        out = UNDER_WAY / run.name
        if (out / training.CONFIGURATION_FILE).exists():
            policy = training.resume(out)
        else:
            asked = run.environment, run.people, PAPER_STEPS, TRAINING_SEED
            policy = training.train(training.configuration_for(*asked, settings=PAPER_SETTINGS), out)
        policy.save(run.policy)
        print(run.name, policy.metadata.measured["success_rate"], flush=True)


def measure(_: Sequence[str]) -> None:
    """Measure what is not measured yet."""
    figures = _figures()
    for run in RUNS:
        for people in (run.people, "participants"):
            name = f"{run.name} {people}"
            if run.policy.exists() and name not in figures:
                found = evaluate(run.environment, str(run.policy), people, EPISODES, SHOWN_SEED)
                figures[name] = {figure: getattr(found, figure) for figure in FIGURES}
                write_whole(FIGURES_FILE, msgspec.json.format(msgspec.json.encode(figures)))
                print(name, found.success_rate, flush=True)


def print_table(_: Sequence[str]) -> None:
    """Print the table."""
    print(*table(), sep="\n")


def table() -> Iterator[str]:
    """A row for each training that has ended."""
    figures = _figures()
    yield row(*HEAD)
    yield row(*["---"] * len(HEAD))
    for run in RUNS:
        if run.policy.exists():
            steps = Policy.load(run.policy).metadata.steps
            own, met = (figures[f"{run.name} {people}"] for people in (run.people, "participants"))
            simulated = _paper(SIMULATION[run.environment]) if run.people == "original" else "–"
            with_people = _paper(VIRTUAL_REALITY[run.people][run.environment])
            cells = _cell(own), simulated, _cell(met), with_people
            yield row(short(run.environment), run.people, f"{steps / 1e6:.1f} M", *cells)


def _figures() -> dict[str, Mapping]:
    return msgspec.json.decode(FIGURES_FILE.read_bytes()) if FIGURES_FILE.exists() else {}


def _cell(found: Mapping) -> str:
    low, high = (100.0 * end for end in found["success_ci95"])
    return f"{100.0 * found['success_rate']:.1f} % [{low:.0f}, {high:.0f}]; {found['reward_mean']:.0f}"


def _paper(reached: Reached) -> str:
    return f"{reached.success} %; {reached.reward}"


if __name__ == "__main__":
    main()
