"""Repeats of trials as rows of a table: by condition, reason and person."""

from collections import defaultdict
from collections.abc import Hashable, Iterable
from dataclasses import dataclass

from avrgym.study.checking.repeats import AttemptedTrial, Repeat


@dataclass(frozen=True, kw_only=True)
class RepeatRow:
    """Attempts of one condition that others replaced for one cause; of ``trials`` that were begun, ``repeated`` were.

    ``success_unknown`` attempts ended without a stored outcome. ``ordered_by`` is empty unless an experimenter did.
    """

    simulated: bool
    task: str
    robot: str
    policy: str
    trials: int
    reason: str
    cause: str
    ordered_by: str
    repeated: int
    replaced: int
    replaced_successes: int
    success_unknown: int


def repeat_rows(tried: Iterable[AttemptedTrial]) -> list[RepeatRow]:
    """The rows of all conditions in which something was repeated."""
    conditions = defaultdict[tuple[bool, str, str, str], list[AttemptedTrial]](list)
    for each in tried:
        condition = (each.participant.simulated, each.task, each.robot, each.trial.policy)
        conditions[condition].append(each)
    return [row for condition, own in sorted(conditions.items()) for row in _rows(condition, own)]


def _rows(condition: tuple[bool, str, str, str], own: list[AttemptedTrial]) -> Iterable[RepeatRow]:
    simulated, task, robot, policy = condition
    groups = defaultdict[Hashable, list[Repeat]](list)
    for repeat in (repeat for each in own for repeat in each.repeats):
        groups[repeat.reason, repeat.cause, repeat.by].append(repeat)
    for repeats in groups.values():
        first, outcomes = repeats[0], [repeat.success for repeat in repeats]
        yield RepeatRow(
            simulated=simulated,
            task=task,
            robot=robot,
            policy=policy,
            trials=len(own),
            reason=first.reason,
            cause=first.cause,
            ordered_by=first.by,
            repeated=len({repeat.trial.id for repeat in repeats}),
            replaced=len(repeats),
            replaced_successes=outcomes.count(True),
            success_unknown=outcomes.count(None),
        )
