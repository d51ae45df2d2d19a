"""Effects of interest and design matrix of the regression models."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from avrgym.analysis.models.estimate import ModelFitError
from avrgym.array_types import FloatArray
from avrgym.study.design.design import Design

POLICY_EFFECT, ROBOT_EFFECT, LEARNING_EFFECT, ORDER_EFFECT, CARRY_OVER_EFFECT = (
    "policies",
    "robots",
    "learning",
    "order",
    "carry-over",
)
EFFECT_KINDS = (POLICY_EFFECT, ROBOT_EFFECT, LEARNING_EFFECT, ORDER_EFFECT, CARRY_OVER_EFFECT)
TASK_EFFECT = "tasks"
"""Kind of effect: differences between tasks. The models contain these nuisance effects, but the results do not."""
FIRST_TASK, LAST_TASK = "first task", "last task"
FIRST_TRIAL, LAST_TRIAL = "first trial of a task", "last trial of a task"
TrialGroup = tuple[str, str]
"""Identifies a group of trials: (kind of effect, name of the group), such as ``("policies", "original")``."""


@dataclass(frozen=True)
class TrialValue:
    """Value of the dependent variable in one trial (``value``), with condition and position of the trial.

    A block contains the trials of one task. ``block_position``: position of the block in the session, from 0 (first) to
    1 (last). ``position_in_block``: position of the trial in its block, from 0 to 1. ``previous_policy``: policy of the
    previous trial (or practice trial) in the block; ``None`` for the first trial.
    """

    participant: str
    task: str
    robot: str
    policy: str
    block_position: float
    position_in_block: float
    previous_policy: str | None
    value: float


@dataclass(frozen=True)
class Effect:
    """An effect of interest: its kind, and two groups of trials. The effect is ``group_a`` minus ``group_b``."""

    kind: str
    group_a: str
    group_b: str


@dataclass(frozen=True, eq=False)
class DesignMatrix:
    """Design matrix (n, p) of n trials without intercept. ``column_groups``: group of trials of each column.

    Reference groups have no column.
    """

    column_groups: tuple[TrialGroup, ...]
    reference_groups: frozenset[TrialGroup]
    matrix: FloatArray

    def make_contrast(self, effect: Effect) -> FloatArray:
        """Returns the contrast vector (p,) of an effect. Raises ``ModelFitError`` if the effect is not identifiable."""
        weights = np.zeros(len(self.column_groups))
        for group, sign in (((effect.kind, effect.group_a), 1.0), ((effect.kind, effect.group_b), -1.0)):
            if group in self.column_groups:
                weights[self.column_groups.index(group)] = sign
            elif group not in self.reference_groups:
                raise ModelFitError(
                    "the effect is not identifiable from these trials; use the test by participant"
                )
        return weights


def list_effects_of_interest(design: Design) -> tuple[Effect, ...]:
    """Returns all effects of interest of a study design: policy, robot, learning, order and carry-over effects."""
    found = [Effect(POLICY_EFFECT, b, a) for a, b in combinations(design.policies, 2)]
    found += [Effect(ROBOT_EFFECT, b, a) for a, b in combinations(design.robots, 2)]
    if len(design.tasks) > 1:
        found.append(Effect(LEARNING_EFFECT, LAST_TASK, FIRST_TASK))
    if len(design.robot_policy_pairs) > 1:
        found.append(Effect(ORDER_EFFECT, LAST_TRIAL, FIRST_TRIAL))
        found += [
            Effect(CARRY_OVER_EFFECT, make_carry_over_group_name(b), make_carry_over_group_name(a))
            for a, b in combinations(design.policies, 2)
        ]
    return tuple(found)


def make_carry_over_group_name(policy: str) -> str:
    """Returns the name of the group of trials that immediately follow a trial with ``policy``."""
    return f"after {policy}"


def make_design_matrix(design: Design, observed: Sequence[TrialValue]) -> DesignMatrix:
    """Returns the design matrix of these trials. A column is omitted if it depends linearly on earlier columns."""
    groups: list[TrialGroup] = []
    reference_groups: set[TrialGroup] = set()
    kept = np.ones((len(observed), 1))
    for group, column in _candidates(design, observed):
        if column is None:
            reference_groups.add(group)
            continue
        widened = np.hstack([kept, column[:, None]])
        if np.linalg.matrix_rank(widened) > kept.shape[1]:
            groups.append(group)
            kept = widened
    return DesignMatrix(tuple(groups), frozenset(reference_groups), kept[:, 1:])


def _candidates(
    design: Design, observed: Sequence[TrialValue]
) -> Iterator[tuple[TrialGroup, FloatArray | None]]:
    """Yields (group, column (n,)) in order of importance. The column is ``None`` for reference groups."""
    yield from _indicators(POLICY_EFFECT, design.policies, [each.policy for each in observed])
    yield from _indicators(ROBOT_EFFECT, design.robots, [each.robot for each in observed])
    yield from _indicators(TASK_EFFECT, design.tasks, [each.task for each in observed])
    yield (LEARNING_EFFECT, FIRST_TASK), None
    yield (LEARNING_EFFECT, LAST_TASK), np.array([each.block_position for each in observed])
    yield (ORDER_EFFECT, FIRST_TRIAL), None
    yield (ORDER_EFFECT, LAST_TRIAL), np.array([each.position_in_block for each in observed])
    befores = [
        make_carry_over_group_name(each.previous_policy) if each.previous_policy else None
        for each in observed
    ]
    yield from _indicators(
        CARRY_OVER_EFFECT, [make_carry_over_group_name(policy) for policy in design.policies], befores
    )


def _indicators(
    kind: str, groups: Sequence[str], given: Sequence[str | None]
) -> Iterator[tuple[TrialGroup, FloatArray | None]]:
    """Yields (group, indicator column (n,) of 0 and 1). The first group is the reference group; its column is ``None``.

    ``given``: group of each trial. A trial without a group has the value 1 / (number of groups) in each column.
    """
    present = [group for group in groups if group in given]
    for number, group in enumerate(present):
        share = 1.0 / len(present)
        belongs = np.array([share if each is None else float(each == group) for each in given])
        yield (kind, group), belongs if number else None
