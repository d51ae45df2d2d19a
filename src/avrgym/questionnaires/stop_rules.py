"""Stop rules: an answer, for example about sickness, pauses or ends the session."""

from dataclasses import dataclass
from typing import NamedTuple

import msgspec

from avrgym.questionnaires.questionnaire import Item, Questionnaire

STOP_ACTIONS = ("pause", "end")
"""Allowed actions of a stop rule, from the weakest to the strongest."""


class StopRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A rule: an answer to ``item`` of ``min_value`` or more executes ``action`` (pause or end the session).

    For a validated questionnaire, values are on its response scale. For other questionnaires, values are from 1 to
    ``points``.
    """

    item: str
    min_value: float = msgspec.field(name="at_least")
    action: str = msgspec.field(name="then")


class StopDecision(NamedTuple):
    """Decision of a stop rule. ``action``: one of ``STOP_ACTIONS``. ``reason``: reason as text for the experimenter."""

    action: str
    reason: str


@dataclass(frozen=True)
class StopRuleSet:
    """All stop rules of a study. ``questionnaires``: the questionnaires with the items of the rules."""

    rules: tuple[StopRule, ...] = ()
    questionnaires: tuple[Questionnaire, ...] = ()

    def decide(self, item_id: str, value: int) -> StopDecision | None:
        """Returns the decision with the strongest action after an answer; ``None`` if no stop rule applies."""
        met = [rule for rule in self.rules if rule.item == item_id and self._is_met(rule, value)]
        if not met:
            return None
        rule = max(met, key=lambda each: STOP_ACTIONS.index(each.action))
        questionnaire, item = self.find_item(item_id)
        answer = item.labels[value - 1] if item.labels else _value_text(questionnaire, item, value)
        return StopDecision(
            rule.action,
            f"{item.text!r} was answered {answer!r}; the limit of its stop rule is {rule.min_value:g}",
        )

    def compute_value_range(self, item: str) -> tuple[float, float]:
        """Returns the lowest and the highest value that a stop rule for ``item`` can use."""
        questionnaire, found = self.find_item(item)
        return _count(questionnaire, 1), _count(questionnaire, found.points)

    def find_item(self, item: str) -> tuple[Questionnaire, Item]:
        """Returns the questionnaire of an item, and the item. Raises ``KeyError`` for an unknown item."""
        for questionnaire in self.questionnaires:
            for each in questionnaire.items:
                if each.id == item:
                    return questionnaire, each
        raise KeyError(item)

    def _is_met(self, rule: StopRule, value: int) -> bool:
        return _count(self.find_item(rule.item)[0], value) >= rule.min_value


def _value_text(questionnaire: Questionnaire, item: Item, value: int) -> str:
    return f"{_count(questionnaire, value):g} of {_count(questionnaire, item.points):g}"


def _count(questionnaire: Questionnaire, value: int) -> float:
    instrument = questionnaire.instrument
    return value if instrument is None else instrument.response_scale.compute_option_value(value)
