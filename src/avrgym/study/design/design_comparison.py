"""Compare designs, and texts for participants, value by value."""

import json
from collections.abc import Iterable, Iterator, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec

from avrgym.study.design.design import SITE_SPECIFIC_FIELDS, Design
from avrgym.study.design.languages import list_participant_sentences
from avrgym.system.toml_lines import ValuePath
from avrgym.system.type_guards import is_array, is_table
from avrgym.texts.interface_texts import (
    InterfaceTexts,
    list_included_languages,
    normalize_whitespace,
    read_texts,
)

FIELDS_NOT_COMPARED = (*SITE_SPECIFIC_FIELDS, "reporting")
"""Design fields that are not compared: fields that may differ between sites, and fields for publications."""

DesignTexts = Mapping[str, Mapping[str, Mapping[str, str]]]
"""Texts for participants by language, group and key.

Groups: translations of ``sentences``, and modified texts of ``session`` and ``page``.
"""


def design_to_dict(design: Design) -> dict[str, Any]:
    """Returns the design as a dictionary for the database, without the fields ``FIELDS_NOT_COMPARED``."""
    plain = msgspec.json.decode(msgspec.json.encode(design))
    return {name: value for name, value in plain.items() if name not in FIELDS_NOT_COMPARED}


def design_from_dict(values: Mapping[str, Any]) -> Design:
    """Returns the design from a dictionary. Fields that this version of AVR Gym does not know are ignored."""
    return msgspec.convert(
        {name: values[name] for name in values if name in Design.__struct_fields__}, Design
    )


def read_design_texts(design: Design, folder: Path) -> dict[str, dict[str, dict[str, str]]]:
    """Returns the texts for participants in each language of a design. Raises ``InvalidTextsError`` for an invalid
    file.
    """
    return {language: _wordings(design, read_texts(language, folder)) for language in design.languages}


def _wordings(design: Design, texts: InterfaceTexts) -> dict[str, dict[str, str]]:
    brought = read_texts(texts.language) if texts.language in list_included_languages() else None
    read = {
        normalize_whitespace(each): texts.translate(each)
        for each in list_participant_sentences(design)
        if each.strip()
    }
    return {
        "sentences": {
            sentence: said for sentence, said in read.items() if normalize_whitespace(said) != sentence
        },
        "session": _changed(texts.session, brought.session if brought else {}),
        "page": _changed(texts.page, brought.page if brought else {}),
    }


def _changed(texts: Mapping[str, str], brought: Mapping[str, str]) -> dict[str, str]:
    return {key: text for key, text in texts.items() if brought.get(key) != text}


def make_comparable_values(design: Design) -> dict[str, Any]:
    """Returns the design's values for a comparison.

    Arrays of questionnaires, items and inclusion questions become dictionaries by name or id. Their order is a separate
    value.
    """
    values = design_to_dict(design)
    values["goals"] = {task: design.find_task_instruction(task) for task in design.tasks}
    values["stop_rules"] = _stop_rules(values["stop_rules"])
    _name(values, "inclusion", "id")
    for questionnaire in values["questionnaires"]:
        _name(questionnaire, "items", "id")
        questionnaire["when"] = (
            [questionnaire["when"]] if isinstance(questionnaire["when"], str) else questionnaire["when"]
        )
    _name(values, "questionnaires", "name")
    return values


def _name(table: dict[str, Any], key: str, name: str) -> None:
    """Replace the array ``table[key]`` by a dictionary by the value of ``name``. Store the order separately."""
    table[f"order of {key}"] = [each[name] for each in table[key]]
    table[key] = {each[name]: {k: v for k, v in each.items() if k != name} for each in table[key]}


def _stop_rules(rules: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the stop rules by item. If an item has several rules, the later keys contain a number."""
    named: dict[str, Any] = {}
    for rule in rules:
        earlier = sum(key.partition(" ")[0] == rule["item"] for key in named)
        named[f"{rule['item']} {earlier + 1}" if earlier else rule["item"]] = {
            key: value for key, value in rule.items() if key != "item"
        }
    return named


MAX_VALUE_TEXT_LENGTH = 80
"""Maximum number of characters of a value in a message."""
MISSING_VALUE = object()
"""Represents a missing value."""


def find_value_differences(a: Any, b: Any, place: ValuePath = ()) -> Iterator[tuple[ValuePath, Any, Any]]:
    """Yields each difference between two values: its key path, the value in ``a`` and the value in ``b``.

    A missing value is ``MISSING_VALUE``. ``place``: key path of ``a`` and ``b``, which begins each result.
    """
    if is_table(a) and is_table(b):
        for name in dict.fromkeys([*a, *b]):
            yield from find_value_differences(
                a.get(name, MISSING_VALUE), b.get(name, MISSING_VALUE), (*place, name)
            )
    elif _contains_tables(a) and _contains_tables(b):
        for index, pair in enumerate(zip_longest(a, b, fillvalue=MISSING_VALUE)):
            yield from find_value_differences(*pair, (*place, index))
    elif a != b:
        yield place, a, b


def format_key_path(place: ValuePath) -> str:
    """Returns a key path as text, such as ``items 1.text``; array elements are numbered from 1."""
    words = (f" {each + 1}" if isinstance(each, int) else f".{each}" for each in place)
    return "".join(words).removeprefix(".")


def format_value(value: Any) -> str:
    """Returns the value as text, truncated to ``MAX_VALUE_TEXT_LENGTH``."""
    if value is MISSING_VALUE:
        return "missing"
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= MAX_VALUE_TEXT_LENGTH else f"{text[: MAX_VALUE_TEXT_LENGTH - 1]}…"


def _contains_tables(value: Any) -> bool:
    return is_array(value) and any(is_table(each) for each in value)
