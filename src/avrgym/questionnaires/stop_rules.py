"""Stop rules: answers at which a session pauses or ends, as where somebody gets sick."""

from dataclasses import dataclass
from typing import NamedTuple

import msgspec

from avrgym.questionnaires.questionnaire import Item, Questionnaire

THEN = ("pause", "end")
"""What a session does, the stronger last."""


class StopRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """At an answer to ``item`` that counts ``at_least`` so much, the session pauses or ends, as ``then`` says.

    Answers count as their instrument counts them, those to a study's own items from 1 to ``points``.
    """

    item: str
    at_least: float
    then: str


class Verdict(NamedTuple):
    """What a session does (one of ``THEN``), and why, in words for the experimenter."""

    then: str
    why: str


@dataclass(frozen=True)
class StopRules:
    """Stop rules with the questionnaires whose items they are about."""

    rules: tuple[StopRule, ...] = ()
    questionnaires: tuple[Questionnaire, ...] = ()

    def verdict(self, item_id: str, value: int) -> Verdict | None:
        """The verdict of the rules on an answer; the strongest, where several are met."""
        met = [rule for rule in self.rules if rule.item == item_id and self._is_met(rule, value)]
        if not met:
            return None
        rule = max(met, key=lambda each: THEN.index(each.then))
        questionnaire, item = self.find(item_id)
        given = item.labels[value - 1] if item.labels else _of_most(questionnaire, item, value)
        return Verdict(
            rule.then, f"{item.text!r} was answered {given!r}; a stop rule holds from {rule.at_least:g} on"
        )

    def ends_of(self, item: str) -> tuple[float, float]:
        """The least and the most that an answer to an item can count."""
        questionnaire, found = self.find(item)
        return _count(questionnaire, 1), _count(questionnaire, found.points)

    def find(self, item: str) -> tuple[Questionnaire, Item]:
        """An item, and the questionnaire that it stands in; ``KeyError`` where there is none."""
        for questionnaire in self.questionnaires:
            for each in questionnaire.items:
                if each.id == item:
                    return questionnaire, each
        raise KeyError(item)

    def _is_met(self, rule: StopRule, value: int) -> bool:
        return _count(self.find(rule.item)[0], value) >= rule.at_least


def _of_most(questionnaire: Questionnaire, item: Item, value: int) -> str:
    return f"{_count(questionnaire, value):g} of {_count(questionnaire, item.points):g}"


def _count(questionnaire: Questionnaire, value: int) -> float:
    instrument = questionnaire.instrument
    return value if instrument is None else instrument.response.counts_as(value)
