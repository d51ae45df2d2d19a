"""Rows of tests, each within a family that is corrected as one."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from avrgym.analysis.rows import TestedRow
from avrgym.analysis.statistics.tests import Comparison, holm, mark

TRIAL, PARTICIPANT = "trial", "participant"
"""What one value of a test stands for."""


def tested(
    simulated: bool,
    family: str,
    quantity: str,
    unit: str,
    a: tuple[str, Sequence[float]],
    b: tuple[str, Sequence[float]],
    found: Comparison,
) -> TestedRow:
    """The row of what was found between two named samples, not yet corrected."""
    return TestedRow(
        simulated=simulated,
        family=family,
        quantity=quantity,
        unit=unit,
        group_a=a[0],
        group_b=b[0],
        test=found.test,
        n_a=len(a[1]),
        n_b=len(b[1]),
        n=found.n,
        zeros=found.zeros,
        median_a=_median(a[1]),
        median_b=_median(b[1]),
        statistic=found.statistic,
        method=found.method,
        p=found.p,
        p_holm=None,
        mark="",
        effect=found.effect,
        note=found.note,
    )


def corrected(rows: Sequence[TestedRow]) -> list[TestedRow]:
    """The rows with Holm's correction within each family of neighbours."""
    done = []
    for _, family in groupby(rows, key=lambda row: (row.simulated, row.family)):
        own = list(family)
        adjusted = holm([row.p for row in own])
        done += [replace(row, p_holm=p, mark=mark(p)) for row, p in zip(own, adjusted, strict=True)]
    return done


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) and np.ndim(values) == 1 else None
