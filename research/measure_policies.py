"""Evaluates every packaged policy and writes the results into its file.

    python research/measure_policies.py

Run it after every change of the simulated world. Each policy is evaluated with its training population in 1 000
episodes of the test split, seed 0.
"""

from dataclasses import replace
from typing import Any

import msgspec

from avrgym.learning.evaluation import evaluate_all
from avrgym.policies.trained import Policy, packaged_policies
from avrgym.tasks.constants import WORLD_VERSION
from avrgym.tasks.registry import ENVIRONMENTS
from figures_file import chosen

EPISODES, SEED = 1000, 0
MEASURES = ("split", "episodes", "success_rate", "reward_mean", "reward_std", "force_mean_newton")
FIRST = 4
"""So many episodes are enough to see whether a world is another one; tests run them."""


def main() -> None:
    """One line for each policy as it is done; one that is measured already is left as it is."""
    for environment in ENVIRONMENTS:
        for name, path in packaged_policies(environment).items():
            policy = Policy.load(path)
            if not is_measured(policy):
                measured = measure(environment, name, policy.metadata.people)
                metadata = msgspec.structs.replace(policy.metadata, measured=measured)
                replace(policy, metadata=metadata).save(path, overwrite=True)
                print(environment, name, measured, flush=True)


def is_measured(policy: Policy) -> bool:
    """Whether its file already says what it reaches in today's world."""
    measured = policy.metadata.measured
    return measured.get("world_version") == WORLD_VERSION and "first_reward_mean" in measured


def measure(environment: str, name: str, people: str) -> dict[str, Any]:
    """The results that a policy's file contains."""
    (found,), (first,) = (
        evaluate_all([environment], name, people, episodes, SEED) for episodes in (EPISODES, FIRST)
    )
    return {
        **chosen(found, MEASURES),
        "world_version": WORLD_VERSION,
        "first_reward_mean": first.reward_mean,
    }


if __name__ == "__main__":
    main()
