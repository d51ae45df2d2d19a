"""Tables about packaged policies.

python research/policy_tables.py settings                       training settings by task; needs avrgym[train]
python research/policy_tables.py original.json revised.json     Original against Revised, from two files that
                                                                `avrgym evaluate --all --json` wrote
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

from avrgym.learning.evaluation import compute_wilson_interval
from avrgym.tasks.registry import TASKS
from papers_results import short


def comparison_table(original: list[dict], revised: list[dict]) -> Iterator[str]:
    """Original against Revised by environment, and over all environments."""
    yield "| environment | Original | Revised | force, Original | force, Revised |"
    yield "|---|---|---|---|---|"
    for one, other in zip(original, revised, strict=True):
        forces = f"{one['force_mean_newton']:.1f} N | {other['force_mean_newton']:.1f} N"
        yield f"| {short(one['env'])} | {_row_success([one])} | {_row_success([other])} | {forces} |"
    yield f"| all | {_row_success(original)} | {_row_success(revised)} | | |"


def settings_table() -> Iterator[str]:
    """Training settings that differ between the tasks."""
    from avrgym.learning.training import make_feedforward_configuration

    yield (
        "| task | worlds | minibatch | imitation rounds | log standard deviation of actions | learning rate "
        "| final cost of force, 1/N | cost of detours, 1/m | repeated hard episodes |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for task in TASKS:
        how = make_feedforward_configuration(f"avrgym/{task}Jaco-v1", "original", 1, 0)
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
    low, high = compute_wilson_interval(successes, episodes)
    return f"{100.0 * successes / episodes:.3g} % [{100.0 * low:.0f}, {100.0 * high:.0f}]"


if __name__ == "__main__":
    if len(sys.argv) == 3:
        lines = comparison_table(*(json.loads(Path(path).read_text()) for path in sys.argv[1:]))
    elif sys.argv[1:] == ["settings"]:
        lines = settings_table()
    else:
        sys.exit(__doc__)
    print("\n".join(lines))
