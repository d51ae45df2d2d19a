"""Statistical power of the tests of a study, estimated from simulated studies.

The simulated studies are analysed with the same tests as real studies.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from avrgym.analysis.answers.trial_answers import make_midpoint_question, make_policy_comparison_question
from avrgym.analysis.models.effects import POLICY_EFFECT, Effect, TrialValue
from avrgym.analysis.models.estimate import EffectEstimate
from avrgym.analysis.models.fitting import estimate_effects
from avrgym.analysis.models.regression_models import list_model_groups
from avrgym.analysis.power.simulated_studies import (
    REFERENCE_SCALE_POINTS,
    PowerAssumptions,
    SimulatedAnswers,
    SimulatedStudies,
    compute_scale_midpoint,
)
from avrgym.analysis.statistics.comparisons import MEAN_DECIMALS, MIN_PARTICIPANTS, PARTICIPANT_UNIT
from avrgym.analysis.statistics.rank_tests import run_signed_rank_test
from avrgym.analysis.statistics.sign_flips import compute_sign_flip_p_values
from avrgym.array_types import FloatArray
from avrgym.learning.evaluation import compute_wilson_interval
from avrgym.questionnaires.questionnaire import Questionnaire
from avrgym.study.design.allocation import make_trial_orders
from avrgym.study.design.counterbalancing import TrialOrder
from avrgym.study.design.design import Design
from avrgym.system.parallel_calls import report_progress, starmap

ALPHA = 0.05
TARGET_POWERS = (0.8, 0.9)
STUDIES_PER_JOB = 100
"""Number of simulated studies in one job of a parallel process."""
_STEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16)
_LEAST_STEP = 4
PValueOrNone = float | None
PValuesByTest = Mapping[tuple[str, str], tuple[PValueOrNone, PValueOrNone]]
"""(p value, p value corrected over all primary results), by (test, measure). ``None``: no test was possible."""


@dataclass(frozen=True)
class PowerRow:
    """Statistical power of one test of ``measure``.

    ``effect``: simulated effect size in points of a seven-point scale. ``participants``: number of participants that
    complete each study. ``simulations``: number of simulated studies. ``power``: share of studies with a p value below
    0.05. ``corrected_power``: share of studies with a p value below 0.05 after correction over all primary results. The
    bounds are Wilson's 95 % confidence intervals. The p values of models are not corrected, because models are
    sensitivity analyses.
    """

    effect: float
    test: str
    measure: str
    participants: int
    simulations: int
    power: float
    power_low: float
    power_high: float
    corrected_power: float
    corrected_power_low: float
    corrected_power_high: float


def choose_default_sample_sizes(design: Design) -> tuple[int, ...]:
    """Returns the default sample sizes: multiples of the number of trial orders, and the planned number."""
    orders = len(make_trial_orders(design))
    step = orders * -(-_LEAST_STEP // orders)
    return tuple(sorted({design.participants, *(step * count for count in _STEPS)}))


def simulate_power(
    design: Design,
    assumptions: PowerAssumptions,
    effects: Sequence[float],
    sizes: Sequence[int],
    simulations: int,
    seed: int,
    jobs: int,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> list[PowerRow]:
    """Returns the estimated power of the primary tests, and of the model of the first item.

    There is a row for each effect size, number of participants and test. Studies without an effect are also simulated,
    with the planned number of participants.

    Args:
        design: the study design. Answers to its first questionnaire after trials are simulated.
        assumptions: the assumed variation of answers.
        effects: effect sizes, in points of a seven-point scale.
        sizes: simulated sample sizes: numbers of participants that complete a study.
        simulations: number of simulated studies for each effect and size.
        seed: the random seed. Results with the same seed are the same for any number of jobs.
        jobs: number of parallel processes.
        progress: called with the number of finished studies and the total number of studies.

    Raises:
        ValueError: if the design has no items after trials, or an effect is out of range.
    """
    for effect in effects:
        if not 0 < effect < REFERENCE_SCALE_POINTS:
            raise ValueError(
                f"effect size is {effect:g} points; allowed: more than 0, less than {REFERENCE_SCALE_POINTS}"
            )
    SimulatedStudies(design, assumptions, seed)
    wanted = [(0.0, design.participants), *product(effects, sizes)]
    chunks = [
        range(begin, min(begin + STUDIES_PER_JOB, simulations))
        for begin in range(0, simulations, STUDIES_PER_JOB)
    ]
    arguments = [(design, assumptions, *each, seed, chunk) for each in wanted for chunk in chunks]
    total = simulations * len(wanted)
    found = starmap(_count_and_report, arguments, jobs, lambda done: progress(done, total))
    rows: list[PowerRow] = []
    for index, (effect, participants) in enumerate(wanted):
        own = found[index * len(chunks) : (index + 1) * len(chunks)]
        rows += make_power_rows(own, effect, participants, simulations)
    return rows


SignificantStudyCounts = Mapping[tuple[str, str], tuple[int, int]]
"""(number of studies with a p value below 0.05, number with a corrected p value below 0.05), by (test, measure)."""


def make_power_rows(
    counts: Sequence[SignificantStudyCounts], effect: float, participants: int, simulations: int
) -> list[PowerRow]:
    """Returns the power of each test for one effect and one number of participants. ``counts``: one for each job."""
    rows: list[PowerRow] = []
    for test, measure in counts[0]:
        plain, corrected = np.sum([each[test, measure] for each in counts], axis=0).tolist()
        rows.append(
            PowerRow(
                effect, test, measure, participants, simulations,
                plain / simulations, *compute_wilson_interval(plain, simulations),
                corrected / simulations, *compute_wilson_interval(corrected, simulations),
            )
        )  # fmt: skip
    return rows


def _count_and_report(
    design: Design, assumptions: PowerAssumptions, effect: float, participants: int, seed: int, numbers: range
) -> SignificantStudyCounts:
    counts = count_significant_studies(design, assumptions, effect, participants, seed, numbers)
    report_progress(len(numbers))
    return counts


def count_significant_studies(
    design: Design, assumptions: PowerAssumptions, effect: float, participants: int, seed: int, numbers: range
) -> SignificantStudyCounts:
    """Returns the number of studies with a significant result, by test. ``numbers``: indices of the simulated
    studies.
    """
    studies = SimulatedStudies(design, assumptions, seed)
    first = studies.questionnaire.items[0].id
    found: dict[tuple[str, str], tuple[int, int]] = {}
    for number in numbers:
        answers = studies.simulate_answers(effect, participants, number)
        objective = studies.simulate_objective_measures(participants, number)
        judged = dict(compute_primary_p_values(design, studies.questionnaire, answers, objective))
        if len(design.policies) > 1:
            family, p = compute_model_p_value(
                design, answers, studies.simulate_trial_orders(participants, number)
            )
            judged[family, first] = p, p
        for test, (p, p_corrected) in judged.items():
            plain, corrected = found.get(test, (0, 0))
            found[test] = plain + _is_significant(p), corrected + _is_significant(p_corrected)
    return found


def _is_significant(p: PValueOrNone) -> bool:
    return p is not None and p < ALPHA


def compute_primary_p_values(
    design: Design, questionnaire: Questionnaire, answers: SimulatedAnswers, objective: FloatArray
) -> PValuesByTest:
    """Returns p value and corrected p value of each reported test, by the methods of the analysis.

    The reported tests compare answers to the first item with the last policy against the midpoint. They also compare
    the answers to each item between the last and the first policy. ``objective`` (participants, policies, measures):
    values of the objective measures. They only affect the correction.
    """
    exact: FloatArray = answers.mean(axis=(1, 2))
    means = np.round(exact, MEAN_DECIMALS)
    tests = list(_primary(design, questionnaire, means, objective))
    if len(means) < MIN_PARTICIPANTS:
        return {name: (None, None) for name, _ in tests if name}
    found = [run_signed_rank_test(differences).p for _, differences in tests]
    people = [dict(zip(map(str, range(len(means))), each.tolist(), strict=True)) for _, each in tests]
    joint = compute_sign_flip_p_values(people)
    return {
        name: (p, None if p is None or together is None else max(p, together))
        for (name, _), p, together in zip(tests, found, joint, strict=True)
        if name
    }


PrimaryTestDifferences = tuple[tuple[str, str] | None, FloatArray]
"""((test, measure), difference of each participant) of a primary test. ``None``: the power is not reported."""


def _primary(
    design: Design,
    questionnaire: Questionnaire,
    means: FloatArray,
    objective: FloatArray,
) -> Iterator[PrimaryTestDifferences]:
    """Yields the primary tests of a simulated study. ``means``: mean answers (participants, policies, items)."""
    items, last = [item.id for item in questionnaire.items], len(design.policies) - 1
    neutral = compute_scale_midpoint(questionnaire.items[0])
    for policy in range(len(design.policies)):
        name = (
            (make_midpoint_question(questionnaire).make_family_name(PARTICIPANT_UNIT), items[0])
            if policy == last
            else None
        )
        yield name, means[:, policy, 0] - neutral
    family = make_policy_comparison_question(design, questionnaire).make_family_name(PARTICIPANT_UNIT)
    for first, second in combinations(range(len(design.policies)), 2):
        apart = np.round(means[:, second] - means[:, first], MEAN_DECIMALS)
        for place, item in enumerate(items):
            yield ((family, item) if (first, second) == (0, last) else None), apart[:, place]
        for each in (objective[:, second] - objective[:, first]).T:
            yield None, each


def find_required_participants(
    rows: Sequence[PowerRow], effect: float, test: str, measure: str, target_power: float
) -> int | None:
    """Returns the smallest sufficient sample size; ``None`` if no simulated sample size is sufficient.

    For this and all larger simulated sample sizes, the corrected power is at least ``target_power``.
    """
    own = sorted(
        (row for row in rows if (row.effect, row.test, row.measure) == (effect, test, measure)),
        key=lambda row: row.participants,
    )
    reached: int | None = None
    for row in reversed(own):
        if row.corrected_power < target_power:
            break
        reached = row.participants
    return reached


def compute_model_p_value(
    design: Design, answers: SimulatedAnswers, orders: Sequence[TrialOrder]
) -> tuple[str, float | None]:
    """Fit the model of the first item after trials, and test the last policy against the first policy.

    Returns:
        The name of the test family, and the p value: ``None`` if the model cannot be estimated from the answers.
    """
    source = next(list_model_groups(design))
    model = next(iter(source.model_kind_by_quantity.values()))
    wanted = Effect(POLICY_EFFECT, design.policies[-1], design.policies[0])
    found = estimate_effects(
        design, model, order_trial_values(design, answers[..., 0].astype(float), orders), [wanted]
    )
    estimate = found[wanted]
    return source.make_family_name(POLICY_EFFECT), estimate.p if isinstance(
        estimate, EffectEstimate
    ) else None


def order_trial_values(design: Design, values: FloatArray, orders: Sequence[TrialOrder]) -> list[TrialValue]:
    """Returns a ``TrialValue`` for each trial, in the trial order of each participant.

    ``values`` (participants, tasks, robots, policies): value of each trial.
    """
    return [
        observed
        for number, (own, order) in enumerate(zip(values, orders, strict=True), start=1)
        for observed in _course(design, order, f"sub-{number:03}", own)
    ]


def _course(design: Design, order: TrialOrder, who: str, own: FloatArray) -> Iterator[TrialValue]:
    blocks, places = max(len(design.tasks) - 1, 1), max(len(design.robot_policy_pairs) - 1, 1)
    for block, part in enumerate(order):
        before = design.practice_policy or None
        for place, index in enumerate(part.condition_indices):
            robot, policy = design.robot_policy_pairs[index]
            value = own[part.task_index].reshape(-1)[index]
            task = design.tasks[part.task_index]
            yield TrialValue(who, task, robot, policy, block / blocks, place / places, before, float(value))
            before = policy
