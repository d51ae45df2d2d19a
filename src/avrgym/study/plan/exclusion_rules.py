"""Exclusion rules of a plan. A rule excludes participants by the quality of their answers.

Rules use a participant's answers to questionnaires after trials. The analysis lists excluded participants with the
rule's name and the measured value. Three kinds of rules are common in online studies: attention items with a known
answer, straight-lining (equal answers to all items), and too fast answers.

Sources: Oppenheimer, Meyvis and Davidenko, Journal of Experimental Social Psychology 45, 2009 (attention); Curran,
Journal of Experimental Social Psychology 66, 2016 (straight-lining, response time).
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Annotated, Literal

import msgspec

from avrgym.study.storage.database_rows import StudyAnswer
from avrgym.study.storage.store import StudyStore

ExclusionRuleKind = Literal["attention", "straight_lining", "response_time"]
EXCLUSION_RULE_KINDS: tuple[ExclusionRuleKind, ...] = ("attention", "straight_lining", "response_time")
MIN_STRAIGHT_LINING_ITEMS = 3
"""Minimum number of items of a questionnaire for straight-lining. Shorter questionnaires are ignored."""


class ExclusionRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """An exclusion rule. ``name``: name of the rule in reports.

    ``kind`` is one of:

    * ``attention``: excludes a participant if more than ``max_share`` of the answers to ``item`` are not ``allowed``
    * ``straight_lining``: excludes a participant if more than ``max_share`` of the questionnaires have equal answers
      to all items
    * ``response_time``: excludes a participant if the median time for an item is below ``min_seconds``
    """

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=80)]
    kind: ExclusionRuleKind
    item: str = ""
    allowed: tuple[int, ...] = ()
    max_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.0
    min_seconds: Annotated[float, msgspec.Meta(ge=0)] = 0.0


@dataclass(frozen=True)
class AnswerQuality:
    """Quality of a participant's answers. A value is ``None`` if it cannot be computed from the answers.

    Attributes:
        participant: the pseudonym.
        answers: number of answers.
        straight_lined_share: share of questionnaires with equal answers to all items.
        median_response_s: median time for an item, in seconds.
    """

    participant: str
    answers: int
    straight_lined_share: float | None
    median_response_s: float | None


@dataclass(frozen=True)
class RuleViolation:
    """Exclusion of a participant by a rule. ``reason``: the rule's name with the measured and the allowed value."""

    participant: str
    rule_name: str
    reason: str


def find_rule_error(rule: ExclusionRule, items: Iterable[str]) -> str:
    """Returns the error of a rule for the study's items after trials (``items``: their ids); empty if it is valid."""
    known = list(items)
    if rule.kind != "attention":
        return "" if not rule.item and not rule.allowed else f"rules of kind {rule.kind} have no item"
    if rule.item not in known:
        return f"unknown item {rule.item!r}; allowed: {', '.join(known)}"
    return "" if rule.allowed else "allowed is empty; allowed: the right answers"


def compute_answer_quality(store: StudyStore, pseudonym: str) -> AnswerQuality:
    """Returns the quality of a participant's answers to questionnaires after trials, without answers of a proxy."""
    answers = _own_answers(store, pseudonym)
    times = [each.response_time_s for each in answers]
    return AnswerQuality(
        pseudonym, len(answers), compute_straight_lining_fraction(answers), median(times) if times else None
    )


def compute_straight_lining_fraction(answers: Sequence[StudyAnswer]) -> float | None:
    """Returns the share of questionnaires with equal answers to all items; ``None`` without long questionnaires."""
    by_attempt: dict[int | None, list[int]] = defaultdict(list)
    for each in answers:
        by_attempt[each.attempt].append(each.value)
    long = [values for values in by_attempt.values() if len(values) >= MIN_STRAIGHT_LINING_ITEMS]
    return sum(len(set(values)) == 1 for values in long) / len(long) if long else None


def find_rule_violations(store: StudyStore, rules: Sequence[ExclusionRule]) -> list[RuleViolation]:
    """Returns all violations of the rules, by participant and in the order of the rules."""
    if not rules:
        return []
    return [
        RuleViolation(participant.pseudonym, rule.name, f"rule {rule.name!r}: {reason}")
        for participant in store.read_participants()
        for answers in [_own_answers(store, participant.pseudonym)]
        for rule in rules
        if (reason := _violation(rule, answers))
    ]


def _own_answers(store: StudyStore, pseudonym: str) -> list[StudyAnswer]:
    return [
        each for each in store.read_answers(pseudonym) if each.attempt is not None and each.respondent is None
    ]


def _violation(rule: ExclusionRule, answers: Sequence[StudyAnswer]) -> str:
    """Returns the measured and the allowed value if the answers violate the rule; otherwise empty."""
    if rule.kind == "attention":
        given = [each.value for each in answers if each.item == rule.item]
        wrong = sum(value not in rule.allowed for value in given)
        if given and wrong / len(given) > rule.max_share:
            return f"{wrong} of {len(given)} answers to {rule.item} are wrong; allowed: {_percent(rule.max_share)}"
    elif rule.kind == "straight_lining":
        share = compute_straight_lining_fraction(answers)
        if share is not None and share > rule.max_share:
            return (
                f"all answers are equal in {_percent(share)} of the questionnaires; "
                f"allowed: {_percent(rule.max_share)}"
            )
    elif answers:
        seconds = median(each.response_time_s for each in answers)
        if seconds < rule.min_seconds:
            return f"the median time for an item is {seconds:.2f} s; allowed: at least {rule.min_seconds:g} s"
    return ""


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"
