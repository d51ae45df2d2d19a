"""Validate the questionnaires and stop rules of a design."""

from collections.abc import Sequence

from avrgym.questionnaires.questionnaire import ITEM_ORDERS, QUESTION_MOMENTS, Item, Questionnaire
from avrgym.questionnaires.stop_rules import STOP_ACTIONS, StopRuleSet
from avrgym.study.design.instruments import check_instrument_weights
from avrgym.study.design.toml_validation import (
    ValidationError,
    check_allowed_value,
    check_id,
    check_known_name,
    check_unique_names,
)
from avrgym.system.toml_lines import ValuePath


def check_questionnaires(questionnaires: Sequence[Questionnaire]) -> None:
    """Raises ``ValidationError`` for the first invalid value of a questionnaire."""
    names: set[str] = set()
    ids: set[str] = set()
    for index, questionnaire in enumerate(questionnaires):
        place = ("questionnaires", index)
        named = questionnaire.instrument is None or questionnaire.name != questionnaire.use
        check_id((*place, "name" if named else "use"), questionnaire.name, names)
        names.add(questionnaire.name)
        _check_moments(place, questionnaire)
        check_instrument_weights(place, questionnaire)
        for number, item in enumerate(questionnaire.items):
            own = (*place, "items", number) if questionnaire.instrument is None else (*place, "use")
            _check_item(own, item, ids)
            ids.add(item.id)


def _check_moments(place: ValuePath, questionnaire: Questionnaire) -> None:
    for moment in questionnaire.moments:
        check_allowed_value((*place, "when"), moment, QUESTION_MOMENTS)
    check_unique_names((*place, "when"), questionnaire.moments)
    check_allowed_value((*place, "order"), questionnaire.order, ITEM_ORDERS)


def _check_item(place: ValuePath, item: Item, known: set[str]) -> None:
    check_id(place if place[-1] == "use" else (*place, "id"), item.id, known)
    if item.labels and len(item.labels) != item.points:
        raise ValidationError(
            (*place, "labels"),
            f"{len(item.labels)} labels for {item.points} points; allowed: one label for each point",
        )


def check_stop_rules(rules: StopRuleSet) -> None:
    """Raises ``ValidationError`` for the first invalid rule. A rule for no answer or for every answer is invalid."""
    items = [item.id for questionnaire in rules.questionnaires for item in questionnaire.items]
    for index, rule in enumerate(rules.rules):
        place = ("stop_rules", index)
        check_known_name((*place, "item"), rule.item, items)
        check_allowed_value((*place, "then"), rule.action, STOP_ACTIONS)
        least, most = rules.compute_value_range(rule.item)
        if not least < rule.min_value <= most:
            raise ValidationError(
                (*place, "at_least"),
                f"at_least = {rule.min_value:g} is out of range for {rule.item}; allowed: above {least:g}, "
                f"at most {most:g}",
            )
