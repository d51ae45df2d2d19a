"""What an adaptive policy's memory is worth: the same trainings with it and without it.

    python research/memory_ablation.py train      trains what is not trained yet, and goes on where it stopped
    python research/memory_ablation.py measure    has each meet people it was trained with, and who tremble
    python research/memory_ablation.py table      prints the table of docs/recurrent_recipe.md

Without it the same network remembers nothing, for the weights of its recurrent unit are zero and stay so; the critic,
which no policy contains, keeps its own. Policies lie in `runs/memory_ablation`, figures in
`research/memory_ablation.json`. Needs the extra `train`.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

from avrgym.learning.evaluation import evaluate_all
from figures_file import add, cells, chosen, name_of, read, success_and_force
from papers_results import row, short

ENVIRONMENTS = ("avrgym/FeedingJaco-v1", "avrgym/BedBathingJaco-v1")
KINDS = {"memory": True, "no memory": False}
STEPS, IMITATION_SHARE, TRAINING_SEED = 256_000, 0.3, 3
GROUPS = {"zoo/train": ("zoo/train", "none"), "tremor": ("participants", "tremor")}
EPISODES, SHOWN_SEED = 200, 0
UNDER_WAY, FIGURES_FILE = Path("runs/memory_ablation"), Path(__file__).with_suffix(".json")
FIGURES = ("episodes", "split", "success_rate", "success_ci95", "force_mean_newton")


def main() -> None:
    """Do one of the three."""
    do = {"train": train, "measure": measure, "table": lambda: print(*table(), sep="\n")}
    if sys.argv[1:] not in [[each] for each in do]:
        sys.exit(__doc__)
    do[sys.argv[1]]()


def train() -> None:
    """Train what is not trained yet."""
    from avrgym.learning import recurrent_recipe

    remembers = recurrent_recipe.RecurrentNetwork

    class Forgetful(remembers):
        """The same network, whose recurrent unit always says zero."""

        def __init__(self, *sizes) -> None:
            super().__init__(*sizes)
            for weights in self.memory.parameters():
                weights.requires_grad_(False).zero_()

    for environment in ENVIRONMENTS:
        for kind, with_memory in KINDS.items():
            recurrent_recipe.RecurrentNetwork = remembers if with_memory else Forgetful
            out = _folder(environment, kind)
            if (out / recurrent_recipe.FILE).exists():
                if not _has_ended(out):
                    recurrent_recipe.resume(out)
                continue
            asked = recurrent_recipe.RecurrentConfiguration(
                environment=environment, steps=STEPS, imitation_share=IMITATION_SHARE, seed=TRAINING_SEED
            )
            policy = recurrent_recipe.train(asked, out)
            print(environment, kind, policy.metadata.measured["success_rate"], flush=True)


def measure() -> None:
    """Measure what is not measured yet."""
    for environment in ENVIRONMENTS:
        for kind in KINDS:
            for group, (people, impairment) in GROUPS.items():
                name = name_of(environment, kind, group)
                out = _folder(environment, kind)
                if _has_ended(out) and name not in read(FIGURES_FILE):
                    policy = str(out / "policy.safetensors")
                    (found,) = evaluate_all(
                        [environment], policy, people, EPISODES, SHOWN_SEED, impairment=impairment
                    )
                    add(FIGURES_FILE, name, chosen(found, FIGURES))


def table() -> Iterator[str]:
    """A row for each environment and kind, a column for each group of people, of what is measured."""
    told = read(FIGURES_FILE)
    yield row("environment", "", *GROUPS)
    yield row(*["---"] * (2 + len(GROUPS)))
    for environment in ENVIRONMENTS:
        for kind in KINDS:
            found = [told.get(name_of(environment, kind, group)) for group in GROUPS]
            yield row(
                short(environment),
                kind,
                *cells(found, success_and_force),
            )


def _has_ended(out: Path) -> bool:
    """Whether a training left a policy and nothing to go on with."""
    return (out / "policy.safetensors").exists() and not (out / "shown").exists()


def _folder(environment: str, kind: str) -> Path:
    return UNDER_WAY / f"{short(environment)}-{kind.replace(' ', '-')}"


if __name__ == "__main__":
    main()
