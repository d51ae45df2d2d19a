"""Original against Revised, like for like: same recipe, same steps, same seeds; only the people in training differ.

    python examples/like_for_like.py train FOLDER    trains what is not trained yet, and goes on where it was cut off
    python examples/like_for_like.py meet FOLDER     has each policy meet `participants`, whom neither knew
    python examples/like_for_like.py table FOLDER    prints the table

Needs the extra `train`.
"""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from avrgym.learning.evaluation import evaluate
from avrgym.tasks.registry import ENVIRONMENTS

SEEDS = (1, 2, 3)
PEOPLE = ("original", "revised")
STEPS = {"Feeding": 128_000, "Drinking": 64_000, "ScratchItch": 256_000, "BedBathing": 256_000}
"""By task: a step of drinking takes ten times as long."""
EPISODES, SHOWN_SEED = 100, 0
TRAINED_FILE, MET_FILE = "trained.json", "participants.json"


def main() -> None:
    """Do one of the three."""
    do = {"train": train_all, "meet": meet_all, "table": print_table}
    if len(sys.argv) != 3 or sys.argv[1] not in do:
        sys.exit(__doc__)
    do[sys.argv[1]](Path(sys.argv[2]))


def runs(folder: Path) -> list[tuple[str, str, int, Path]]:
    """Environment, people, seed and folder of every training, the first seed's first."""
    return [
        (
            environment,
            people,
            seed,
            folder / f"{environment.split('/')[1].removesuffix('-v1')}-{people}-{seed}",
        )
        for seed in SEEDS
        for environment in ENVIRONMENTS
        for people in PEOPLE
    ]


def train_all(folder: Path) -> None:
    """Train what is not trained yet."""
    from avrgym.learning import training

    for environment, people, seed, out in runs(folder):
        if (out / TRAINED_FILE).exists():
            continue
        if (out / training.CONFIGURATION_FILE).exists():
            policy = training.resume(out)
        else:
            steps = STEPS[ENVIRONMENTS[environment][0]]
            policy = training.train(training.configuration_for(environment, people, steps, seed), out)
        (out / TRAINED_FILE).write_text(json.dumps(policy.metadata.measured))
        print(out.name, policy.metadata.measured["success_rate"], flush=True)


def meet_all(folder: Path) -> None:
    """Have every trained policy meet people whom neither kind met."""
    for environment, _, _, out in runs(folder):
        if (out / TRAINED_FILE).exists() and not (out / MET_FILE).exists():
            found = evaluate(
                environment, str(out / "policy.safetensors"), "participants", EPISODES, SHOWN_SEED
            )
            (out / MET_FILE).write_text(json.dumps(asdict(found)))
            print(out.name, found.success_rate, flush=True)


def print_table(folder: Path) -> None:
    """Means over the seeds, and the seeds' range."""
    print("| environment | seeds | Original | Revised | Original, reward | Revised, reward |")
    print("|---|---|---|---|---|---|")
    met = {
        (environment, people, seed): json.loads((out / MET_FILE).read_text())
        for environment, people, seed, out in runs(folder)
        if (out / MET_FILE).exists()
    }
    for environment in ENVIRONMENTS:
        seeds = [seed for seed in SEEDS if all((environment, people, seed) in met for people in PEOPLE)]
        if seeds:
            cells = [
                _spread([met[environment, people, seed][figure] * scale for seed in seeds], unit)
                for figure, scale, unit in (("success_rate", 100.0, " %"), ("reward_mean", 1.0, ""))
                for people in PEOPLE
            ]
            name = environment.split("/")[1].removesuffix("-v1")
            print(f"| {name} | {len(seeds)} | {' | '.join(cells)} |")


def _spread(values: list[float], unit: str) -> str:
    return f"{np.mean(values):.0f}{unit} [{min(values):.0f}, {max(values):.0f}]"


if __name__ == "__main__":
    main()
