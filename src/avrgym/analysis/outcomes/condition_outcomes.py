"""Reward and success of each condition in VR and in simulation, and tests between policies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, groupby, product
from statistics import fmean, stdev
from typing import Annotated

from avrgym.analysis.column_types import (
    AT_LEAST_0_TEXT,
    FRACTION_RANGE_TEXT,
    IsSimulated,
    PolicyName,
    RobotName,
    TaskName,
)
from avrgym.analysis.reading.table_rows import ALL_LABEL, TrialRow
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    AnalysisUnitKey,
    ComparisonFamily,
    ResearchQuestion,
    compare_policies,
    make_holm_corrected_family,
)
from avrgym.analysis.statistics.rank_tests import compute_clustered_wilson_interval, compute_t_interval
from avrgym.learning.evaluation import compute_wilson_interval
from avrgym.policies.trained_policies import (
    POLICY_FILE_SUFFIX,
    Policy,
    PolicyError,
    find_packaged_policies,
    find_policy_file,
)
from avrgym.study.design.design import Design
from avrgym.study.storage.store import StudyStore
from avrgym.system.columns import Column
from avrgym.tasks.constants import EPISODE_STEPS, make_environment_id

_EQUAL = "too few values, or all are equal"
_ONE_PARTICIPANT = "no trial, or several of one participant"
_NOT_SIMULATED = "the policy was not evaluated in simulation"
_NO_REWARDS = f"{_NOT_SIMULATED}, or all rewards are equal"


@dataclass(frozen=True, kw_only=True)
class ConditionOutcome:
    """Results of the analysed trials in one condition.

    The rewards of different tasks are not comparable. Results over all tasks therefore have no reward.
    """

    simulated: IsSimulated
    task: TaskName
    robot: RobotName
    policy: PolicyName
    trials: Annotated[int, Column("Number of analysed trials.", allowed=AT_LEAST_0_TEXT)]
    reward_mean: Annotated[float | None, Column("Mean reward.", empty="no trial, or all tasks together")]
    reward_low: Annotated[
        float | None, Column("Lower bound of its 95 % confidence interval (Student's t).", empty=_EQUAL)
    ]
    reward_high: Annotated[
        float | None, Column("Upper bound of its 95 % confidence interval (Student's t).", empty=_EQUAL)
    ]
    successes: Annotated[int, Column("Number of successful trials.", allowed=AT_LEAST_0_TEXT)]
    success_rate: Annotated[
        float | None, Column("Share of successful trials.", allowed=FRACTION_RANGE_TEXT, empty="no trial")
    ]
    success_low: Annotated[
        float | None,
        Column(
            "Lower bound of its 95 % confidence interval (Wilson).",
            allowed=FRACTION_RANGE_TEXT,
            empty=_ONE_PARTICIPANT,
        ),
    ]
    success_high: Annotated[
        float | None,
        Column(
            "Upper bound of its 95 % confidence interval (Wilson).",
            allowed=FRACTION_RANGE_TEXT,
            empty=_ONE_PARTICIPANT,
        ),
    ]


@dataclass(frozen=True, kw_only=True)
class SimulationResult:
    """Results of a policy in simulation, from the policy file. Missing results are ``None``."""

    simulation_population: Annotated[
        str | None, Column("Population of the evaluation.", empty=_NOT_SIMULATED)
    ] = None
    simulation_episodes: Annotated[
        int | None, Column("Number of episodes.", allowed=AT_LEAST_0_TEXT, empty=_NOT_SIMULATED)
    ] = None
    simulation_reward_mean: Annotated[
        float | None, Column("Mean reward in simulation.", empty=_NOT_SIMULATED)
    ] = None
    simulation_reward_low: Annotated[
        float | None, Column("Lower bound of its 95 % confidence interval.", empty=_NO_REWARDS)
    ] = None
    simulation_reward_high: Annotated[
        float | None, Column("Upper bound of its 95 % confidence interval.", empty=_NO_REWARDS)
    ] = None
    simulation_success_rate: Annotated[
        float | None,
        Column("Share of successful episodes.", allowed=FRACTION_RANGE_TEXT, empty=_NOT_SIMULATED),
    ] = None
    simulation_success_low: Annotated[
        float | None,
        Column(
            "Lower bound of its 95 % confidence interval.", allowed=FRACTION_RANGE_TEXT, empty=_NOT_SIMULATED
        ),
    ] = None
    simulation_success_high: Annotated[
        float | None,
        Column(
            "Upper bound of its 95 % confidence interval.", allowed=FRACTION_RANGE_TEXT, empty=_NOT_SIMULATED
        ),
    ] = None
    simulation_note: Annotated[
        str, Column("Why there is no evaluation, or how its conditions differ.", empty="no note")
    ] = ""


@dataclass(frozen=True, kw_only=True)
class ObjectiveOutcomeRow(SimulationResult, ConditionOutcome):
    """Results of the analysed trials in one condition, and results of the same policy in simulation."""


def make_objective_outcome_rows(store: StudyStore, trials: Sequence[TrialRow]) -> list[ObjectiveOutcomeRow]:
    """Returns a row for each condition, then a row over all tasks for each robot and policy.

    People and simulated participants have separate rows. Confidence intervals of rewards use Student's t over trials:
    each participant has one trial in a condition. Confidence intervals of success account for several trials of one
    participant.
    """
    design = store.design
    beside = {
        (task, robot, policy): read_simulation_result(store, make_environment_id(task, robot), policy)
        for task, robot, policy in product(design.tasks, design.robots, design.policies)
    }
    rows: list[ObjectiveOutcomeRow] = []
    for simulated in sorted({row.simulated for row in trials if row.counted}):
        own = [row for row in trials if row.counted and row.simulated is simulated]
        for (task, robot, policy), measured in beside.items():
            rows.append(_condition(own, simulated, task, robot, policy, measured))
        for robot, policy in product(design.robots, design.policies):
            by_task = [beside[task, robot, policy] for task in design.tasks]
            rows.append(_condition(own, simulated, ALL_LABEL, robot, policy, _over_tasks(by_task)))
    return rows


def _condition(
    trials: Sequence[TrialRow], simulated: bool, task: str, robot: str, policy: str, beside: SimulationResult
) -> ObjectiveOutcomeRow:
    return ObjectiveOutcomeRow(
        **asdict(compute_condition_outcome(trials, simulated, task, robot, policy)), **asdict(beside)
    )


def compute_condition_outcome(
    trials: Sequence[TrialRow], simulated: bool, task: str, robot: str, policy: str
) -> ConditionOutcome:
    """Returns the results of one condition. ``trials``: analysed trials. Task ``ALL_LABEL``: all tasks together."""
    own = [
        row for row in trials if task in (row.task, ALL_LABEL) and (row.robot, row.policy) == (robot, policy)
    ]
    rewards = [row.reward for row in own if row.reward is not None] if task != ALL_LABEL else []
    successes = sum(bool(row.success) for row in own)
    mean, low, high = compute_mean_with_interval(rewards)
    success_low, success_high = (
        compute_clustered_wilson_interval(_by_participant(own)) if own else (None, None)
    )
    return ConditionOutcome(
        simulated=simulated,
        task=task,
        robot=robot,
        policy=policy,
        trials=len(own),
        reward_mean=mean,
        reward_low=low,
        reward_high=high,
        successes=successes,
        success_rate=successes / len(own) if own else None,
        success_low=success_low,
        success_high=success_high,
    )


def _by_participant(trials: Sequence[TrialRow]) -> list[list[bool]]:
    """Returns a list for each participant, with the success of each trial."""
    ordered = sorted(trials, key=_participant_key)
    return [[bool(row.success) for row in own] for _, own in groupby(ordered, _participant_key)]


def _participant_key(row: TrialRow) -> tuple[bool, str, str]:
    return row.simulated, row.site or "", row.participant


def compute_mean_with_interval(values: Sequence[float]) -> tuple[float | None, float | None, float | None]:
    """Returns (mean, lower bound, upper bound) with the 95 % confidence interval of the mean by Student's t.

    Without values, all three are ``None``. For one value or equal values, both bounds are ``None``.
    """
    if not values:
        return None, None, None
    mean = fmean(values)
    return mean, *compute_t_interval(mean, stdev(values) if len(values) > 1 else 0.0, len(values))


def read_simulation_result(store: StudyStore, environment: str, policy: str) -> SimulationResult:
    """Returns the results of a policy in simulation, with its training population.

    The results are read from the policy file. They were stored there at the end of training.
    """
    try:
        source = store.find_policy_source(environment, policy)
        if not source.endswith(POLICY_FILE_SUFFIX) and source not in find_packaged_policies(environment):
            return SimulationResult(simulation_note=f"{policy} is not a policy file with results")
        metadata = Policy.load(find_policy_file(source, environment)).metadata
    except PolicyError as error:
        return SimulationResult(simulation_note=str(error))
    numbers = ("episodes", "success_rate", "reward_mean", "reward_std")
    if any(name not in metadata.measured for name in numbers):
        return SimulationResult(
            simulation_population=metadata.people, simulation_note="the policy file contains no results"
        )
    episodes, rate, mean, deviation = (float(metadata.measured[name]) for name in numbers)
    result = _as_measured(metadata.people, int(episodes), rate, mean, deviation, store.design.trial_steps)
    condition = store.design.conditions.get(policy)
    if condition is None or not condition.uses_pacing_layer:
        return result
    notes = filter(None, (result.simulation_note, "the episodes have no commands and no preferences"))
    return replace(result, simulation_note="; ".join(notes))


def _over_tasks(measured: Sequence[SimulationResult]) -> SimulationResult:
    """Returns the success rate over all tasks, without reward.

    If a task was not evaluated, the result contains only a note.
    """
    rates = [(each.simulation_success_rate, each.simulation_episodes) for each in measured]
    if any(rate is None or episodes is None for rate, episodes in rates):
        return SimulationResult(simulation_note="not every task was evaluated in simulation")
    episodes = sum(number or 0 for _, number in rates)
    successes = round(sum((rate or 0.0) * (number or 0) for rate, number in rates))
    low, high = compute_wilson_interval(successes, episodes)
    return SimulationResult(
        simulation_population=measured[0].simulation_population,
        simulation_episodes=episodes,
        simulation_success_rate=successes / episodes,
        simulation_success_low=low,
        simulation_success_high=high,
    )


def _as_measured(
    people: str, episodes: int, rate: float, mean: float, deviation: float, trial_steps: int
) -> SimulationResult:
    """Returns simulation results with confidence intervals. ``deviation``: standard deviation of the reward, with
    divisor ``episodes``."""
    sample_deviation = deviation * (episodes / max(episodes - 1, 1)) ** 0.5
    low, high = compute_t_interval(mean, sample_deviation, episodes)
    success_low, success_high = compute_wilson_interval(round(rate * episodes), episodes)
    other_length = f"episodes have {EPISODE_STEPS} steps, these trials {trial_steps}"
    return SimulationResult(
        simulation_population=people,
        simulation_episodes=episodes,
        simulation_reward_mean=mean,
        simulation_reward_low=low,
        simulation_reward_high=high,
        simulation_success_rate=rate,
        simulation_success_low=success_low,
        simulation_success_high=success_high,
        simulation_note="" if trial_steps == EPISODE_STEPS else other_length,
    )


OBJECTIVE_QUESTION = ResearchQuestion(
    "policies, objective measures",
    table_caption="Success, reward and force: tests of policies",
    is_primary=True,
)


def _success(row: TrialRow) -> float | None:
    return None if row.success is None else float(row.success)


OBJECTIVE_MEASURES: Mapping[str, Callable[[TrialRow], float | None]] = {
    "success": _success,
    "reward": lambda row: row.reward,
    "force_mean_n": lambda row: row.force_mean_n,
}
"""Function of each objective measure, by the measure's name. It returns the value of the measure in a trial."""


def list_outcome_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Returns the quantities by test family, for objective measures; empty for a design with one policy."""
    return (
        {OBJECTIVE_QUESTION.make_family_name(PARTICIPANT_UNIT): tuple(OBJECTIVE_MEASURES)}
        if len(design.policies) > 1
        else {}
    )


def compute_outcome_test_families(design: Design, trials: Sequence[TrialRow]) -> list[ComparisonFamily]:
    """Returns Wilcoxon signed-rank tests of objective measures between policies.

    A pair contains values of one participant with the same task and robot.
    """
    if not list_outcome_tests(design):
        return []
    counted = [row for row in trials if row.counted]
    return [
        _family(design, simulated, [row for row in counted if row.simulated is simulated])
        for simulated in sorted({row.simulated for row in counted})
    ]


def _family(design: Design, simulated: bool, trials: Sequence[TrialRow]) -> ComparisonFamily:
    tests = [
        compare_policies(
            name,
            pair,
            (_measure_values(trials, pair[0], measure), _measure_values(trials, pair[1], measure)),
            PARTICIPANT_UNIT,
        )
        for pair, (name, measure) in product(combinations(design.policies, 2), OBJECTIVE_MEASURES.items())
    ]
    return make_holm_corrected_family(simulated, OBJECTIVE_QUESTION, PARTICIPANT_UNIT, tests)


def _measure_values(
    trials: Sequence[TrialRow], policy: str, measure: Callable[[TrialRow], float | None]
) -> dict[AnalysisUnitKey, float]:
    return {
        (row.participant, row.task, row.robot): value
        for row in trials
        if row.policy == policy and (value := measure(row)) is not None
    }
