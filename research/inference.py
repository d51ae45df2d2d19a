"""Error rates of a study's analysis: the tables of docs/explanation/statistics.md.

    python research/inference.py TABLE

TABLE is one of stars, success, effects or mixed. Each takes a few minutes of one core.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from avrgym.analysis.answers.trial_answers import compute_answer_test_families
from avrgym.analysis.models.effects import (
    POLICY_EFFECT,
    TrialValue,
    list_effects_of_interest,
    make_design_matrix,
)
from avrgym.analysis.models.estimate import ModelFitError
from avrgym.analysis.models.fitting import make_random_effect_labels
from avrgym.analysis.models.mixed_models import MixedModelFit, fit_mixed_model
from avrgym.analysis.outcomes.condition_outcomes import compute_outcome_test_families
from avrgym.analysis.power.simulated_studies import PowerAssumptions, SimulatedAnswers, SimulatedStudies
from avrgym.analysis.primary_results import assign_result_roles
from avrgym.analysis.reading.table_rows import AnswerRow, TrialRow
from avrgym.analysis.statistics.comparisons import PARTICIPANT_UNIT, TRIAL_UNIT, ComparisonRow
from avrgym.analysis.statistics.rank_tests import (
    compute_clustered_wilson_interval,
    format_significance_stars,
    run_signed_rank_test,
)
from avrgym.array_types import FloatArray
from avrgym.learning.evaluation import compute_wilson_interval
from avrgym.study.design.design import Design, parse_design, read_default_design_text
from avrgym.study.plan.analysis_plan import AnalysisPlan, ExclusionRules, Hypothesis
from papers_results import row

DESIGN = parse_design(read_default_design_text())
STUDIES = 1000


# Studies


def imagined(
    design: Design,
    studies: SimulatedStudies,
    effect: float,
    people: int,
    number: int,
    plan: AnalysisPlan | None = None,
) -> list[ComparisonRow]:
    """All tests of a study in which the last policy is rated ``effect`` points better, as the report has them."""
    answers = studies.simulate_answers(effect, people, number)
    families = [
        *compute_outcome_test_families(design, list(_trials(design, people, number))),
        *compute_answer_test_families(design, list(_answers(design, studies, answers))),
    ]
    return [each for family in assign_result_roles(families, [], plan).families for each in family.rows]


def _conditions(design: Design, people: int) -> Iterator[tuple[int, int, int, int]]:
    return product(
        range(people), *(map(range, (len(design.tasks), len(design.robots), len(design.policies))))
    )


def _answers(design: Design, studies: SimulatedStudies, answers: SimulatedAnswers) -> Iterator[AnswerRow]:
    items = studies.questionnaire.items
    for person, task, robot, policy in _conditions(design, len(answers)):
        for place, item in enumerate(items):
            yield AnswerRow(
                participant=f"sub-{person:03}", simulated=True, counted=True, session=1, moment="after_trial",
                questionnaire=studies.questionnaire.name, position=1, task=design.tasks[task],
                robot=design.robots[robot], policy=design.policies[policy], attempt=1, item=item.id,
                value=int(answers[person, task, robot, policy, place]), minimum=1, maximum=item.points,
                points=item.points, response_time_s=1.0, respondent="participant",
            )  # fmt: skip


def _trials(design: Design, people: int, number: int) -> Iterator[TrialRow]:
    """Trials without any effect of policies; participants differ in general and in their response to policies."""
    latent = _latent(design, people, np.random.default_rng([number, 3]), 3)
    for person, task, robot, policy in _conditions(design, people):
        ability, gain, load = latent[:, person, task, robot, policy]
        yield TrialRow(
            participant=f"sub-{person:03}", simulated=True, participant_state="completed", sex="woman", position=1,
            practice=False, task=design.tasks[task], robot=design.robots[robot], policy=design.policies[policy],
            seed=0, state="completed", attempts=1, attempts_not_completed=0, counted=True, success=bool(ability > -1.0),
            reward=20.0 * float(gain), force_mean_n=float(np.exp(0.5 * load)),
        )  # fmt: skip


def _latent(design: Design, people: int, rng: np.random.Generator, measures: int) -> FloatArray:
    """(measures, people, tasks, robots, policies)."""
    shape = (measures, people, len(design.tasks), len(design.robots), len(design.policies))
    values = rng.standard_normal(shape) + rng.standard_normal((measures, 1, shape[2], 1, 1))
    values = values + rng.standard_normal((measures, people, 1, 1, 1))
    return values + 0.5 * rng.standard_normal((measures, people, 1, 1, shape[4]))


# Stars


Finds = Callable[[Sequence[ComparisonRow]], bool]


def any_star(rows: Sequence[ComparisonRow]) -> bool:
    """Whether figures, headline tables or ``tests.csv`` have any star."""
    return any(each.stars for each in rows)


def _by_holm(unit: str, families: str, quantity: str = "") -> Finds:
    def finds(rows: Sequence[ComparisonRow]) -> bool:
        return any(
            format_significance_stars(each.p_holm)
            for each in rows
            if each.unit == unit and families in each.family and quantity in each.quantity
        )

    return finds


def _first(rows: Sequence[ComparisonRow]) -> bool:
    return any(each.stars for each in rows if each.family == FAMILY and each.quantity == "L1")


ANY: Mapping[str, Finds] = {
    "primary results, corrected jointly: any star in figures and headline tables": any_star,
    "the same tests, Holm within each of the three families": _by_holm(PARTICIPANT_UNIT, ""),
    "policies by participant, Holm within four answers": _by_holm(PARTICIPANT_UNIT, "policies, by"),
    "policies by trial, Holm within four answers": _by_holm(TRIAL_UNIT, "policies, by"),
}
OF_FIRST: Mapping[str, Finds] = {
    "L1 between policies, corrected jointly over nine primary results": _first,
    "L1 between policies, Holm within four answers": _by_holm(PARTICIPANT_UNIT, "policies, by", "L1"),
}
WITH_PLAN: Mapping[str, Finds] = {
    "L1 between policies, corrected jointly over the four answers of a plan": _first,
}
FAMILY = f"policies, by {PARTICIPANT_UNIT}"
PLAN = AnalysisPlan(
    participants=8,
    exclusion=ExclusionRules(0.5),
    hypotheses=(Hypothesis("H1", "Policies differ.", ("L1", "L2", "L3", "L4"), (FAMILY,)),),
)


def stars() -> Iterator[str]:
    """The share of studies with any star: without an effect, then with an effect of 1 point in answers."""
    for effect, people, plan, procedures in (
        (0.0, 8, None, ANY),
        (0.0, 16, None, ANY),
        (1.0, 8, None, OF_FIRST),
        (1.0, 8, PLAN, WITH_PLAN),
        (1.0, 12, None, OF_FIRST),
        (1.0, 12, PLAN, WITH_PLAN),
    ):
        studies = SimulatedStudies(DESIGN, PowerAssumptions(), 1)
        found = [imagined(DESIGN, studies, effect, people, number, plan) for number in range(STUDIES)]
        for name, finds in procedures.items():
            yield row(f"{effect:g}", people, name, share(sum(map(finds, found)), STUDIES))


def share(hits: int, studies: int) -> str:
    """A share in percent with its Monte-Carlo interval."""
    low, high = (100.0 * end for end in compute_wilson_interval(hits, studies))
    return f"{100.0 * hits / studies:.1f} ({low:.1f} to {high:.1f})"


# Intervals


def success() -> Iterator[str]:
    """Coverage of the interval of success over all tasks: 8 participants, 4 trials each, half of which succeed."""
    for spread in (0.0, 1.0, 2.0):
        rng = np.random.default_rng([int(spread), 1])
        people = rng.normal(0.0, spread, (20 * STUDIES, 8, 1))
        given = rng.random((20 * STUDIES, 8, 4)) < 1.0 / (1.0 + np.exp(-people))
        clustered = np.array([compute_clustered_wilson_interval(each) for each in given.tolist()], float)
        plain = np.array([compute_wilson_interval(each, 32) for each in given.sum(axis=(1, 2)).tolist()])
        yield row(f"{spread:g}", *(f"{100.0 * _covers(ends, 0.5):.1f}" for ends in (clustered, plain)))


def _covers(ends: FloatArray, value: float) -> float:
    return float(((ends[:, 0] <= value + 1e-12) & (ends[:, 1] >= value - 1e-12)).mean())


SHIFTS = (0.0, 0.3, 0.8, 1.5)
"""Mean differences in standard deviations."""


def effect_sizes() -> Iterator[str]:
    """Coverage of the interval of the rank-biserial correlation of normal differences, in means of eight answers."""
    for people in (4, 6, 8, 16, 32):
        rng = np.random.default_rng(people)
        cells: list[str] = []
        for shift in SHIFTS:
            truth = np.mean(
                [run_signed_rank_test(each).effect_size for each in _differences(rng, shift, (200, 600))]
            )
            found = [run_signed_rank_test(each) for each in _differences(rng, shift, (2 * STUDIES, people))]
            ends = np.array(
                [
                    (each.effect_size_low, each.effect_size_high)
                    for each in found
                    if each.effect_size is not None
                ]
            )
            cells.append(f"{100.0 * _covers(ends, float(truth)):.0f}")
        yield row(people, *cells)


def _differences(rng: np.random.Generator, shift: float, shape: tuple[int, int]) -> FloatArray:
    return np.round(8.0 * (shift + rng.standard_normal(shape))) / 8.0


# Mixed models


SPREADS = {
    "policy 0.5, robot 0.3, task 0.5": (1.0, 0.5, 0.3, 0.5),
    "policy 0.25, robot 0.15, task 0.25": (1.0, 0.25, 0.15, 0.25),
    "none": (1.0, 0.0, 0.0, 0.0),
}
"""Standard deviations between participants: in general, by policy, by robot and by task; single values: 1."""


def mixed() -> Iterator[str]:
    """False positives of mixed models with free variances, and with variances constrained to zero or above."""
    for name, spreads in SPREADS.items():
        found = [each for number in range(STUDIES) if (each := _both(spreads, number)) is not None]
        singular = [each for each in found if each[2]]
        own = [each for each in found if each[3]]
        cells = [_rates(each) for each in (found, singular, own)]
        yield row(name, *(f"{unbounded} / {bounded} of {count}" for unbounded, bounded, count in cells))


Both = tuple[bool, bool, bool, bool]


def _rates(found: Sequence[Both]) -> tuple[str, str, int]:
    rates = [100.0 * np.mean([each[place] for each in found]) for place in (0, 1)]
    return f"{rates[0]:.1f}", f"{rates[1]:.1f}", len(found)


def _both(spreads: Sequence[float], number: int) -> Both | None:
    """Whether policies differ in each fit, whether it is singular, and whether the variance of policies is zero."""
    observed = list(_observed(spreads, number))
    names = make_design_matrix(DESIGN, observed)
    matrix = np.hstack([np.ones((len(observed), 1)), names.matrix])
    (effect,) = (each for each in list_effects_of_interest(DESIGN) if each.kind == POLICY_EFFECT)
    contrast = np.concatenate([[0.0], names.make_contrast(effect)])
    together = make_random_effect_labels(observed)
    values, people = [each.value for each in observed], [each.participant for each in observed]

    def fit(kept: Sequence[str]) -> MixedModelFit:
        return fit_mixed_model(values, matrix, people, [together[each] for each in kept])

    try:
        unbounded = fit(list(together))
        bounded, kept = unbounded, list(together)
        while bounded.zero_variance_indices:
            kept.pop(int(np.argmin(bounded.variance_components[:-1])))
            bounded = fit(kept)
        p, held = unbounded.estimate(contrast).p, bounded.estimate(contrast).p
    except ModelFitError:
        return None
    zero_variances = [list(together)[place] for place in unbounded.zero_variance_indices]
    return p < 0.05, held < 0.05, bool(zero_variances), "participant by policy" in zero_variances


def _observed(spreads: Sequence[float], number: int) -> Iterator[TrialValue]:
    rng = np.random.default_rng([7, number])
    shape = (8, len(DESIGN.tasks), len(DESIGN.robots), len(DESIGN.policies))
    values = rng.standard_normal(shape)
    for axis, spread in zip((0, 3, 2, 1), spreads, strict=True):
        drawn = [size if along in (0, axis) else 1 for along, size in enumerate(shape)]
        values = values + spread * rng.standard_normal(drawn)
    for person, task, robot, policy in _conditions(DESIGN, shape[0]):
        block, place = rng.uniform(size=2)
        before = DESIGN.policies[int(rng.integers(len(DESIGN.policies)))]
        yield TrialValue(
            f"sub-{person:03}", DESIGN.tasks[task], DESIGN.robots[robot], DESIGN.policies[policy],
            float(block), float(place), before, float(values[person, task, robot, policy]),
        )  # fmt: skip


TABLES = {"stars": stars, "success": success, "effects": effect_sizes, "mixed": mixed}

if __name__ == "__main__":
    for line in TABLES[sys.argv[1]]():
        print(line, flush=True)
