"""Evaluation of policies over many episodes. The same seed gives the same results."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.people.populations import read_people_for_workers
from avrgym.policies import registry
from avrgym.policies.trained_policies import Policy
from avrgym.safety.region_forces import (
    RegionLoadRecorder,
    RegionLoads,
    RegionStatistics,
    compute_region_statistics,
)
from avrgym.simulation.engines.engine import check_engine_name
from avrgym.system.engine_names import THREADS
from avrgym.system.parallel_calls import count_available_cores, report_progress, starmap
from avrgym.system.random_streams import TEST, Split, make_evaluation_rngs
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import find_environment
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

StepReporter = Callable[[int], None]

MAX_WORLDS_PER_BATCH = 64
MIN_EPISODES_PER_PROCESS = 16
"""Minimum number of episodes per process. With fewer episodes, the start of another process takes too long."""
NORMAL_QUANTILE_95 = NormalDist().inv_cdf(0.975)
"""Quantile of the standard normal distribution for two-sided 95 % intervals."""


class EpisodeResults(NamedTuple):
    """Results of n episodes, arrays (n,). ``initial_state_samples`` is the number of sampled initial states. Samples
    are drawn until one has enough clearance.
    """

    episode_returns: FloatArray
    success: BoolArray
    mean_forces_n: FloatArray
    loads_by_region: RegionLoads
    num_guard_interventions: IntArray
    initial_state_samples: IntArray
    device: str


@dataclass(frozen=True)
class EvaluationResult:
    """Results of one policy in one environment. Results on the test ``split`` must not be used to select a policy.

    ``force_mean_newton`` is the mean force on the person over all steps. ``force_regions`` contains forces by body
    region. ``episodes_over_limit`` is the number of episodes in which a region exceeded its limits, see
    ``RegionLoads``. ``guard_interventions`` is the mean number of force guard interventions per episode, ``None``
    without the force guard. ``plugin_differences`` lists plug-ins that changed since the policy's training. Initial
    states are resampled until they have enough clearance. ``start_draws_mean`` and ``start_draws_max`` are the mean and
    maximum number of samples per episode. ``starts_refused`` is the number of rejected samples. ``settings`` contains
    the settings that differ from the defaults. ``steps`` is the number of control steps of an episode.
    """

    env: str
    policy: str
    people: str
    impairment: str
    split: Split
    episodes: int
    reward_mean: float
    reward_std: float
    success_rate: float
    success_ci95: tuple[float, float]
    force_mean_newton: float
    episodes_over_limit: int
    guard_interventions: float | None
    engine: str
    device: str
    force_regions: dict[str, RegionStatistics]
    settings: dict[str, Any]
    steps: int
    plugin_differences: list[str]
    trained_with_force_guard: bool
    start_draws_mean: float
    start_draws_max: int
    starts_refused: int


@dataclass(frozen=True)
class _Batch:
    """Episodes of one environment that run in parallel. ``episodes`` contains their numbers, from 0."""

    environment_id: str
    policy: TransferredFile
    people: TransferredFile
    impairment: str
    split: Split
    seed: int
    episodes: range
    threads: int
    engine: str
    allow_other_environment: bool
    force_guard: bool
    withdraw_after_success: bool
    settings: Settings
    allow_other_settings: bool
    steps: int


def evaluate(
    environment_id: str,
    policy: str,
    people: str,
    episodes: int,
    seed: int,
    progress: StepReporter = lambda steps: None,
    *,
    impairment: str = "none",
    split: Split = TEST,
    force_guard: bool = False,
    engine: str = THREADS,
    settings: Settings = DEFAULT_SETTINGS,
    steps: int = EPISODE_STEPS,
) -> EvaluationResult:
    """Evaluates a policy in one environment, in this process. Returns the results. The arguments are those of
    ``evaluate_all``.
    """
    (row,) = evaluate_all(
        [environment_id],
        policy,
        people,
        episodes,
        seed,
        progress,
        impairment=impairment,
        split=split,
        jobs=1,
        force_guard=force_guard,
        engine=engine,
        settings=settings,
        steps=steps,
    )
    return row


def evaluate_all(
    environment_ids: Sequence[str],
    policy: str,
    people: str,
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
) -> list[EvaluationResult]:
    """Evaluate a policy in each environment. Returns one result per environment, in the same order.

    Args:
        environment_ids: environment ids such as ``avrgym/FeedingJaco-v1``.
        policy: a name or path that ``policies.registry.resolve_policy`` accepts.
        people: a name in ``people.distributions.NAMED_DISTRIBUTIONS``, a people file, a trained human or a folder of
            trained humans.
        episodes: number of episodes per environment, 1 or more.
        seed: seed of the episodes, which determines people and initial states.
        progress: called repeatedly with the number of environment steps since the last call.
        impairment: a name in ``people.impairments.IMPAIRMENTS``.
        split: episodes of the test or the validation split, see ``random_streams``.
        jobs: number of processes; it does not change results. By default: one per core, or one if physics is computed
            on a device. With few episodes, fewer processes run.
        cluster: a cluster that runs the episodes instead of this computer. It does not change results.
        allow_other_environment: whether to allow a policy that was trained for another environment.
        force_guard: whether the force guard limits contact force and approach speed.
        withdraw_after_success: whether the robot withdraws its tool after success.
        engine: the physics engine. Published results use ``threads``.
        settings: settings of the environments.
        allow_other_settings: whether to allow a policy that was trained with other settings.
        steps: number of control steps of an episode.

    Raises:
        ValueError: for an unknown name, or fewer than one episode. Also for a policy that was trained for another
            environment, other settings or other array sizes. The message contains the allowed values.
        ControllerError: if the controller of another package fails.
    """
    if episodes < 1:
        raise ValueError(f"the number of episodes is {episodes}; allowed: 1 or more")
    found: list[registry.RobotPolicy] = []
    for environment_id in environment_ids:
        find_environment(environment_id)
        found.append(
            registry.resolve_policy(
                policy,
                environment_id,
                settings,
                allow_other_environment=allow_other_environment,
                allow_other_settings=allow_other_settings,
            )
        )
    check_engine_name(engine)
    total = len(environment_ids) * episodes
    available = count_available_cores() if cluster is None else cluster.max_parallel_calls
    jobs = jobs or (min(available, max(1, total // MIN_EPISODES_PER_PROCESS)) if engine == THREADS else 1)
    threads = max(1, available // jobs) if cluster is None else 1
    parts = _parts(episodes, min(MAX_WORLDS_PER_BATCH, -(-total // jobs)))
    policy_file, population = TransferredFile.read(policy), read_people_for_workers(people)
    batches = [
        _Batch(
            environment_id=environment_id,
            policy=policy_file,
            people=population,
            impairment=impairment,
            split=split,
            seed=seed,
            episodes=numbers,
            threads=threads,
            allow_other_environment=allow_other_environment,
            force_guard=force_guard,
            withdraw_after_success=withdraw_after_success,
            engine=engine,
            settings=settings,
            allow_other_settings=allow_other_settings,
            steps=steps,
        )
        for environment_id in environment_ids
        for numbers in parts
    ]
    results = _run_batches(batches, jobs, cluster, progress)
    firsts = range(0, len(batches), len(parts))
    return [
        _sum_up(batches[first], results[first : first + len(parts)], of_environment)
        for first, of_environment in zip(firsts, found, strict=True)
    ]


def _parts(episodes: int, size: int) -> list[range]:
    """Split the episode numbers into ranges with at most ``size`` numbers. Lengths of ranges differ by at most 1."""
    count = -(-episodes // size)
    bounds = [number * episodes // count for number in range(count + 1)]
    return [range(*bound) for bound in pairwise(bounds)]


def _run_batches(
    batches: list[_Batch], jobs: int, cluster: "Cluster | None", progress: StepReporter
) -> list[EpisodeResults]:
    """Run all batches. Returns the results of each batch, in order."""
    if cluster is None and (jobs == 1 or len(batches) == 1):
        return [_run_batch(batch, progress) for batch in batches]
    reported = 0

    def report_total(done: int) -> None:
        nonlocal reported
        progress(done - reported)
        reported = done

    arguments = [(batch, report_progress) for batch in batches]
    if cluster is not None:
        return cluster.starmap(_run_batch, arguments, report_total)
    return starmap(_run_batch, arguments, jobs, report_total)


def _run_batch(batch: _Batch, progress: StepReporter) -> EpisodeResults:
    world = Episodes(
        batch.environment_id,
        len(batch.episodes),
        people=batch.people.get_local_path(),
        impairment=batch.impairment,
        num_threads=batch.threads,
        by_region=True,
        engine=batch.engine,
        withdraw_after_success=batch.withdraw_after_success,
        force_guard=batch.force_guard,
        settings=batch.settings,
    )
    generators = make_evaluation_rngs(batch.split, batch.seed, batch.episodes)
    return _run(world, batch, generators, progress)


def _sum_up(batch: _Batch, results: list[EpisodeResults], policy: registry.RobotPolicy) -> EvaluationResult:
    """Combine the results of all batches of an environment. Returns one ``EvaluationResult``."""
    reward, success, force, interventions, draws = (
        np.concatenate([getattr(part, name) for part in results])
        for name in (
            "episode_returns",
            "success",
            "mean_forces_n",
            "num_guard_interventions",
            "initial_state_samples",
        )
    )
    loads = RegionLoads.concatenate([part.loads_by_region for part in results])
    return EvaluationResult(
        env=batch.environment_id,
        policy=batch.policy.name,
        people=batch.people.name,
        impairment=batch.impairment,
        split=batch.split,
        episodes=len(reward),
        reward_mean=float(reward.mean()),
        reward_std=float(reward.std()),
        success_rate=float(success.mean()),
        success_ci95=compute_wilson_interval(int(success.sum()), len(success)),
        force_mean_newton=float(force.mean()),
        episodes_over_limit=int(loads.over_limit_mask.any(axis=-1).sum()),
        guard_interventions=float(interventions.mean()) if batch.force_guard else None,
        engine=batch.engine.partition(":")[0],
        device=results[0].device,
        force_regions=compute_region_statistics(loads),
        settings=batch.settings.changed_values,
        steps=batch.steps,
        plugin_differences=registry.describe_plugin_changes(policy, batch.environment_id),
        trained_with_force_guard=isinstance(policy, Policy) and policy.metadata.force_guard,
        start_draws_mean=float(draws.mean()),
        start_draws_max=int(draws.max()),
        starts_refused=int((draws - 1).sum()),
    )


def compute_wilson_interval(
    successes: float, count: float, quantile: float = NORMAL_QUANTILE_95
) -> tuple[float, float]:
    """Returns Wilson's score interval of a proportion, 95 % by default (J. Am. Stat. Assoc. 22, 1927, p. 209).

    ``count`` may be an effective sample size. ``quantile`` may be a quantile of Student's t distribution.
    """
    proportion, z_squared_by_count = successes / count, quantile**2 / count
    middle = proportion + z_squared_by_count / 2.0
    half = (z_squared_by_count * (proportion * (1.0 - proportion) + z_squared_by_count / 4.0)) ** 0.5
    low, high = ((middle + sign * half) / (1.0 + z_squared_by_count) for sign in (-1.0, 1.0))
    return (low if successes > 0 else 0.0), (high if successes < count else 1.0)


def _run(
    world: Episodes, batch: _Batch, generators: list[np.random.Generator], progress: StepReporter
) -> EpisodeResults:
    """Run one batch of episodes in ``world``, one episode per random generator. Returns their results."""
    count = len(generators)
    found = registry.resolve_policy(
        batch.policy.get_local_path(),
        world.environment_id,
        batch.settings,
        allow_other_environment=batch.allow_other_environment,
        allow_other_settings=batch.allow_other_settings,
    )
    observation = world.reset(np.arange(count), generators)
    draws = world.num_initial_state_samples.astype(np.intp)
    reward, force, success = np.zeros(count), np.zeros(count), np.zeros(count, dtype=bool)
    recorder = RegionLoadRecorder(count)
    with registry.open_policy(found, world, generators) as act:
        for _ in range(batch.steps):
            step = world.step(act(observation).astype(float), recorder)
            observation, success = step.observation, step.success
            reward += step.reward
            force += step.force_on_person_n / batch.steps
            progress(count)
    guard = world.control_loop.guard
    interventions = np.zeros(count, dtype=np.intp) if guard is None else guard.num_interventions
    device = world.simulation.engine.device
    return EpisodeResults(reward, success, force, recorder.compute_loads(), interventions, draws, device)
