"""Repeated trials, by condition, reason and experimenter: table rows and report section."""

from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

from avrgym.analysis.column_types import AT_LEAST_0_TEXT, IsSimulated, PolicyName, RobotName, TaskName
from avrgym.analysis.page.html_elements import (
    Markup,
    format_group_caption,
    render_bullet_list,
    render_table,
    tag,
)
from avrgym.study.checking.repeats import REPEAT_REASONS, AttemptedTrial, ReplacedAttempt
from avrgym.study.design.design import Design
from avrgym.system.columns import Column


@dataclass(frozen=True, kw_only=True)
class RepeatedTrialsRow:
    """Number of attempts in one condition that were replaced by repeats, with the same reason, cause and
    experimenter."""

    simulated: IsSimulated
    task: TaskName
    robot: RobotName
    policy: PolicyName
    trials: Annotated[
        int,
        Column(
            "Number of started trials of the condition, without practice trials.", allowed=AT_LEAST_0_TEXT
        ),
    ]
    reason: Annotated[str, Column("Reason of the repeats.", allowed=", ".join(REPEAT_REASONS))]
    cause: Annotated[str, Column("The cause as text.")]
    ordered_by: Annotated[
        str, Column("The experimenter who requested the repeats.", empty="no experimenter requested them")
    ]
    repeated: Annotated[int, Column("Number of trials repeated for this cause.", allowed=AT_LEAST_0_TEXT)]
    replaced_attempts: Annotated[
        int, Column("Number of attempts that a later attempt replaced.", allowed=AT_LEAST_0_TEXT)
    ]
    replaced_successes: Annotated[
        int, Column("Number of replaced attempts with success.", allowed=AT_LEAST_0_TEXT)
    ]
    success_unknown: Annotated[
        int, Column("Number of replaced attempts without stored outcome.", allowed=AT_LEAST_0_TEXT)
    ]


def make_repeated_trials_rows(attempted_trials: Iterable[AttemptedTrial]) -> list[RepeatedTrialsRow]:
    """Returns rows for all conditions with repeated trials: one for each reason, cause and experimenter."""
    conditions = defaultdict[tuple[bool, str, str, str], list[AttemptedTrial]](list)
    for each in attempted_trials:
        condition = (each.participant.simulated, each.trial.task, each.trial.robot, each.trial.policy)
        conditions[condition].append(each)
    return [row for condition, own in sorted(conditions.items()) for row in _rows(condition, own)]


def _rows(condition: tuple[bool, str, str, str], own: list[AttemptedTrial]) -> Iterable[RepeatedTrialsRow]:
    simulated, task, robot, policy = condition
    groups = defaultdict[Hashable, list[ReplacedAttempt]](list)
    for repeat in (repeat for each in own for repeat in each.replaced_attempts):
        groups[repeat.repeat_reason, repeat.cause_text, repeat.requested_by].append(repeat)
    for repeats in groups.values():
        first, outcomes = repeats[0], [repeat.success for repeat in repeats]
        yield RepeatedTrialsRow(
            simulated=simulated,
            task=task,
            robot=robot,
            policy=policy,
            trials=len(own),
            reason=first.repeat_reason,
            cause=first.cause_text,
            ordered_by=first.requested_by,
            repeated=len({repeat.trial.id for repeat in repeats}),
            replaced_attempts=len(repeats),
            replaced_successes=outcomes.count(True),
            success_unknown=outcomes.count(None),
        )


REPEATS_METHOD_TEXT = (
    "Repeats: attempts, without practice, that a later attempt replaced. An experimenter requests a "
    "repeat by the commands repeat, skip, pause, stop, end or measure again. Exact tests compare "
    "requested repeats between policies, between robots "
    "with policies, and between first attempts with and without success, within participant and task. If repeats are "
    "independent of policy and outcome, the tests report a finding in at most 1 % of studies. Attempts that ended "
    "early are in the comparison of policies and in the limit, but not in the comparison of outcomes."
)


def render_repeated_trials_section(
    design: Design, repeats: Sequence[RepeatedTrialsRow], findings: Sequence[str], simulated: bool
) -> Markup:
    """Returns the report section about repeated trials of one group. ``findings``: results of the tests of repeats."""
    rows = [row for row in repeats if row.simulated is simulated]
    listed = (
        [render_bullet_list([f"{each}." for each in findings]), *_policy_codes(design)] if findings else []
    )
    shown = [_table(rows, simulated)] if rows else []
    return tag("section", tag("h3", "Repeats"), tag("p", _summary_text(rows)), *listed, *shown)


def _policy_codes(design: Design) -> list[Markup]:
    """Returns a paragraph with the policy of each code letter; an empty list if the experimenter is not blinded."""
    if not design.blind_experimenter:
        return []
    codes = [f"{letter} is {policy}" for policy, letter in design.make_blinded_policy_letters().items()]
    return [tag("p", f"Policy codes: {', '.join(sorted(codes))}.")]


def _summary_text(rows: list[RepeatedTrialsRow]) -> str:
    if not rows:
        return "No trial was repeated (without practice)."
    reasons = _summed(rows, lambda row: row.reason)
    people = _summed([row for row in rows if row.ordered_by], lambda row: row.ordered_by)
    total = sum(row.replaced_attempts for row in rows)
    attempts = "1 attempt was" if total == 1 else f"{total} attempts were"
    words = f"{attempts} replaced by repeats: {_listed(reasons)}."
    return f"{words} Requested by: {_listed(people)}." if people else words


def _summed(rows: list[RepeatedTrialsRow], key: Callable[[RepeatedTrialsRow], str]) -> Counter[str]:
    found = Counter[str]()
    for row in rows:
        found[key(row)] += row.replaced_attempts
    return found


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {number}" for name, number in counts.items())


def _table(rows: list[RepeatedTrialsRow], simulated: bool) -> Markup:
    heads = (
        "Task", "Robot", "Policy", "Trials", "Reason", "Cause", "Ordered by", "Trials repeated", "Attempts replaced",
        "of them with success", "unknown outcome",
    )  # fmt: skip
    body = [
        (
            row.task, row.robot, row.policy, row.trials, row.reason, row.cause, row.ordered_by or "–", row.repeated,
            row.replaced_attempts, row.replaced_successes, row.success_unknown,
        )
        for row in rows
    ]  # fmt: skip
    caption = "Attempts that a repeat replaced, by condition, reason and person"
    return render_table(format_group_caption(caption, simulated), heads, body, numbers=(3, 7, 8, 9, 10))
