"""Families of tests: what asks one question with one unit is corrected together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from avrgym.analysis.rows import TestedRow
from avrgym.analysis.statistics.tests import Comparison, holm

TRIAL, PARTICIPANT = "trial", "participant"
"""What one value of a test is of. Trials of one participant are not independent: p by trial is for comparison with the
paper alone, and gets no stars."""
LEAST_PARTICIPANTS = 4
"""With fewer participants nothing is tested or modelled: their differences cannot be estimated."""
TOO_FEW = f"fewer than {LEAST_PARTICIPANTS} participants"
Sample = tuple[str, Sequence[float]]
"""A group's name and its values."""


@dataclass(frozen=True)
class Question:
    """The question of a family of tests, and the caption of its table in the report.

    ``primary``: without a plan its tests by participant are primary results.
    """

    name: str
    table: str
    primary: bool = False

    def by(self, unit: str) -> str:
        """The name of its family whose values each stand for a ``unit``."""
        return f"{self.name}, by {unit}"


@dataclass(frozen=True)
class Compared:
    """The result of a comparison of a quantity between two groups of values of some ``participants``.

    ``differences`` are those of a paired test by participant; other tests have none.
    """

    quantity: str
    a: Sample
    b: Sample
    found: Comparison
    participants: int
    differences: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True)
class Family:
    """The rows of tests that were corrected together, each with its differences by participant."""

    simulated: bool
    question: Question
    rows: tuple[TestedRow, ...]
    differences: tuple[Mapping[str, float], ...]


def corrected(simulated: bool, question: Question, unit: str, tests: Sequence[Compared]) -> Family:
    """A family: all tests of a question with a unit, by people or by simulated participants, corrected by Holm."""
    allowed = [_with_enough(test) for test in tests]
    adjusted = holm([test.found.p for test in allowed])
    name = question.by(unit)
    rows = [_row(simulated, name, unit, test, p) for test, p in zip(allowed, adjusted, strict=True)]
    return Family(simulated, question, tuple(rows), tuple(test.differences for test in allowed))


def _with_enough(test: Compared) -> Compared:
    """The test, or of too few participants its groups and effect alone."""
    if test.participants >= LEAST_PARTICIPANTS:
        return test
    found = test.found
    note = TOO_FEW if found.p is not None else found.note
    described = Comparison(found.test, found.n, found.zeros, effect=found.effect, note=note)
    return replace(test, found=described)


def _row(simulated: bool, family: str, unit: str, test: Compared, p_holm: float | None) -> TestedRow:
    found = test.found
    return TestedRow(
        simulated=simulated,
        family=family,
        quantity=test.quantity,
        unit=unit,
        group_a=test.a[0],
        group_b=test.b[0],
        test=found.test,
        n_a=len(test.a[1]),
        n_b=len(test.b[1]),
        n=found.n,
        zeros=found.zeros,
        median_a=_median(test.a[1]),
        median_b=_median(test.b[1]),
        statistic=found.statistic,
        method=found.method,
        p=found.p,
        p_holm=p_holm,
        effect=found.effect,
        effect_low=found.effect_low if unit == PARTICIPANT else None,
        effect_high=found.effect_high if unit == PARTICIPANT else None,
        note=found.note,
    )


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) and np.ndim(values) == 1 else None
