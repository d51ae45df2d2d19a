"""Cross-play: evaluates every policy with every population in every environment."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from avrgym.learning.evaluation import EvaluationResult, StepReporter, evaluate_all
from avrgym.people.impairments import parse_impairment
from avrgym.policies import registry
from avrgym.simulation.engines.engine import check_engine_name
from avrgym.system.engine_names import THREADS
from avrgym.system.random_streams import TEST, Split
from avrgym.tasks.constants import EPISODE_STEPS, PACKAGED_ENVIRONMENTS, list_skippable_errors
from avrgym.tasks.registry import find_environment
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.world_people import find_environment_populations

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

SkippedEnvironmentReporter = Callable[[str, Exception], None]
"""Function that reports skipped environments. Arguments: a description of the environments, and the error."""
EvaluationFunction = Callable[[Sequence[str]], list[EvaluationResult]]
"""Function that evaluates one policy with one population in some environments."""


def run_cross_play(
    environment_ids: Sequence[str],
    policies: Sequence[str],
    people: Sequence[str],
    episodes: int,
    seed: int,
    progress: StepReporter = lambda steps: None,
    *,
    impairment: str = "none",
    split: Split = TEST,
    jobs: int | None = None,
    cluster: "Cluster | None" = None,
    allow_other_environment: bool = False,
    force_guard: bool = False,
    withdraw_after_success: bool = False,
    engine: str = THREADS,
    settings: Settings = DEFAULT_SETTINGS,
    allow_other_settings: bool = False,
    steps: int = EPISODE_STEPS,
    leave_out: SkippedEnvironmentReporter | None = None,
) -> list[EvaluationResult]:
    """Evaluate every policy with every population. Returns a row for each population, policy and environment.

    The arguments are those of ``evaluate_all``. In an environment, all policies are evaluated in the same episodes.
    With ``leave_out``, environments are skipped if they have an error, or do not have the policy or population.
    ``leave_out`` is called once for the environments without a policy or population, and once for each error.

    Raises:
        ValueError: before the evaluation, for an unknown name; the message contains the allowed values. With
            ``leave_out``: only if a name is unknown in every environment, or if all evaluations fail.
    """
    parse_impairment(impairment)
    check_engine_name(engine)
    for environment_id in environment_ids:
        find_environment(environment_id)
    find_policy = partial(
        registry.resolve_policy,
        settings=settings,
        allow_other_environment=allow_other_environment,
        allow_other_settings=allow_other_settings,
    )
    with_people = {
        population: _environments_with(environment_ids, population, find_environment_populations, leave_out)
        for population in people
    }
    with_policy = {
        policy: _environments_with(environment_ids, policy, find_policy, leave_out) for policy in policies
    }
    rows: list[EvaluationResult] = []
    for population in people:
        for policy in policies:
            run = partial(
                evaluate_all,
                policy=policy,
                people=population,
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
                settings=settings,
                allow_other_settings=allow_other_settings,
                steps=steps,
            )
            chosen = [
                each
                for each in environment_ids
                if each in with_people[population] and each in with_policy[policy]
            ]
            if leave_out is None:
                rows += run(chosen)
            else:
                found = _rows(run, chosen, f"{policy} and {population}", leave_out)
                rows += sorted(found, key=lambda row: chosen.index(row.env))
    if not rows:
        raise ValueError("no environment was evaluated: all were skipped; correct the errors above")
    return rows


def _environments_with(
    environment_ids: Sequence[str],
    name: str,
    find: Callable[[str, str], object],
    leave_out: SkippedEnvironmentReporter | None,
) -> set[str]:
    """Returns the environments that have the policy or population ``name``, according to ``find``.

    Raises the first error if there are none, or if ``leave_out`` is None.
    """
    errors: dict[str, Exception] = {}
    for environment_id in environment_ids:
        try:
            find(name, environment_id)
        except list_skippable_errors(environment_id) as error:
            errors[environment_id] = error
            if leave_out is None or len(errors) == len(environment_ids):
                raise next(iter(errors.values())) from None
    if leave_out is not None and errors:
        leave_out(f"{', '.join(errors)} with {name}", next(iter(errors.values())))
    return {*environment_ids} - errors.keys()


def _rows(
    run: EvaluationFunction, environment_ids: Sequence[str], label: str, leave_out: SkippedEnvironmentReporter
) -> Iterator[EvaluationResult]:
    """Evaluate packaged environments together, and other environments one by one. Yields the results.

    If the joint evaluation fails, the packaged environments are evaluated one by one as well.
    """
    packaged = [each for each in environment_ids if each in PACKAGED_ENVIRONMENTS]
    single = [each for each in environment_ids if each not in PACKAGED_ENVIRONMENTS]
    try:
        yield from run(packaged) if packaged else ()
    except (ValueError, RuntimeError) as error:
        if len(packaged) == 1:
            leave_out(f"{packaged[0]} with {label}", error)
        else:
            single = [*packaged, *single]
    for each in single:
        try:
            yield from run([each])
        except list_skippable_errors(each) as error:
            leave_out(f"{each} with {label}", error)


def make_success_table(rows: Sequence[EvaluationResult]) -> list[dict[str, Any]]:
    """Returns a table of success rates with 95 % intervals: a row per environment and policy, a column per
    population."""
    table: dict[tuple[str, str], dict[str, Any]] = {}
    groups = dict.fromkeys(row.people for row in rows)
    for row in rows:
        row_of_table = table.setdefault(
            (row.env, row.policy), {"env": row.env, "policy": row.policy, **groups}
        )
        low, high = row.success_ci95
        row_of_table[row.people] = f"{row.success_rate:.0%} [{100.0 * low:.0f}, {100.0 * high:.0f}]"
    return list(table.values())
