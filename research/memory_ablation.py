"""Adaptive policies with and without memory: the same trainings with both.

    python research/memory_ablation.py train      trains or continues each policy
    python research/memory_ablation.py measure    evaluates each with its training population and with tremor
    python research/memory_ablation.py table      prints the table of the note of 2026-11-27

Without memory the weights of the recurrent unit are fixed at zero; the critic keeps its own. Policies are in
`runs/memory_ablation`, results in `research/memory_ablation.json`. Needs the extra `train`.
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
    """Run one of the three commands."""
    do = {"train": train, "measure": measure, "table": lambda: print(*table(), sep="\n")}
    if sys.argv[1:] not in [[each] for each in do]:
        sys.exit(__doc__)
    do[sys.argv[1]]()


def train() -> None:
    """Train or continue every policy."""
    from avrgym.learning import recurrent_recipe, training
    from avrgym.learning.configuration import RecurrentConfiguration, contains_training_run

    recurrent = recurrent_recipe.RecurrentNetwork

    class WithoutMemory(recurrent):
        """The same network with a recurrent unit that always returns zero."""

        def __init__(self, *sizes) -> None:
            super().__init__(*sizes)
            for weights in self.memory.parameters():
                weights.requires_grad_(False).zero_()

    for environment in ENVIRONMENTS:
        for kind, with_memory in KINDS.items():
            recurrent_recipe.RecurrentNetwork = recurrent if with_memory else WithoutMemory
            out = _folder(environment, kind)
            if contains_training_run(out):
                if not _has_ended(out):
                    training.resume_training(out)
                continue
            configuration = RecurrentConfiguration(
                environment=environment, steps=STEPS, imitation_share=IMITATION_SHARE, seed=TRAINING_SEED
            )
            policy = training.train(configuration, out)
            print(environment, kind, policy.metadata.measured["success_rate"], flush=True)


def measure() -> None:
    """Evaluate every policy that has no results yet."""
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
    """A row for each environment and kind, a column for each population."""
    figures = read(FIGURES_FILE)
    yield row("environment", "", *GROUPS)
    yield row(*["---"] * (2 + len(GROUPS)))
    for environment in ENVIRONMENTS:
        for kind in KINDS:
            found = [figures.get(name_of(environment, kind, group)) for group in GROUPS]
            yield row(
                short(environment),
                kind,
                *cells(found, success_and_force),
            )


def _has_ended(out: Path) -> bool:
    """Whether a training is complete."""
    return (out / "policy.safetensors").exists() and not (out / "shown").exists()


def _folder(environment: str, kind: str) -> Path:
    return UNDER_WAY / f"{short(environment)}-{kind.replace(' ', '-')}"


if __name__ == "__main__":
    main()
