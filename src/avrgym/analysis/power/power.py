"""How often a study's tests find an effect that is there: whole studies, simulated and tested as the analysis does."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from avrgym.analysis.power.answers import POINTS, Answers, Assumptions, ImaginedStudies, middle
from avrgym.analysis.statistics.families import PARTICIPANT, TRIAL
from avrgym.analysis.statistics.subjective import DIGITS, middle_question, policies_question
from avrgym.analysis.statistics.tests import holm, signed_rank
from avrgym.learning.evaluation import wilson_interval
from avrgym.recording.questionnaire import Questionnaire
from avrgym.study.design.allocation import cell_orders
from avrgym.study.design.design import Design
from avrgym.system.jobs import report, run_all

ALPHA = 0.05
GOALS = (0.8, 0.9)
CHUNK = 100
"""How many studies a process simulates at a time."""
_STEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16)
_LEAST_STEP = 4
Probability = float | None
Probabilities = Mapping[str, tuple[Probability, Probability]]
"""By test: p, and p by Holm within its family."""


@dataclass(frozen=True)
class PowerRow:
    """In what share of simulated studies a test of ``measure`` found an ``effect``, in points of a seven-point scale.

    ``participants`` completed each study. ``power`` is the share with p below 0.05, ``power_holm`` that with p below
    0.05 after Holm's correction within the test's family; with Wilson's 95 % intervals.
    """

    effect: float
    test: str
    measure: str
    participants: int
    simulations: int
    power: float
    power_low: float
    power_high: float
    power_holm: float
    power_holm_low: float
    power_holm_high: float


def default_sizes(design: Design) -> tuple[int, ...]:
    """Numbers of participants to look at: whole rounds of the design's orders, and the number that is planned."""
    orders = len(cell_orders(design))
    step = orders * -(-_LEAST_STEP // orders)
    return tuple(sorted({design.participants, *(step * count for count in _STEPS)}))


def simulate_power(
    design: Design,
    assumptions: Assumptions,
    effects: Sequence[float],
    sizes: Sequence[int],
    simulations: int,
    seed: int,
    jobs: int,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> list[PowerRow]:
    """Power of the paper's tests for each effect and number of participants; without an effect for the planned number.

    Args:
        design: the study's; its first questionnaire that is asked after trials is simulated.
        assumptions: how answers differ but for the effect.
        effects: in points of a seven-point scale.
        sizes: how many participants complete a study.
        simulations: how many studies each share is taken from.
        seed: the same one gives the same figures, with any number of jobs.
        jobs: how many processes.
        progress: told again and again how many studies are done, and how many there are.

    Raises:
        ValueError: where the design asks nothing after trials, and for an effect that is none.
    """
    for effect in effects:
        if not 0 < effect < POINTS:
            raise ValueError(f"an effect of {effect:g} points; allowed: above 0, below {POINTS}")
    ImaginedStudies(design, assumptions, seed)
    wanted = [(0.0, design.participants), *product(effects, sizes)]
    chunks = [range(begin, min(begin + CHUNK, simulations)) for begin in range(0, simulations, CHUNK)]
    arguments = [(design, assumptions, *each, seed, chunk) for each in wanted for chunk in chunks]
    total = simulations * len(wanted)
    found = run_all(_count_and_report, arguments, jobs, lambda done: progress(done, total))
    rows: list[PowerRow] = []
    for index, (effect, participants) in enumerate(wanted):
        own = found[index * len(chunks) : (index + 1) * len(chunks)]
        rows += power_rows(own, effect, participants, simulations)
    return rows


Counts = Mapping[tuple[str, str], tuple[int, int]]
"""By test and measure, in how many studies p was below 0.05, and p by Holm."""


def power_rows(
    counts: Sequence[Counts], effect: float, participants: int, simulations: int
) -> list[PowerRow]:
    """The rows of one effect and number of participants, from what parts of the simulations counted."""
    rows: list[PowerRow] = []
    for test, measure in counts[0]:
        plain, corrected = np.sum([each[test, measure] for each in counts], axis=0).tolist()
        rows.append(
            PowerRow(
                effect, test, measure, participants, simulations,
                plain / simulations, *wilson_interval(plain, simulations),
                corrected / simulations, *wilson_interval(corrected, simulations),
            )
        )  # fmt: skip
    return rows


def _count_and_report(
    design: Design, assumptions: Assumptions, effect: float, participants: int, seed: int, numbers: range
) -> Counts:
    counts = count(design, assumptions, effect, participants, seed, numbers)
    report(len(numbers))
    return counts


def count(
    design: Design, assumptions: Assumptions, effect: float, participants: int, seed: int, numbers: range
) -> Counts:
    """In how many of the studies with these numbers each test finds something."""
    studies = ImaginedStudies(design, assumptions, seed)
    measure = studies.questionnaire.items[0].id
    found: dict[tuple[str, str], tuple[int, int]] = {}
    for number in numbers:
        answers = studies.answers(effect, participants, number)
        for test, (p, p_holm) in probabilities(design, studies.questionnaire, answers).items():
            plain, corrected = found.get((test, measure), (0, 0))
            found[test, measure] = plain + _finds(p), corrected + _finds(p_holm)
    return found


def _finds(p: Probability) -> bool:
    return p is not None and p < ALPHA


def probabilities(design: Design, questionnaire: Questionnaire, answers: Answers) -> Probabilities:
    """What the analysis finds for the first item: the last policy against the middle, and against the first policy."""
    found: dict[str, tuple[Probability, Probability]] = {}
    for unit in (TRIAL, PARTICIPANT):
        values = _values(answers, unit)
        neutral = middle(questionnaire.items[0])
        against = [values[..., policy, 0] - neutral for policy in range(len(design.policies))]
        found[middle_question(questionnaire).by(unit)] = _tested(against, -1)
        if len(design.policies) > 1:
            pairs = list(combinations(range(len(design.policies)), 2))
            primary = pairs.index((0, len(design.policies) - 1)) * len(questionnaire.items)
            between = list(_between(values, pairs))
            found[policies_question(design, questionnaire).by(unit)] = _tested(between, primary)
    return found


def _values(answers: Answers, unit: str) -> NDArray[np.float64]:
    """What each trial, or each participant in the mean, gives: (values, policies, items)."""
    if unit == TRIAL:
        return answers.reshape(-1, *answers.shape[3:]).astype(float)
    means: NDArray[np.float64] = answers.mean(axis=(1, 2))
    return np.round(means, DIGITS)


def _between(values: NDArray[np.float64], pairs: Sequence[tuple[int, int]]) -> Iterator[NDArray[np.float64]]:
    """Differences between policies, item by item for each pair."""
    for (first, second), item in product(pairs, range(values.shape[-1])):
        yield np.round(values[:, second, item] - values[:, first, item], DIGITS)


def _tested(family: Sequence[NDArray[np.float64]], primary: int) -> tuple[Probability, Probability]:
    """p of one test of a family, and p by Holm."""
    found = [signed_rank(differences).p for differences in family]
    return found[primary], holm(found)[primary]


def needed(rows: Sequence[PowerRow], effect: float, test: str, goal: float) -> int | None:
    """The least number of participants from which on a test, corrected, finds an effect with such a share; ``None``
    where none that was simulated does."""
    own = sorted(
        (row for row in rows if (row.effect, row.test) == (effect, test)), key=lambda row: row.participants
    )
    reached: int | None = None
    for row in reversed(own):
        if row.power_holm < goal:
            break
        reached = row.participants
    return reached
