"""Policies from demonstrations: evaluates policies, and prints the note's table.

python research/demonstrations.py ENVIRONMENT POLICY...
"""

import sys

from avrgym.learning.evaluation import evaluate

PEOPLE = "zoo/train", "zoo/unseen", "participants"
EPISODES = 50


def print_table(environment: str, policies: list[str]) -> None:
    """Print success, mean force and episodes over a limit of each policy with each population."""
    print("| policy | people | success | 95 % interval | mean force (N) | episodes over a limit |")
    print("|---|---|---|---|---|---|")
    for policy in policies:
        for people in PEOPLE:
            row = evaluate(environment, policy, people, EPISODES, 0)
            low, high = (100.0 * each for each in row.success_ci95)
            print(
                f"| {policy} | {people} | {100.0 * row.success_rate:.0f} % | {low:.0f} to {high:.0f} % | "
                f"{row.force_mean_newton:.2f} | {row.episodes_over_limit} |",
                flush=True,
            )


if __name__ == "__main__":
    print_table(sys.argv[1], sys.argv[2:])
