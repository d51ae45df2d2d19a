"""What the packaged policies reach, as the tables of docs/policies.md and docs/adaptive.md.

python research/policy_tables.py                                   what their own files say
python research/policy_tables.py settings                          how each task is trained; needs avrgym[train]
python research/policy_tables.py original.json revised.json       Original against Revised on the same people, of
                                                                   what `avrgym evaluate --all --json` wrote of each
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

from avrgym.learning.evaluation import wilson_interval
from avrgym.policies.trained import Policy, packaged_policies
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from papers_results import SIMULATION, short


def packaged_table(kind: str) -> Iterator[str]:
    """The rows of one kind of policy, each on the people it was trained on."""
    yield "| environment | success | paper | reward | paper | force on the person | chance | steps | hours |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for environment in ENVIRONMENTS:
        file = packaged_policies(environment).get(kind)
        if file is not None:
            yield _packaged_row(environment, Policy.load(file))


def _packaged_row(environment: str, policy: Policy) -> str:
    metadata = policy.metadata
    measured = metadata.measured
    success = _success(round(measured["success_rate"] * measured["episodes"]), measured["episodes"])
    paper_success, paper_reward = SIMULATION[environment]
    hours = f"{metadata.seconds / 3600:.1f}" if metadata.seconds else "–"
    return (
        f"| {short(environment)} | {success} | {paper_success} % | {measured['reward_mean']:.0f} | {paper_reward} "
        f"| {measured['force_mean_newton']:.1f} N | {policy.action_std:.2g} | {metadata.steps / 1e6:.2f} M "
        f"| {hours} |"
    )


def comparison_table(original: list[dict], revised: list[dict]) -> Iterator[str]:
    """Original beside Revised, and both averaged over all environments, which have equally many episodes."""
    yield "| environment | Original | Revised | force, Original | force, Revised |"
    yield "|---|---|---|---|---|"
    for one, other in zip(original, revised, strict=True):
        forces = f"{one['force_mean_newton']:.1f} N | {other['force_mean_newton']:.1f} N"
        yield f"| {short(one['env'])} | {_row_success([one])} | {_row_success([other])} | {forces} |"
    yield f"| all | {_row_success(original)} | {_row_success(revised)} | | |"


def settings_table() -> Iterator[str]:
    """What differs between the tasks in how `avrgym train` trains."""
    from avrgym.learning.training import configuration_for

    yield (
        "| task | worlds | minibatch | rounds of imitation | log standard deviation | learning rate "
        "| last weight of force, 1/N | weight of detours, 1/m | hard episodes |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for task in TASKS:
        how = configuration_for(f"avrgym/{task}Jaco-v1", "original", 1, 0)
        first, last = how.log_std
        yield (
            f"| {task} | {how.num_envs} | {how.batch_size} | {how.imitation_rounds} | {first:g} to {last:g} "
            f"| {how.learning_rate:g} | {how.force_weight_per_n:g} | {how.detour_weight_per_m:g} "
            f"| {100.0 * how.hard_share:g} % |"
        )


def _row_success(rows: list[dict]) -> str:
    episodes = sum(row["episodes"] for row in rows)
    return _success(round(sum(row["success_rate"] * row["episodes"] for row in rows)), episodes)


def _success(successes: int, episodes: int) -> str:
    low, high = wilson_interval(successes, episodes)
    return f"{100.0 * successes / episodes:.3g} % [{100.0 * low:.0f}, {100.0 * high:.0f}]"


if __name__ == "__main__":
    if len(sys.argv) == 3:
        lines = comparison_table(*(json.loads(Path(path).read_text()) for path in sys.argv[1:]))
    elif sys.argv[1:] == ["settings"]:
        lines = settings_table()
    else:
        lines = (
            line for kind in ("original", "revised", "adaptive") for line in ("", kind, *packaged_table(kind))
        )
    print("\n".join(lines))
