"""Original against Revised, like for like: same recipe, same steps, same seeds; only the people in training differ.

    python scripts/figures/like_for_like.py train    trains what is not trained yet, and goes on where it was cut off
    python scripts/figures/like_for_like.py meet     has each policy meet `participants`, whom neither kind met
    python scripts/figures/like_for_like.py table    prints the table of docs/policies.md

The policies lie in `scripts/figures/like_for_like/`, what trainings under way need in `runs/`. Needs the extra `train`.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import NamedTuple

from avrgym.learning.evaluation import evaluate
from avrgym.policies.trained import Policy
from avrgym.tasks.known import ENVIRONMENTS
from avrgym.tasks.registry import find_environment
from figures_file import add, chosen, read
from papers_results import VIRTUAL_REALITY, row, short

SEEDS = (1, 2, 3)
PEOPLE = ("original", "revised")
STEPS = {"Feeding": 256_000, "Drinking": 64_000, "ScratchItch": 256_000, "BedBathing": 256_000}
"""By task: a step of drinking takes ten times as long."""
EPISODES, SHOWN_SEED = 100, 0
FOLDER, UNDER_WAY = Path(__file__).with_suffix(""), Path("runs/like_for_like")
FIGURES = ("episodes", "success_rate", "success_ci95", "reward_mean", "reward_std", "force_mean_newton")
"""Of each policy with `participants`, as ``evaluate`` has them."""
MET_FILE = FOLDER / "participants.json"


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
        """Of the environment, the people and the seed."""
        return f"{short(self.environment)}-{self.people}-{self.seed}"

    @property
    def policy(self) -> Path:
        """The file of what was trained."""
        return FOLDER / f"{self.name}.safetensors"


Figures = Mapping[Run, Mapping[str, object]]
RUNS = [Run(environment, people, seed) for seed in SEEDS for environment in ENVIRONMENTS for people in PEOPLE]
"""The first seed's first."""


def main() -> None:
    """Do one of the three."""
    do: dict[str, Callable[[], None]] = {"train": train_all, "meet": meet_all, "table": print_table}
    if len(sys.argv) != 2 or sys.argv[1] not in do:
        sys.exit(__doc__)
    do[sys.argv[1]]()


def train_all() -> None:
    """Train what is not trained yet."""
    from avrgym.learning import training

    FOLDER.mkdir(exist_ok=True)
    for run in RUNS:
        if run.policy.exists():
            continue
        out = UNDER_WAY / run.name
        if (out / training.CONFIGURATION_FILE).exists():
            policy = training.resume(out)
        else:
            steps = STEPS[find_environment(run.environment)[0]]
            policy = training.train(
                training.configuration_for(run.environment, run.people, steps, run.seed), out
            )
        policy.save(run.policy)
        print(run.name, policy.metadata.measured["success_rate"], flush=True)


def meet_all() -> None:
    """Have every trained policy meet people whom neither kind met."""
    for run in RUNS:
        if run.policy.exists() and run.name not in read(MET_FILE):
            found = evaluate(run.environment, str(run.policy), "participants", EPISODES, SHOWN_SEED)
            add(MET_FILE, run.name, chosen(found, FIGURES))


def print_table() -> None:
    """Print the table."""
    print(*table(), sep="\n")


def table() -> Iterator[str]:
    """Of the seeds the mean, in brackets the least and the most of them, and the mean reward."""
    own: Figures = {run: Policy.load(run.policy).metadata.measured for run in RUNS}
    by_name = read(MET_FILE)
    met: Figures = {run: by_name[run.name] for run in RUNS}
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
    """The success of a seed's policies over all environments."""
    return mean(_success(figures[Run(environment, people, seed)]) for environment in ENVIRONMENTS)


def _success(measured: Mapping[str, object]) -> float:
    return float(str(measured["success_rate"]))


def _percents(shares: Sequence[float]) -> str:
    return f"{100.0 * mean(shares):.0f} % [{100.0 * min(shares):.0f}, {100.0 * max(shares):.0f}]"


if __name__ == "__main__":
    main()
