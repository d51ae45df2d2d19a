"""Measures every packaged policy anew and writes what it reaches into its file.

    python scripts/figures/measure_policies.py

Needed whenever the world changes; `scripts/figures/policy_tables.py` then prints the tables of docs/policies.md. Each
policy meets people like those it was trained on, 100 episodes, seed 0.
"""

from dataclasses import asdict, replace

import msgspec

from avrgym.learning.evaluation import evaluate
from avrgym.policies.trained import Policy, packaged_policies
from avrgym.simulation.world_version import WORLD_VERSION
from avrgym.tasks.registry import ENVIRONMENTS

EPISODES, SEED = 100, 0
MEASURES = ("episodes", "success_rate", "reward_mean", "reward_std", "force_mean_newton")


def main() -> None:
    """One line for each policy as it is done."""
    for environment in ENVIRONMENTS:
        for name, path in packaged_policies(environment).items():
            policy = Policy.load(path)
            found = asdict(evaluate(environment, name, policy.metadata.people, EPISODES, SEED))
            measured = {measure: found[measure] for measure in MEASURES} | {"world_version": WORLD_VERSION}
            metadata = msgspec.structs.replace(policy.metadata, measured=measured)
            replace(policy, metadata=metadata).save(path, overwrite=True)
            print(environment, name, {measure: round(found[measure], 3) for measure in MEASURES}, flush=True)


if __name__ == "__main__":
    main()
