"""Stop rules: certain answers, for example about sickness, pause or end the session."""

from dataclasses import dataclass
from typing import NamedTuple

import msgspec

from avrgym.questionnaires.questionnaire import Item, Questionnaire

STOP_ACTIONS = ("pause", "end")
"""Allowed actions, the strongest last."""


class StopRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The session does ``then`` (see ``STOP_ACTIONS``) if the answer to ``item`` has a value of ``at_least`` or more.

    Values are those of the validated questionnaire; for the study's own items, 1 to ``points``.
    """

    item: str
    at_least: float
    then: str


class StopDecision(NamedTuple):
    """The action of the session (one of ``STOP_ACTIONS``), and the reason for the experimenter."""

    then: str
    why: str


@dataclass(frozen=True)
class StopRules:
    """Stop rules, and the questionnaires that contain their items."""

    rules: tuple[StopRule, ...] = ()
    questionnaires: tuple[Questionnaire, ...] = ()

    def decide(self, item_id: str, value: int) -> StopDecision | None:
        """The strongest action that an answer triggers; ``None`` if it triggers none."""
        met = [rule for rule in self.rules if rule.item == item_id and self._is_met(rule, value)]
        if not met:
            return None
        rule = max(met, key=lambda each: STOP_ACTIONS.index(each.then))
        questionnaire, item = self.find(item_id)
        answer = item.labels[value - 1] if item.labels else _value_text(questionnaire, item, value)
        return StopDecision(
            rule.then,
            f"{item.text!r} was answered {answer!r}; the limit of its stop rule is {rule.at_least:g}",
        )

    def value_range(self, item: str) -> tuple[float, float]:
        """The lowest and the highest value of an item's response scale."""
        questionnaire, found = self.find(item)
        return _count(questionnaire, 1), _count(questionnaire, found.points)

    def find(self, item: str) -> tuple[Questionnaire, Item]:
        """An item and its questionnaire. Raises ``KeyError`` for an unknown item."""
        for questionnaire in self.questionnaires:
            for each in questionnaire.items:
                if each.id == item:
                    return questionnaire, each
        raise KeyError(item)

    def _is_met(self, rule: StopRule, value: int) -> bool:
        return _count(self.find(rule.item)[0], value) >= rule.at_least


def _value_text(questionnaire: Questionnaire, item: Item, value: int) -> str:
    return f"{_count(questionnaire, value):g} of {_count(questionnaire, item.points):g}"


def _count(questionnaire: Questionnaire, value: int) -> float:
    instrument = questionnaire.instrument
    return value if instrument is None else instrument.response.scale_value(value)
