"""Validated questionnaires in a design: ``use`` is the name of a questionnaire; its items are added to the design.

If the licence of a text does not allow distribution, the text is read from ``instruments/NAME.toml`` in the study's
folder. This file has a line for each item: ``ID = "text"``, or with end labels
``ID = { text = "…", low = "…", high = "…" }``.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from avrgym.questionnaires.instrument import Instrument, InstrumentItem, check_weights
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.questionnaires.registry import INSTRUMENTS
from avrgym.study.design.toml_validation import ValidationError, check_keys, check_known_name
from avrgym.system.files import read_user_text
from avrgym.system.toml_lines import ValuePath
from avrgym.system.type_guards import is_array, is_table

INSTRUMENTS_FOLDER = "instruments"
INSTRUMENT_QUESTIONNAIRE_KEYS = ("use", "name", "when", "order", "weights")
"""Allowed keys of a questionnaire with ``use``."""


class ItemText(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The text and end labels of an item in ``instruments/NAME.toml``."""

    text: str
    low: str = ""
    high: str = ""


def add_instrument_items(values: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Returns a design's values with the items of validated questionnaires.

    Args:
        values: the values of the TOML file, before validation.
        folder: the study's folder.

    Raises:
        ValidationError: for an unknown questionnaire, or for missing or incomplete texts.
    """
    tables = values.get("questionnaires")
    if not is_array(tables):
        return values
    return values | {"questionnaires": [_with_items(n, table, folder) for n, table in enumerate(tables)]}


def _with_items(index: int, table: Any, folder: Path) -> Any:
    if not is_table(table) or "use" not in table:
        return table
    place = "questionnaires", index
    check_keys(place, table, INSTRUMENT_QUESTIONNAIRE_KEYS)
    check_known_name((*place, "use"), str(table["use"]), INSTRUMENTS)
    instrument = INSTRUMENTS[str(table["use"])]
    items = [msgspec.to_builtins(item) for item in _items((*place, "use"), instrument, folder)]
    return {"name": instrument.name} | table | {"items": items}


def check_instrument_weights(place: ValuePath, questionnaire: Questionnaire) -> None:
    """Raises ``ValidationError`` for invalid weights, and for weights of a questionnaire that cannot have weights."""
    if questionnaire.weights is msgspec.UNSET:
        return
    instrument = questionnaire.instrument
    if instrument is None or instrument.weighting is None:
        weighted = ", ".join(name for name, each in INSTRUMENTS.items() if each.weighting is not None)
        raise ValidationError(
            (*place, "weights"),
            f"this questionnaire cannot have weights; allowed: questionnaires with use = {weighted}",
        )
    try:
        check_weights(instrument.weighting, questionnaire.weights)
    except ValueError as error:
        raise ValidationError((*place, "weights"), str(error)) from None


def _items(place: ValuePath, instrument: Instrument, folder: Path) -> list[Item]:
    """Returns the items of a validated questionnaire. Missing texts are read from the study's folder."""
    brought = all(item.text for item in instrument.items)
    own: Mapping[str, ItemText] = {} if brought else _texts_of_study(place, instrument, folder)
    points = instrument.response_scale.option_count
    return [
        Item(
            item.id,
            words.text,
            points,
            words.low or item.low_label,
            words.high or item.high_label,
            item.option_labels,
        )
        for item in instrument.items
        for words in (own.get(item.id, ItemText(item.text)),)
    ]


def _texts_of_study(place: ValuePath, instrument: Instrument, folder: Path) -> Mapping[str, ItemText]:
    """Returns the texts of all items from the study's folder. Raises ``ValidationError`` for a missing or invalid
    file.
    """
    name = f"{INSTRUMENTS_FOLDER}/{instrument.name}.toml"
    wanted = f"the texts of {', '.join(item.id for item in instrument.items)}, from {instrument.texts_source}"
    try:
        text = read_user_text(folder / name)
        words = {key: _item_text(value) for key, value in tomllib.loads(text).items()}
    except FileNotFoundError:
        raise ValidationError(
            place, f"{name} is missing in the study's folder; allowed: a file with {wanted}"
        ) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise ValidationError(place, f"{name} cannot be read: {error}; allowed: {wanted}") from None
    for key in words:
        if key not in (ids := [item.id for item in instrument.items]):
            raise ValidationError(place, f"{name} has an unknown item {key!r}; allowed: {', '.join(ids)}")
    missing = [item.id for item in instrument.items if not _is_complete(item, words.get(item.id))]
    if missing:
        raise ValidationError(place, f"{name} lacks {_describe_missing(instrument, missing)}")
    return words


def _item_text(value: Any) -> ItemText:
    return ItemText(value) if isinstance(value, str) else msgspec.convert(value, ItemText)


def _is_complete(item: InstrumentItem, words: ItemText | None) -> bool:
    return bool(words and words.text and (words.low or item.low_label) and (words.high or item.high_label))


def _describe_missing(instrument: Instrument, missing: list[str]) -> str:
    """Returns the ids of missing items, and the format of their texts, for an error message."""
    ends = all(item.low_label and item.high_label for item in instrument.items)
    how = '"text"' if ends else '{ text = "text", low = "lowest label", high = "highest label" }'
    return f"{', '.join(missing)}; allowed: each item as ID = {how}"
