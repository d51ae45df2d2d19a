"""What differs between two tables as TOML and JSON have them, value by value."""

import json
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

from avrgym.system.plain_values import is_array, is_table
from avrgym.system.toml_places import Place

LONGEST = 80
"""Longer values are told by their beginning."""
NOTHING = object()
"""Stands for a value that is not there."""


def differences(a: Any, b: Any, place: Place = ()) -> Iterator[tuple[Place, Any, Any]]:
    """The place of each difference, and the values there, of which one may be ``NOTHING``."""
    if is_table(a) and is_table(b):
        for name in dict.fromkeys([*a, *b]):
            yield from differences(a.get(name, NOTHING), b.get(name, NOTHING), (*place, name))
    elif _holds_tables(a) and _holds_tables(b):
        for index, pair in enumerate(zip_longest(a, b, fillvalue=NOTHING)):
            yield from differences(*pair, (*place, index))
    elif a != b:
        yield place, a, b


def named(place: Place) -> str:
    """A place in a sentence; what stands in an array is counted from 1."""
    words = (f" {each + 1}" if isinstance(each, int) else f".{each}" for each in place)
    return "".join(words).removeprefix(".")


def shown(value: Any) -> str:
    """A value in a sentence."""
    if value is NOTHING:
        return "missing"
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


def _holds_tables(value: Any) -> bool:
    return is_array(value) and any(is_table(each) for each in value)
