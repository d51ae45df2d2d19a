"""Tests of participants against training populations: the paired tests of the paper, and tests of unpaired samples."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np

from avrgym.analysis.biomechanics.biomechanics import BodyTrials, participant_head_positions, torso_heights
from avrgym.analysis.biomechanics.training_people import (
    AXIS_NAMES,
    HEIGHT_POPULATIONS,
    TRAINING_POPULATIONS,
    SampledPersonRow,
    head_position,
    training_head_positions,
)
from avrgym.analysis.reading.rows import TrialRow
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    TRIAL_UNIT,
    Comparison,
    ComparisonFamily,
    ResearchQuestion,
    holm_corrected_family,
)
from avrgym.analysis.statistics.tests import (
    StatisticalTestResult,
    energy_test,
    rank_sum_test,
    signed_rank_test,
)
from avrgym.system.random_streams import TRAINING_POPULATION_SEED
from avrgym.tasks.registry import TASKS

TORSO_HEIGHT_QUESTION = ResearchQuestion(
    "torso heights", table_caption="Torso heights and whole head positions"
)
HEAD_POSITION_QUESTION = ResearchQuestion(
    "whole head positions", table_caption=TORSO_HEIGHT_QUESTION.table_caption
)
HEAD_AXIS_QUESTION = ResearchQuestion("head positions", table_caption="Head positions by axis")


def biomechanics_test_families(
    groups: Sequence[BodyTrials], people: Sequence[SampledPersonRow]
) -> list[ComparisonFamily]:
    """Returns all tests of torso heights, then of head positions, for each group and posture.

    The signed-rank test (as in the paper) pairs each trial with a person sampled for the same task. The sampled person
    of a pair is an arbitrary choice. The Mann-Whitney test compares unpaired samples: one value of each participant,
    and all sampled people. The energy test compares the same samples for three-dimensional head positions.
    """
    return [family for group in groups for family in _families(group, people)]


def _families(group: BodyTrials, people: Sequence[SampledPersonRow]) -> Iterator[ComparisonFamily]:
    for unit, test in ((TRIAL_UNIT, _paired_heights), (PARTICIPANT_UNIT, _unpaired_heights)):
        yield holm_corrected_family(
            group.simulated,
            TORSO_HEIGHT_QUESTION,
            unit,
            [test(group, people, name) for name in HEIGHT_POPULATIONS],
        )
    places = list(product(group.postures(), TRAINING_POPULATIONS))
    for question, unit, tests in (
        (HEAD_AXIS_QUESTION, TRIAL_UNIT, _paired_heads),
        (HEAD_AXIS_QUESTION, PARTICIPANT_UNIT, _unpaired_heads),
        (HEAD_POSITION_QUESTION, PARTICIPANT_UNIT, _whole_heads),
    ):
        found = [test for place in places for test in tests(group, people, *place)]
        yield holm_corrected_family(group.simulated, question, unit, found)


def _paired_heights(group: BodyTrials, people: Sequence[SampledPersonRow], name: str) -> Comparison:
    own = [float(row.torso_height_m or 0.0) for row in group.trials]
    others = [row.torso_height_m for row in _partners(group.trials, people, name)]
    found = signed_rank_test(np.subtract(own, others))
    return _against(group.trials, "torso_height_m", own, name, others, found)


def _unpaired_heights(group: BodyTrials, people: Sequence[SampledPersonRow], name: str) -> Comparison:
    own = torso_heights(group)
    others = [row.torso_height_m for row in people if row.population == name]
    return _against(group.trials, "torso_height_m", own, name, others, rank_sum_test(own, others))


def _paired_heads(
    group: BodyTrials, people: Sequence[SampledPersonRow], posture: str, name: str
) -> list[Comparison]:
    trials = group.trials_in_posture(posture)
    own = np.array([head_position(row) for row in trials]).T
    others = np.array([head_position(row) for row in _partners(trials, people, name)]).T
    return [
        _against(trials, f"head_{axis}_m, {posture}", a, name, b, signed_rank_test(a - b))
        for axis, a, b in zip(AXIS_NAMES, own, others, strict=True)
    ]


def _unpaired_heads(
    group: BodyTrials, people: Sequence[SampledPersonRow], posture: str, name: str
) -> list[Comparison]:
    trials = group.trials_in_posture(posture)
    own, others = (
        participant_head_positions(group, posture).T,
        training_head_positions(people, name, posture).T,
    )
    return [
        _against(trials, f"head_{axis}_m, {posture}", a, name, b, rank_sum_test(a, b))
        for axis, a, b in zip(AXIS_NAMES, own, others, strict=True)
    ]


def _whole_heads(
    group: BodyTrials, people: Sequence[SampledPersonRow], posture: str, name: str
) -> list[Comparison]:
    own, others = participant_head_positions(group, posture), training_head_positions(people, name, posture)
    found = energy_test(own, others, TRAINING_POPULATION_SEED)
    return [_against(group.trials_in_posture(posture), f"head_m, {posture}", own, name, others, found)]


def _against(
    trials: Sequence[TrialRow], quantity: str, own: Any, name: str, others: Any, found: StatisticalTestResult
) -> Comparison:
    """Returns the comparison of the participants' values ``own`` with the values ``others`` of population ``name``."""
    participants = len({row.participant for row in trials})
    return Comparison(quantity, ("participants", own), (name, others), found, participants)


def _partners(
    trials: Sequence[TrialRow], people: Sequence[SampledPersonRow], name: str
) -> list[SampledPersonRow]:
    """Returns a sampled person of the same task for each trial.

    People are used in their order. After the last person, the first person is used again.
    """
    drawn = {task: [row for row in people if (row.population, row.task) == (name, task)] for task in TASKS}
    taken = dict.fromkeys(TASKS, 0)
    partners: list[SampledPersonRow] = []
    for trial in trials:
        own = drawn[trial.task]
        partners.append(own[taken[trial.task] % len(own)])
        taken[trial.task] += 1
    return partners
