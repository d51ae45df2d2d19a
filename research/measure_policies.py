"""Evaluates every packaged policy and writes the results into its file.

    python research/measure_policies.py [EPISODES]

Run it after every change of the simulated world. Each policy is evaluated with its training population in the test
split, seed 0; by default in 1 000 episodes. Policies with results from as many episodes are left out.
"""

import sys
from dataclasses import replace
from typing import Any

import msgspec

from avrgym.learning.evaluation import evaluate_all
from avrgym.policies.trained_policies import Policy, find_packaged_policies
from avrgym.tasks.constants import SIMULATION_VERSION
from avrgym.tasks.registry import ENVIRONMENTS
from figures_file import chosen

EPISODES, SEED = 1000, 0
MEASURES = (
    "split", "episodes", "success_rate", "reward_mean", "reward_std", "force_mean_newton", "episodes_over_limit"
)  # fmt: skip
FIRST = 4
"""So many episodes are enough to see whether a world is another one; tests run them."""


def main() -> None:
    """Measure and store, one policy after the other."""
    episodes = int(sys.argv[1]) if len(sys.argv) > 1 else EPISODES
    for environment in ENVIRONMENTS:
        for name, path in find_packaged_policies(environment).items():
            policy = Policy.load(path)
            if not is_measured(policy, episodes):
                measured = measure(environment, name, policy.metadata.people, episodes)
                metadata = msgspec.structs.replace(policy.metadata, measured=measured)
                replace(policy, metadata=metadata).save(path, overwrite=True)
                print(environment, name, measured, flush=True)


def is_measured(policy: Policy, episodes: int) -> bool:
    """Whether the file contains results from at least so many episodes in the present simulated world."""
    measured = policy.metadata.measured
    is_present = measured.get("world_version") == SIMULATION_VERSION and "first_reward_mean" in measured
    return is_present and measured["episodes"] >= episodes


def measure(environment: str, name: str, people: str, episodes: int) -> dict[str, Any]:
    """The results that a policy's file contains."""
    (found,), (first,) = (evaluate_all([environment], name, people, n, SEED) for n in (episodes, FIRST))
    return {
        **chosen(found, MEASURES),
        "world_version": SIMULATION_VERSION,
        "first_reward_mean": first.reward_mean,
    }


if __name__ == "__main__":
    main()
