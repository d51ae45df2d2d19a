"""Tests of participants against training populations: the paired tests of the paper, and tests of unpaired samples."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np

from avrgym.analysis.biomechanics.body_measures import (
    PostureTrials,
    compute_participant_head_positions,
    compute_torso_heights,
)
from avrgym.analysis.biomechanics.training_populations import (
    AXIS_NAMES,
    HEIGHT_POPULATION_NAMES,
    TRAINING_POPULATIONS,
    SampledPersonRow,
    collect_training_head_positions,
    read_head_position,
)
from avrgym.analysis.reading.table_rows import TrialRow
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    TRIAL_UNIT,
    Comparison,
    ComparisonFamily,
    ResearchQuestion,
    make_holm_corrected_family,
)
from avrgym.analysis.statistics.rank_tests import (
    StatisticalTestResult,
    run_energy_test,
    run_rank_sum_test,
    run_signed_rank_test,
)
from avrgym.system.random_streams import TRAINING_POPULATION_SEED
from avrgym.tasks.registry import TASKS

TORSO_HEIGHT_QUESTION = ResearchQuestion(
    "torso heights", table_caption="Torso heights and whole head positions"
)
HEAD_POSITION_QUESTION = ResearchQuestion(
    "whole head positions", table_caption=TORSO_HEIGHT_QUESTION.table_caption
)
HEAD_POSITION_BY_AXIS_QUESTION = ResearchQuestion("head positions", table_caption="Head positions by axis")


def compute_biomechanics_test_families(
    groups: Sequence[PostureTrials], people: Sequence[SampledPersonRow]
) -> list[ComparisonFamily]:
    """Returns all tests of torso heights, then of head positions, for each group and posture.

    The signed-rank test (as in the paper) pairs each trial with a person sampled for the same task. The sampled person
    of a pair is an arbitrary choice. The Mann-Whitney test compares unpaired samples: one value of each participant,
    and all sampled people. The energy test compares the same samples for three-dimensional head positions.
    """
    return [family for group in groups for family in _families(group, people)]


def _families(group: PostureTrials, people: Sequence[SampledPersonRow]) -> Iterator[ComparisonFamily]:
    for unit, test in ((TRIAL_UNIT, _paired_heights), (PARTICIPANT_UNIT, _unpaired_heights)):
        yield make_holm_corrected_family(
            group.is_simulated,
            TORSO_HEIGHT_QUESTION,
            unit,
            [test(group, people, name) for name in HEIGHT_POPULATION_NAMES],
        )
    places = list(product(group.list_postures(), TRAINING_POPULATIONS))
    for question, unit, tests in (
        (HEAD_POSITION_BY_AXIS_QUESTION, TRIAL_UNIT, _paired_heads),
        (HEAD_POSITION_BY_AXIS_QUESTION, PARTICIPANT_UNIT, _unpaired_heads),
        (HEAD_POSITION_QUESTION, PARTICIPANT_UNIT, _whole_heads),
    ):
        found = [test for place in places for test in tests(group, people, *place)]
        yield make_holm_corrected_family(group.is_simulated, question, unit, found)


def _paired_heights(group: PostureTrials, people: Sequence[SampledPersonRow], name: str) -> Comparison:
    own = [float(row.torso_height_m or 0.0) for row in group.trials]
    others = [row.torso_height_m for row in _partners(group.trials, people, name)]
    found = run_signed_rank_test(np.subtract(own, others))
    return _against(group.trials, "torso_height_m", own, name, others, found)


def _unpaired_heights(group: PostureTrials, people: Sequence[SampledPersonRow], name: str) -> Comparison:
    own = compute_torso_heights(group)
    others = [row.torso_height_m for row in people if row.population == name]
    return _against(group.trials, "torso_height_m", own, name, others, run_rank_sum_test(own, others))


def _paired_heads(
    group: PostureTrials, people: Sequence[SampledPersonRow], posture: str, name: str
) -> list[Comparison]:
    trials = group.find_trials_in_posture(posture)
    own = np.array([read_head_position(row) for row in trials]).T
    others = np.array([read_head_position(row) for row in _partners(trials, people, name)]).T
    return [
        _against(trials, f"head_{axis}_m, {posture}", a, name, b, run_signed_rank_test(a - b))
        for axis, a, b in zip(AXIS_NAMES, own, others, strict=True)
    ]


def _unpaired_heads(
    group: PostureTrials, people: Sequence[SampledPersonRow], posture: str, name: str
) -> list[Comparison]:
    trials = group.find_trials_in_posture(posture)
    own, others = (
        compute_participant_head_positions(group, posture).T,
        collect_training_head_positions(people, name, posture).T,
    )
    return [
        _against(trials, f"head_{axis}_m, {posture}", a, name, b, run_rank_sum_test(a, b))
        for axis, a, b in zip(AXIS_NAMES, own, others, strict=True)
    ]


def _whole_heads(
    group: PostureTrials, people: Sequence[SampledPersonRow], posture: str, name: str
) -> list[Comparison]:
    own, others = (
        compute_participant_head_positions(group, posture),
        collect_training_head_positions(people, name, posture),
    )
    found = run_energy_test(own, others, TRAINING_POPULATION_SEED)
    return [_against(group.find_trials_in_posture(posture), f"head_m, {posture}", own, name, others, found)]


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
