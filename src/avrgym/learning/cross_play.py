"""Every policy with every group of people."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from avrgym.learning.evaluation import Evaluation, Progress, evaluate_all
from avrgym.people.impairments import find_impairment
from avrgym.policies import registry
from avrgym.simulation.engines.engine import check_engine
from avrgym.system.engines import THREADS
from avrgym.system.random_streams import TEST, Split
from avrgym.tasks.constants import ENVIRONMENTS, expected_errors
from avrgym.tasks.registry import find_environment
from avrgym.tasks.world_people import environment_populations

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

LeaveOut = Callable[[str, Exception], None]
"""Is called with an environment in words, and with the error that keeps it from being run."""
Run = Callable[[Sequence[str]], list[Evaluation]]
"""Evaluates one policy with one group of people in some environments."""


def cross_play(
    environment_ids: Sequence[str],
    policies: Sequence[str],
    people: Sequence[str],
    episodes: int,
    seed: int,
    progress: Progress = lambda steps: None,
    *,
    impairment: str = "none",
    split: Split = TEST,
    jobs: int | None = None,
    cluster: "Cluster | None" = None,
    allow_other_environment: bool = False,
    force_guard: bool = False,
    withdraw_after_success: bool = False,
    engine: str = THREADS,
    leave_out: LeaveOut | None = None,
) -> list[Evaluation]:
    """A row for each group of people, policy and environment; arguments as of ``evaluate_all``.

    In an environment each policy meets the same people in the same episodes. With ``leave_out`` an environment that
    lacks a policy or people, or that fails, has no row there and is named to it.

    Raises:
        ValueError: for an unknown name, before anything is run, naming what is allowed; with ``leave_out`` for a name
            that no environment knows, and where all of them failed.
    """
    find_impairment(impairment)
    check_engine(engine)
    for environment_id in environment_ids:
        find_environment(environment_id)
    find_policy = partial(registry.find, allow_other_environment=allow_other_environment)
    met_in = {
        group: _known_in(environment_ids, group, environment_populations, leave_out) for group in people
    }
    driven_in = {policy: _known_in(environment_ids, policy, find_policy, leave_out) for policy in policies}
    rows: list[Evaluation] = []
    for group in people:
        for policy in policies:
            run = partial(
                evaluate_all,
                policy=policy,
                people=group,
                episodes=episodes,
                seed=seed,
                progress=progress,
                impairment=impairment,
                split=split,
                jobs=jobs,
                cluster=cluster,
                allow_other_environment=allow_other_environment,
                force_guard=force_guard,
                withdraw_after_success=withdraw_after_success,
                engine=engine,
            )
            chosen = [each for each in environment_ids if each in met_in[group] and each in driven_in[policy]]
            if leave_out is None:
                rows += run(chosen)
            else:
                found = _rows_of_those_that_run(run, chosen, f"{policy} and {group}", leave_out)
                rows += sorted(found, key=lambda row: chosen.index(row.env))
    if not rows:
        raise ValueError("nothing was evaluated: every environment was left out")
    return rows


def _known_in(
    environment_ids: Sequence[str],
    name: str,
    find: Callable[[str, str], object],
    leave_out: LeaveOut | None,
) -> set[str]:
    """The environments that know a name of a policy or of people; the first error where none does."""
    errors: dict[str, Exception] = {}
    for environment_id in environment_ids:
        try:
            find(name, environment_id)
        except expected_errors(environment_id) as error:
            errors[environment_id] = error
            if leave_out is None or len(errors) == len(environment_ids):
                raise next(iter(errors.values())) from None
    for environment_id, error in errors.items():
        if leave_out is not None:
            leave_out(f"{environment_id} with {name}", error)
    return {*environment_ids} - errors.keys()


def _rows_of_those_that_run(
    run: Run, environment_ids: Sequence[str], whose: str, leave_out: LeaveOut
) -> Iterator[Evaluation]:
    """Packaged environments run together, unless one of them fails; those of other packages run alone."""
    packaged = [each for each in environment_ids if each in ENVIRONMENTS]
    alone = [each for each in environment_ids if each not in ENVIRONMENTS]
    try:
        yield from run(packaged) if packaged else ()
    except (ValueError, RuntimeError) as error:
        if len(packaged) == 1:
            leave_out(f"{packaged[0]} with {whose}", error)
        else:
            alone = [*packaged, *alone]
    for each in alone:
        try:
            yield from run([each])
        except expected_errors(each) as error:
            leave_out(f"{each} with {whose}", error)


def matrix(rows: Sequence[Evaluation]) -> list[dict[str, Any]]:
    """Success with its 95 % interval: a row for each environment and policy, a column for each group of people."""
    table: dict[tuple[str, str], dict[str, Any]] = {}
    groups = dict.fromkeys(row.people for row in rows)
    for row in rows:
        line = table.setdefault((row.env, row.policy), {"env": row.env, "policy": row.policy, **groups})
        low, high = row.success_ci95
        line[row.people] = f"{row.success_rate:.0%} [{100.0 * low:.0f}, {100.0 * high:.0f}]"
    return list(table.values())
