"""Measures every packaged policy anew and writes what it reaches into its file.

    python scripts/figures/measure_policies.py

Needed whenever the world changes; `scripts/figures/policy_tables.py` then prints the tables of docs/policies.md. Each
policy meets people like those it was trained on, 1 000 episodes of the stream that no choice has seen, seed 0.
"""

from dataclasses import asdict, replace

import msgspec

from avrgym.learning.evaluation import evaluate_all
from avrgym.policies.trained import Policy, packaged_policies
from avrgym.simulation.world_version import WORLD_VERSION
from avrgym.tasks.registry import ENVIRONMENTS

EPISODES, SEED = 1000, 0
MEASURES = ("stream", "episodes", "success_rate", "reward_mean", "reward_std", "force_mean_newton")


def main() -> None:
    """One line for each policy as it is done."""
    for environment in ENVIRONMENTS:
        for name, path in packaged_policies(environment).items():
            policy = Policy.load(path)
            found = asdict(evaluate_all([environment], name, policy.metadata.people, EPISODES, SEED)[0])
            measured = {measure: found[measure] for measure in MEASURES} | {"world_version": WORLD_VERSION}
            metadata = msgspec.structs.replace(policy.metadata, measured=measured)
            replace(policy, metadata=metadata).save(path, overwrite=True)
            print(environment, name, measured, flush=True)


if __name__ == "__main__":
    main()
