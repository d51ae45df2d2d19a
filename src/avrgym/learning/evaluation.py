"""How well a policy does: many episodes at once, the same figures for the same seed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.people.populations import transferred_people
from avrgym.policies import registry
from avrgym.safety.region_forces import RegionLoadRecorder, RegionLoads, RegionStatistics, region_statistics
from avrgym.simulation.engines.engine import check_engine
from avrgym.system.engines import THREADS
from avrgym.system.jobs import cores, report, run_all
from avrgym.system.random_streams import TEST, Split, evaluation_episodes
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import find_environment

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

Progress = Callable[[int], None]

MAX_WORLDS = 64
WORTH_A_PROCESS = 16
"""How many episodes take longer than a process to start."""
QUANTILE = NormalDist().inv_cdf(0.975)
"""Outside plus and minus so many standard deviations lie 5 % of a normal distribution."""


class Results(NamedTuple):
    """Of n episodes: summed reward, success, mean force, what regions bore, interventions, draws of the start; (n,)."""

    reward: FloatArray
    success: BoolArray
    force_n: FloatArray
    loads: RegionLoads
    interventions: IntArray
    draws: IntArray
    device: str


@dataclass(frozen=True)
class Evaluation:
    """The figures of one policy in one environment; force is the mean over all steps.

    No choice is made with episodes of the ``split`` test.
    ``force_regions`` are the forces by region of the body, ``episodes_over_limit`` counts the episodes in which any
    region bore more than its limits allow, see ``RegionLoads``. ``guard_interventions`` is how often a force guard
    acted, per episode; ``None`` without one. ``engine`` and ``device`` say where physics ran. ``plugin_differences``:
    the plug-ins that are not what the policy was trained with. ``start_draws_mean`` and ``start_draws_max``: how often
    a start was drawn until all had room. ``starts_refused``: how many draws had none; as many people were left out.
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
    plugin_differences: list[str]
    start_draws_mean: float
    start_draws_max: int
    starts_refused: int


@dataclass(frozen=True)
class _Batch:
    """Episodes of one environment that run together; numbers of ``episodes`` count from 0."""

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


def evaluate(
    environment_id: str,
    policy: str,
    people: str,
    episodes: int,
    seed: int,
    progress: Progress = lambda steps: None,
    *,
    impairment: str = "none",
    split: Split = TEST,
    force_guard: bool = False,
    engine: str = THREADS,
) -> Evaluation:
    """Evaluate in one environment and this process; see ``evaluate_all``."""
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
    )
    return row


def evaluate_all(
    environment_ids: Sequence[str],
    policy: str,
    people: str,
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
) -> list[Evaluation]:
    """Run episodes of 200 steps in each environment, and sum them up.

    Args:
        environment_ids: such as ``avrgym/FeedingJaco-v1``.
        policy: whatever ``policies.registry.find`` finds, but ``operator``.
        people: whom to meet, a name in ``people.distributions.NAMED_DISTRIBUTIONS``, a file of people, a trained human
            or a folder of them.
        episodes: how many in each, 1 or more.
        seed: of the episodes; another seed gives other people and starts.
        progress: told again and again how many environment steps were made since it was told last.
        impairment: a name in ``people.impairments.IMPAIRMENTS``.
        split: episodes of the test or the validation split, see ``random_streams``.
        jobs: how many processes share the work and the cores; without it one for each core that has enough to do,
            and one alone for a device.
            It changes no figure.
        cluster: whose workers share the work instead of processes here. It changes no figure.
        allow_other_environment: whether to run a policy that was trained for another environment.
        force_guard: whether a ``ForceGuard`` stands between policy and arm.
        withdraw_after_success: as of ``Episodes``.
        engine: where physics runs. What is reported of a policy is measured on threads.

    Raises:
        ValueError: for an unknown name, a policy that cannot run there or fewer than one episode, naming what is
            allowed.
        ControllerError: when somebody else's controller fails.
    """
    if episodes < 1:
        raise ValueError(f"{episodes} episodes; at least 1 is needed")
    changed: list[list[str]] = []
    for environment_id in environment_ids:
        find_environment(environment_id)
        found = registry.find(policy, environment_id, allow_other_environment=allow_other_environment)
        changed.append(registry.changed_since_training(found, environment_id))
    check_engine(engine)
    every = len(environment_ids) * episodes
    there = cores() if cluster is None else cluster.count
    jobs = jobs or (min(there, max(1, every // WORTH_A_PROCESS)) if engine == THREADS else 1)
    size = min(MAX_WORLDS, -(-every // jobs))
    threads = max(1, there // jobs) if cluster is None else 1
    parts = _parts(episodes, size)
    driver, whom = TransferredFile.read(policy), transferred_people(people)
    batches = [
        _Batch(
            environment_id=environment_id,
            policy=driver,
            people=whom,
            impairment=impairment,
            split=split,
            seed=seed,
            episodes=numbers,
            threads=threads,
            allow_other_environment=allow_other_environment,
            force_guard=force_guard,
            withdraw_after_success=withdraw_after_success,
            engine=engine,
        )
        for environment_id in environment_ids
        for numbers in parts
    ]
    results = _run_batches(batches, jobs, cluster, progress)
    firsts = range(0, len(batches), len(parts))
    return [
        _sum_up(batches[first], results[first : first + len(parts)], differing)
        for first, differing in zip(firsts, changed, strict=True)
    ]


def _parts(episodes: int, size: int) -> list[range]:
    """Batches of at most that size, as equal as can be, so that no process waits long for another."""
    count = -(-episodes // size)
    bounds = [number * episodes // count for number in range(count + 1)]
    return [range(*bound) for bound in pairwise(bounds)]


def _run_batches(
    batches: list[_Batch], jobs: int, cluster: "Cluster | None", progress: Progress
) -> list[Results]:
    """The results of each batch, in their order."""
    if cluster is None and (jobs == 1 or len(batches) == 1):
        return [_run_batch(batch, progress) for batch in batches]
    told = 0

    def tell(done: int) -> None:
        nonlocal told
        progress(done - told)
        told = done

    arguments = [(batch, report) for batch in batches]
    if cluster is not None:
        return cluster.run_all(_run_batch, arguments, tell)
    return run_all(_run_batch, arguments, jobs, tell)


def _run_batch(batch: _Batch, progress: Progress) -> Results:
    world = Episodes(
        batch.environment_id,
        len(batch.episodes),
        distribution=batch.people.local_path(),
        impairment=batch.impairment,
        num_threads=batch.threads,
        by_region=True,
        engine=batch.engine,
        withdraw_after_success=batch.withdraw_after_success,
        force_guard=batch.force_guard,
    )
    generators = evaluation_episodes(batch.split, batch.seed, batch.episodes)
    return _run(world, batch, generators, progress)


def _sum_up(batch: _Batch, results: list[Results], changed: list[str]) -> Evaluation:
    """The figures of one environment from those of its batches."""
    reward, success, force, interventions, draws = (
        np.concatenate([getattr(part, name) for part in results])
        for name in ("reward", "success", "force_n", "interventions", "draws")
    )
    loads = RegionLoads.joined([part.loads for part in results])
    return Evaluation(
        env=batch.environment_id,
        policy=batch.policy.name,
        people=batch.people.name,
        impairment=batch.impairment,
        split=batch.split,
        episodes=len(reward),
        reward_mean=float(reward.mean()),
        reward_std=float(reward.std()),
        success_rate=float(success.mean()),
        success_ci95=wilson_interval(int(success.sum()), len(success)),
        force_mean_newton=float(force.mean()),
        episodes_over_limit=int(loads.over_limit.any(axis=-1).sum()),
        guard_interventions=float(interventions.mean()) if batch.force_guard else None,
        engine=batch.engine.partition(":")[0],
        device=results[0].device,
        force_regions=region_statistics(loads),
        plugin_differences=changed,
        start_draws_mean=float(draws.mean()),
        start_draws_max=int(draws.max()),
        starts_refused=int((draws - 1).sum()),
    )


def wilson_interval(successes: float, count: float, quantile: float = QUANTILE) -> tuple[float, float]:
    """The score interval of a proportion, at 95 % (Wilson, J. Am. Stat. Assoc. 22, 1927, p. 209).

    ``count`` may be an effective sample size; ``quantile`` is the standard normal one, or Student's.
    """
    share, z_squared_by_count = successes / count, quantile**2 / count
    middle = share + z_squared_by_count / 2.0
    half = (z_squared_by_count * (share * (1.0 - share) + z_squared_by_count / 4.0)) ** 0.5
    low, high = ((middle + sign * half) / (1.0 + z_squared_by_count) for sign in (-1.0, 1.0))
    return (low if successes > 0 else 0.0), (high if successes < count else 1.0)


def _run(
    world: Episodes, batch: _Batch, generators: list[np.random.Generator], progress: Progress
) -> Results:
    """One batch of episodes."""
    count = len(generators)
    allowed = batch.allow_other_environment
    found = registry.find(batch.policy.local_path(), world.environment_id, allow_other_environment=allowed)
    observation = world.begin(np.arange(count), generators)
    draws = world.draws.astype(np.intp)
    reward, force, success = np.zeros(count), np.zeros(count), np.zeros(count, dtype=bool)
    recorder = RegionLoadRecorder(count)
    with registry.acting(found, world, generators) as act:
        for _ in range(EPISODE_STEPS):
            step = world.step(act(observation).astype(float), recorder)
            observation, success = step.observation, step.success
            reward += step.reward
            force += step.force_on_person_n / EPISODE_STEPS
            progress(count)
    guard = world.loop.guard
    interventions = np.zeros(count, dtype=np.intp) if guard is None else guard.interventions
    device = world.simulation.engine.device
    return Results(reward, success, force, recorder.loads(), interventions, draws, device)
