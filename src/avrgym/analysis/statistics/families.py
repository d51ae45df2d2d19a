"""Families of tests: what asks one question with one unit is corrected together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrgym.analysis.rows import TestedRow
from avrgym.analysis.statistics.tests import Comparison, holm, mark

TRIAL, PARTICIPANT = "trial", "participant"
"""What one value of a test is of. Trials of one participant are not independent: p by trial is for comparison with the
paper alone, and gets no stars."""
LEAST_PARTICIPANTS = 4
"""With fewer participants nothing is modelled, and figures show no test: their differences cannot be estimated."""
Sample = tuple[str, Sequence[float]]
"""A group's name and its values."""


@dataclass(frozen=True)
class Question:
    """What a family of tests asks, and the caption of the report's table that shows its tests."""

    name: str
    table: str

    def by(self, unit: str) -> str:
        """The name of its family whose values each stand for a ``unit``."""
        return f"{self.name}, by {unit}"


@dataclass(frozen=True)
class Compared:
    """What was found of a quantity between two groups."""

    quantity: str
    a: Sample
    b: Sample
    found: Comparison


@dataclass(frozen=True)
class Family:
    """The rows of tests that were corrected together; ``table`` is the caption of the report's table with them."""

    simulated: bool
    table: str
    rows: tuple[TestedRow, ...]


def corrected(simulated: bool, question: Question, unit: str, tests: Sequence[Compared]) -> Family:
    """A family: all tests of a question with a unit, by people or by simulated participants, corrected by Holm."""
    adjusted = holm([test.found.p for test in tests])
    name = question.by(unit)
    rows = [_row(simulated, name, unit, test, p) for test, p in zip(tests, adjusted, strict=True)]
    return Family(simulated, question.table, tuple(rows))


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
        mark=mark(p_holm) if unit == PARTICIPANT else "",
        effect=found.effect,
        note=found.note,
    )


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) and np.ndim(values) == 1 else None
