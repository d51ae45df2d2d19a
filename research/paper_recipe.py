"""The paper's own recipe in all eight environments: PPO alone, ten million steps, on Original and on Revised people.

    python research/paper_recipe.py train STEPS [ENVIRONMENT ...]
                                                      trains for so many steps, the paper's are 10000000, what has had
                                                      fewer, in all environments unless some are named; goes on where
                                                      it stopped
    python research/paper_recipe.py measure    evaluates each with its training population and `participants`
    python research/paper_recipe.py table      prints the table of the note of 2026-11-24

Policies are in `runs/paper_recipe`, results in `research/paper_recipe.json`. Needs the extra `train`.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from avrgym.learning.evaluation import evaluate
from avrgym.policies.trained_policies import Policy
from figures_file import add, chosen, read, success
from papers_results import ENVIRONMENTS, SIMULATION, VIRTUAL_REALITY, Reached, row, short

PEOPLE = ("original", "revised")
TRAINING_SEED, SHOWN_SEED, EPISODES = 1, 0, 100
UNDER_WAY, FIGURES_FILE = Path("runs/paper_recipe"), Path(__file__).with_suffix(".json")
FIGURES = ("episodes", "split", "success_rate", "success_ci95", "reward_mean", "force_mean_newton")
"""Stored figures of each evaluation."""
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
        """Environment and population."""
        return f"{short(self.environment)}-{self.people}"

    @property
    def policy(self) -> Path:
        """The policy's file."""
        return UNDER_WAY / self.name / "policy.safetensors"

    @property
    def steps(self) -> int:
        """Its training steps so far."""
        return Policy.load(self.policy).metadata.steps if self.policy.exists() else 0

    def name_with(self, people: str, steps: int) -> str:
        """The key of its results with a population after a number of steps."""
        return f"{self.name} {steps} {people}"


RUNS = [Run(environment, people) for environment in ENVIRONMENTS for people in PEOPLE]


def main() -> None:
    """Run one of the three commands."""
    do: dict[str, Callable[[Sequence[str]], None]] = {
        "train": train,
        "measure": measure,
        "table": print_table,
    }
    if len(sys.argv) < 2 or sys.argv[1] not in do:
        sys.exit(__doc__)
    do[sys.argv[1]](sys.argv[2:])


def train(arguments: Sequence[str]) -> None:
    """Train every policy with fewer steps, in all environments unless some are named."""
    from avrgym.learning import training
    from avrgym.learning.configuration import contains_training_run
    from avrgym.learning.hyperparameters import PAPER_HYPERPARAMETERS

    if not arguments or not arguments[0].isdigit():
        sys.exit(__doc__)
    steps, environments = int(arguments[0]), arguments[1:] or [*ENVIRONMENTS]
    for run in RUNS:
        if run.environment not in environments or run.steps >= steps:
            continue
        out = UNDER_WAY / run.name
        if contains_training_run(out):
            policy = training.resume_training(out, steps=steps)
        else:
            configuration = training.make_feedforward_configuration(
                run.environment, run.people, steps, TRAINING_SEED, hyperparameters=PAPER_HYPERPARAMETERS
            )
            policy = training.train(configuration, out)
        print(run.name, policy.metadata.measured["success_rate"], flush=True)


def measure(_: Sequence[str]) -> None:
    """Evaluate every policy that has no results yet."""
    for run in RUNS:
        for people in (run.people, "participants"):
            name = run.name_with(people, run.steps)
            if run.policy.exists() and name not in read(FIGURES_FILE):
                found = evaluate(run.environment, str(run.policy), people, EPISODES, SHOWN_SEED)
                add(FIGURES_FILE, name, chosen(found, FIGURES))


def print_table(_: Sequence[str]) -> None:
    """Print the table."""
    print(*table(), sep="\n")


def table() -> Iterator[str]:
    """A row for each training that has been measured."""
    figures = read(FIGURES_FILE)
    yield row(*HEAD)
    yield row(*["---"] * len(HEAD))
    for run in RUNS:
        measured = [int(name.split()[1]) for name in figures if name.startswith(f"{run.name} ")]
        steps = max(measured, default=0)
        own, met = (figures.get(run.name_with(people, steps)) for people in (run.people, "participants"))
        if own is not None and met is not None:
            simulated = _paper(SIMULATION[run.environment]) if run.people == "original" else "–"
            with_people = _paper(VIRTUAL_REALITY[run.people][run.environment])
            cells = _cell(own), simulated, _cell(met), with_people
            yield row(short(run.environment), run.people, f"{steps / 1e3:.0f} k", *cells)


def _cell(found: Mapping) -> str:
    return f"{success(found)}; {found['reward_mean']:.0f}"


def _paper(reached: Reached) -> str:
    return f"{reached.success} %; {reached.reward}"


if __name__ == "__main__":
    main()
