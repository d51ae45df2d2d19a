"""Tests of whether participants were like the people of the training: the paper's, and those for unpaired samples."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrgym.analysis.reading.trained_people import AXES, HEIGHTS_OF, SEED, TRAINED_WITH, head_of, people_heads
from avrgym.analysis.rows import PersonRow, TestedRow, TrialRow
from avrgym.analysis.statistics.biomechanics import Measures, heights, participants_heads
from avrgym.analysis.statistics.families import PARTICIPANT, TRIAL, corrected, tested
from avrgym.analysis.statistics.tests import Comparison, energy_test, rank_sum, signed_rank
from avrgym.tasks import TASKS

Array = NDArray[np.floating]


def biomechanics_tests(groups: Sequence[Measures], people: Sequence[PersonRow]) -> list[TestedRow]:
    """All tests of torso heights, then of head positions, for each group and posture.

    Signed-rank as in the paper: each trial is paired with another of the people drawn for its task, in order, so
    that the pairs are arbitrary. Mann-Whitney, and for positions the energy distance, take samples as they are:
    one value for each participant against everyone drawn.
    """
    rows = []
    for group in groups:
        rows += [_paired_heights(group, people, name) for name in HEIGHTS_OF]
        rows += [_unpaired_heights(group, people, name) for name in HEIGHTS_OF]
        places = list(product(group.postures(), TRAINED_WITH))
        for tests in (_paired_heads, _unpaired_heads, _whole_heads):
            rows += [row for place in places for row in tests(group, people, *place)]
    return corrected(rows)


def _paired_heights(group: Measures, people: Sequence[PersonRow], name: str) -> TestedRow:
    own = [float(row.torso_height_m or 0.0) for row in group.trials]
    others = [row.torso_height_m for row in _partners(group.trials, people, name)]
    found = signed_rank(np.subtract(own, others))
    return _row(group, "torso heights", "torso_height_m", TRIAL, own, name, others, found)


def _unpaired_heights(group: Measures, people: Sequence[PersonRow], name: str) -> TestedRow:
    own = heights(group)
    others = [row.torso_height_m for row in people if row.people == name]
    found = rank_sum(own, others)
    return _row(group, "torso heights", "torso_height_m", PARTICIPANT, own, name, others, found)


def _paired_heads(group: Measures, people: Sequence[PersonRow], posture: str, name: str) -> list[TestedRow]:
    trials = group.in_posture(posture)
    own = np.array([head_of(row) for row in trials]).T
    others = np.array([head_of(row) for row in _partners(trials, people, name)]).T
    return [
        _row(group, "head positions", f"head_{axis}_m, {posture}", TRIAL, a, name, b, signed_rank(a - b))
        for axis, a, b in zip(AXES, own, others, strict=True)
    ]


def _unpaired_heads(group: Measures, people: Sequence[PersonRow], posture: str, name: str) -> list[TestedRow]:
    own, others = participants_heads(group, posture).T, people_heads(people, name, posture).T
    return [
        _row(group, "head positions", f"head_{axis}_m, {posture}", PARTICIPANT, a, name, b, rank_sum(a, b))
        for axis, a, b in zip(AXES, own, others, strict=True)
    ]


def _whole_heads(group: Measures, people: Sequence[PersonRow], posture: str, name: str) -> list[TestedRow]:
    own, others = participants_heads(group, posture), people_heads(people, name, posture)
    found = energy_test(own, others, SEED)
    return [_row(group, "whole head positions", f"head_m, {posture}", PARTICIPANT, own, name, others, found)]


def _row(
    group: Measures, what: str, quantity: str, unit: str, own: Any, name: str, others: Any, found: Comparison
) -> TestedRow:
    """The row of a test of participants against a distribution's people."""
    family = f"{what}, by {unit}"
    return tested(group.simulated, family, quantity, unit, ("participants", own), (name, others), found)


def _partners(trials: Sequence[TrialRow], people: Sequence[PersonRow], name: str) -> list[PersonRow]:
    """For each trial another person drawn for its task, from the first on; after the last the first again."""
    drawn = {task: [row for row in people if (row.people, row.task) == (name, task)] for task in TASKS}
    taken = dict.fromkeys(TASKS, 0)
    partners = []
    for trial in trials:
        own = drawn[trial.task]
        partners.append(own[taken[trial.task] % len(own)])
        taken[trial.task] += 1
    return partners
