"""The design of a trial as its recording contains it."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import msgspec

from avrgym.models.furniture.real import RealFurniture
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.questionnaires.stop_rules import StopRule
from avrgym.study.design.design import Design
from avrgym.study.storage.rows import Trial
from avrgym.tasks.registry import TASKS, find_environment

Translate = Callable[[str], str]
AFTER_TRIAL = "after_trial"
_FIELDS: Mapping[str, tuple[str, Any]] = {
    "steps": ("trial_steps", int),
    "force_guard": ("force_guard", bool),
    "withdraw_after_success": ("withdraw_after_success", bool),
    "free_movement_s": ("free_movement_s", float),
    "stop_rules": ("stop_rules", tuple[StopRule, ...]),
    "furniture": ("furniture", RealFurniture),
}
"""The field of a design and its type, by its name in a recording's configuration."""


def as_recorded(
    design: Design, trial: Trial, configuration: Mapping[str, Any], translate: Translate
) -> Design:
    """A design whose fields are replaced by the configuration in a trial's recording.

    Args:
        design: gives the fields that are not recorded.
        trial: the trial.
        configuration: the configuration in its recording; missing fields change nothing.
        translate: translates a sentence of the design into the words that this participant read.
    """
    changes: dict[str, Any] = {}
    for name, (field, kind) in _FIELDS.items():
        with suppress(KeyError, msgspec.ValidationError, ValueError):
            changes[field] = msgspec.convert(configuration[name], kind)
    task = find_environment(trial.environment)[0]
    goal, expected = configuration.get("goal"), design.goals.get(task) or TASKS[task].goal
    if isinstance(goal, str) and goal not in (expected, translate(expected)):
        changes["goals"] = {**design.goals, task: goal}
    items = recorded_items(configuration)
    if items is not None and not trial.practice:
        changes["questionnaires"] = _asked(design, trial.seed, items, translate)
    return msgspec.structs.replace(design, **changes)


def recorded_items(configuration: Mapping[str, Any]) -> tuple[Item, ...] | None:
    """The items after a trial, in the participant's words; ``None`` where its recording does not contain it."""
    try:
        return msgspec.convert(configuration["items"], tuple[Item, ...])
    except (KeyError, msgspec.ValidationError):
        return None


def _asked(
    design: Design, seed: int, items: Sequence[Item], translate: Translate
) -> tuple[Questionnaire, ...]:
    """The design's questionnaires with the recorded items after a trial instead of those of the design."""
    known = {item.id: item for item in design.items.values()}
    asked = {item.id: _in_design(item, known.get(item.id), translate) for item in items}
    for order in ("as designed", "fixed", "random"):
        found = tuple(_with_items(each, asked, order) for each in design.questionnaires)
        found = _with_others(found, asked)
        again = msgspec.structs.replace(design, questionnaires=found).items_at(AFTER_TRIAL, seed)
        if [item.id for item in again] == list(asked):
            return found
    return tuple(_sorted(each, list(asked)) for each in found)


def _in_design(item: Item, known: Item | None, translate: Translate) -> Item:
    """The item of the design if the recorded words are its translation; else the item as it was read."""
    return known if known is not None and item in (known, translated(known, translate)) else item


def translated(item: Item, translate: Translate) -> Item:
    """An item in a participant's words."""
    return msgspec.structs.replace(
        item,
        text=translate(item.text),
        low=translate(item.low),
        high=translate(item.high),
        labels=tuple(translate(label) for label in item.labels),
    )


def _with_items(questionnaire: Questionnaire, asked: Mapping[str, Item], order: str) -> Questionnaire:
    if AFTER_TRIAL not in questionnaire.moments:
        return questionnaire
    own = tuple(asked[item.id] for item in questionnaire.items if item.id in asked)
    order = questionnaire.order if order == "as designed" else order
    return msgspec.structs.replace(questionnaire, items=own, order=order)


def _with_others(
    questionnaires: tuple[Questionnaire, ...], asked: Mapping[str, Item]
) -> tuple[Questionnaire, ...]:
    """Questionnaires, and one more with the recorded items that no questionnaire after trials contains."""
    known = {item.id for each in questionnaires if AFTER_TRIAL in each.moments for item in each.items}
    others = tuple(item for item in asked.values() if item.id not in known)
    return (*questionnaires, Questionnaire("recorded", AFTER_TRIAL, others)) if others else questionnaires


def _sorted(questionnaire: Questionnaire, ids: Sequence[str]) -> Questionnaire:
    if AFTER_TRIAL not in questionnaire.moments:
        return questionnaire
    own = tuple(sorted(questionnaire.items, key=lambda item: ids.index(item.id)))
    return msgspec.structs.replace(questionnaire, items=own, order="fixed")
