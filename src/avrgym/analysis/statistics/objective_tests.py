"""Whether policies differ in success, reward and force, each participant one value."""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, product

from avrgym.analysis.rows import TrialRow
from avrgym.analysis.statistics.families import PARTICIPANT, Family, Question, corrected
from avrgym.analysis.statistics.subjective import Key, between_policies
from avrgym.study.design.design import Design

OBJECTIVE = Question(
    "policies, objective measures", table="Success, reward and force: tests of policies", primary=True
)


def _success(row: TrialRow) -> float | None:
    return None if row.success is None else float(row.success)


MEASURES: Mapping[str, Callable[[TrialRow], float | None]] = {
    "success": _success,
    "reward": lambda row: row.reward,
    "force_mean_n": lambda row: row.force_mean_n,
}
"""By quantity, its value in a trial."""


def offered_objective(design: Design) -> dict[str, tuple[str, ...]]:
    """The family of these tests by name, with its quantities; none with a single policy."""
    return {OBJECTIVE.by(PARTICIPANT): tuple(MEASURES)} if len(design.policies) > 1 else {}


def objective_families(design: Design, trials: Sequence[TrialRow]) -> list[Family]:
    """Wilcoxon's signed-rank tests between policies, paired within participant × task × robot."""
    if not offered_objective(design):
        return []
    counted = [row for row in trials if row.counted]
    return [
        _family(design, simulated, [row for row in counted if row.simulated is simulated])
        for simulated in sorted({row.simulated for row in counted})
    ]


def _family(design: Design, simulated: bool, trials: Sequence[TrialRow]) -> Family:
    tests = [
        between_policies(
            name, pair, (_values(trials, pair[0], measure), _values(trials, pair[1], measure)), PARTICIPANT
        )
        for pair, (name, measure) in product(combinations(design.policies, 2), MEASURES.items())
    ]
    return corrected(simulated, OBJECTIVE, PARTICIPANT, tests)


def _values(
    trials: Sequence[TrialRow], policy: str, measure: Callable[[TrialRow], float | None]
) -> dict[Key, float]:
    return {
        (row.participant, row.task, row.robot): value
        for row in trials
        if row.policy == policy and (value := measure(row)) is not None
    }
