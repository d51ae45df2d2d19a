"""Every policy with every group of people: who gets on with whom."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from avrgym.learning.evaluation import Evaluation, Progress, evaluate_all
from avrgym.learning.seed_streams import SHOWING, Stream
from avrgym.people.impairments import find_impairment
from avrgym.policies import registry
from avrgym.simulation.engines.engine import check_engine
from avrgym.system.engines import THREADS
from avrgym.tasks.company import find_company
from avrgym.tasks.registry import find_environment

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster


def cross_play(
    environment_ids: Sequence[str],
    policies: Sequence[str],
    people: Sequence[str],
    episodes: int,
    seed: int,
    progress: Progress = lambda steps: None,
    *,
    impairment: str = "none",
    stream: Stream = SHOWING,
    jobs: int | None = None,
    cluster: "Cluster | None" = None,
    allow_other_environment: bool = False,
    force_guard: bool = False,
    engine: str = THREADS,
) -> list[Evaluation]:
    """A row for each group of people, policy and environment; arguments as of ``evaluate_all``.

    In an environment each policy meets the same people in the same episodes.

    Raises:
        ValueError: for an unknown name, before anything is run, naming what is allowed.
    """
    find_impairment(impairment)
    check_engine(engine)
    for environment_id in environment_ids:
        find_environment(environment_id)
        for whom in people:
            find_company(whom, environment_id)
        for policy in policies:
            registry.find(policy, environment_id, allow_other_environment=allow_other_environment)
    return [
        row
        for whom in people
        for policy in policies
        for row in evaluate_all(
            environment_ids,
            policy,
            whom,
            episodes,
            seed,
            progress,
            impairment=impairment,
            stream=stream,
            jobs=jobs,
            cluster=cluster,
            allow_other_environment=allow_other_environment,
            force_guard=force_guard,
            engine=engine,
        )
    ]


def matrix(rows: Sequence[Evaluation]) -> list[dict[str, Any]]:
    """Success with its 95 % interval: a row for each environment and policy, a column for each group of people."""
    table: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:
        line = table.setdefault((row.env, row.policy), {"env": row.env, "policy": row.policy})
        low, high = row.success_ci95
        line[row.people] = f"{row.success_rate:.0%} [{100.0 * low:.0f}, {100.0 * high:.0f}]"
    return list(table.values())
