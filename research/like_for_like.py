"""Original against Revised, like for like: same recipe, same steps, same seeds; only the people in training differ.

    python research/like_for_like.py train    trains or continues each policy
    python research/like_for_like.py measure  evaluates each policy with `participants`, a held-out population
    python research/like_for_like.py table    prints the table of the note of 2026-11-23

Policies are in `runs/like_for_like`, results in `research/like_for_like.json`. Needs the extra `train`.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import NamedTuple

from avrgym.learning.evaluation import evaluate
from avrgym.tasks.registry import find_environment
from figures_file import add, chosen, read
from papers_results import ENVIRONMENTS, VIRTUAL_REALITY, row, short

SEEDS = (1, 2, 3)
PEOPLE = ("original", "revised")
STEPS = {"Feeding": 256_000, "Drinking": 64_000, "ScratchItch": 256_000, "BedBathing": 256_000}
"""By task: a step of drinking takes ten times as long."""
EPISODES, SHOWN_SEED = 100, 0
UNDER_WAY, FIGURES_FILE = Path("runs/like_for_like"), Path(__file__).with_suffix(".json")
FIGURES = ("episodes", "success_rate", "success_ci95", "reward_mean", "reward_std", "force_mean_newton")
"""Stored figures of each evaluation."""


HEAD = (
    "environment",
    "Original on Original",
    "Revised on Revised",
    "Original on participants",
    "Revised on participants",
    "paper, Original on people",
    "paper, Revised on people",
)


class Run(NamedTuple):
    """One training."""

    environment: str
    people: str
    seed: int

    @property
    def name(self) -> str:
        """Environment, population and seed."""
        return f"{short(self.environment)}-{self.people}-{self.seed}"

    @property
    def policy(self) -> Path:
        """The policy's file."""
        return UNDER_WAY / self.name / "policy.safetensors"


Figures = Mapping[Run, Mapping[str, object]]
RUNS = [Run(environment, people, seed) for seed in SEEDS for environment in ENVIRONMENTS for people in PEOPLE]
"""Trainings of the first seed come first."""


def main() -> None:
    """Run one of the three commands."""
    do: dict[str, Callable[[], None]] = {"train": train_all, "measure": measure_all, "table": print_table}
    if len(sys.argv) != 2 or sys.argv[1] not in do:
        sys.exit(__doc__)
    do[sys.argv[1]]()


def train_all() -> None:
    """Train or continue every policy."""
    from avrgym.learning import configuration, training

    for run in RUNS:
        if _name(run, run.people) in read(FIGURES_FILE):
            continue
        out = UNDER_WAY / run.name
        if configuration.contains_training_run(out):
            policy = training.resume_training(out)
        else:
            steps = STEPS[find_environment(run.environment)[0]]
            policy = training.train(
                configuration.make_feedforward_configuration(run.environment, run.people, steps, run.seed),
                out,
            )
        measured = policy.metadata.measured
        add(FIGURES_FILE, _name(run, run.people), {figure: measured.get(figure) for figure in FIGURES})


def measure_all() -> None:
    """Evaluate each trained policy with `participants`."""
    for run in RUNS:
        name = _name(run, "participants")
        if run.policy.exists() and name not in read(FIGURES_FILE):
            found = evaluate(run.environment, str(run.policy), "participants", EPISODES, SHOWN_SEED)
            add(FIGURES_FILE, name, chosen(found, FIGURES))


def _name(run: Run, people: str) -> str:
    return f"{run.name} {people}"


def print_table() -> None:
    """Print the table."""
    print(*table(), sep="\n")


def table() -> Iterator[str]:
    """Mean success of the seeds with its range, and mean reward."""
    by_name = read(FIGURES_FILE)
    own: Figures = {run: by_name[_name(run, run.people)] for run in RUNS}
    met: Figures = {run: by_name[_name(run, "participants")] for run in RUNS}
    columns = [(figures, people) for figures in (own, met) for people in PEOPLE]
    yield row(*HEAD)
    yield row(*["---"] * len(HEAD))
    for environment in ENVIRONMENTS:
        cells = [
            _spread([figures[Run(environment, people, seed)] for seed in SEEDS])
            for figures, people in columns
        ]
        yield row(short(environment), *cells, *(f"{success} %" for success in _paper(environment)))
    cells = [_percents([_overall(figures, people, seed) for seed in SEEDS]) for figures, people in columns]
    papers = zip(*map(_paper, ENVIRONMENTS), strict=True)
    yield row("all", *cells, *(f"{mean(each):.0f} %" for each in papers))


def _paper(environment: str) -> list[int]:
    return [reached[environment].success for reached in VIRTUAL_REALITY.values()]


def _spread(measured: Sequence[Mapping[str, object]]) -> str:
    reward = mean(float(str(each["reward_mean"])) for each in measured)
    return f"{_percents([_success(each) for each in measured])}; {reward:.0f}"


def _overall(figures: Figures, people: str, seed: int) -> float:
    """Mean success of a seed over all environments."""
    return mean(_success(figures[Run(environment, people, seed)]) for environment in ENVIRONMENTS)


def _success(measured: Mapping[str, object]) -> float:
    return float(str(measured["success_rate"]))


def _percents(shares: Sequence[float]) -> str:
    return f"{100.0 * mean(shares):.0f} % [{100.0 * min(shares):.0f}, {100.0 * max(shares):.0f}]"


if __name__ == "__main__":
    main()
