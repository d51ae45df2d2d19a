"""Measures what self-collision changes: samples of initial states, success and force of the oracle.

    python research/self_collision.py

Each result is stored in self_collision.json; results that the file contains are not measured again.
"""

from pathlib import Path

from avrgym.learning.evaluation import evaluate
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.placement_check import count_initial_state_samples
from avrgym.tasks.settings import Settings
from figures_file import add, chosen, read

FIGURES_FILE = Path(__file__).with_suffix(".json")
ENVIRONMENTS = ("ScratchItchPR2", "ScratchItchGen3", "BedBathingJaco", "FeedingPR2")
EPISODES, STARTS, SEED, PEOPLE = 50, 64, 0, "revised"
FIGURES = ("episodes", "success_rate", "success_ci95", "force_mean_newton")


def main() -> None:
    """Measure and store, one environment after the other."""
    for name in ENVIRONMENTS:
        for on in (False, True):
            key = f"{name} {'on' if on else 'off'}"
            if key in read(FIGURES_FILE):
                continue
            environment, settings = f"avrgym/{name}-v1", Settings(self_collision=on)
            found = evaluate(environment, "oracle", PEOPLE, EPISODES, SEED, settings=settings)
            episodes = Episodes(environment, STARTS, people=PEOPLE, num_threads=1, settings=settings)
            add(
                FIGURES_FILE,
                key,
                {**chosen(found, FIGURES), "draws": count_initial_state_samples(episodes).mean_samples},
            )


if __name__ == "__main__":
    main()
