"""Finds the line numbers of values in TOML text, for error messages."""

import re
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from avrgym.system.type_guards import is_table

ValuePath = tuple[str | int, ...]
"""Path of a value in a TOML document: keys of tables and indices of arrays."""

_MARK = "avrgym-marks-this-place"


def find_line_number(text: str, place: ValuePath) -> int:
    """Returns the line number of a value, from 1. Raises ``LookupError`` if there is no such value."""
    match place:
        case (str(key), int(index), *rest):
            header, below = _header(text, rf"\[\[\s*{re.escape(key)}\s*\]\]", index), (key, 0, *rest)
        case (str(key), *_):
            header, below = _header(text, rf"\[\s*{re.escape(key)}\s*\]", 0), place
        case _:
            header, below = 0, place
    return header + _marked_line("\n".join(text.split("\n")[header:]), below if header else place)


def _marked_line(text: str, place: ValuePath) -> int:
    """Returns the line number of a value, from 1. A marker replaces the value; the line of the marker is returned."""
    document: Any = tomlkit.parse(text)
    parent: Any = document
    for key in place[:-1]:
        parent = parent[key]
    if not place:
        return 1
    value = parent[place[-1]]
    if is_table(value) and value:
        parent, place = value, (*place, next(iter(value)))
    parent[place[-1]] = _MARK
    before, _, _ = tomlkit.dumps(document).partition(_MARK)
    return before.count("\n") + 1


def _header(text: str, pattern: str, index: int) -> int:
    """Returns the line index (from 0) of the header number ``index`` that matches a pattern; 0 if there is none.

    The tables of an array may be separated in the text, but tomlkit writes them consecutively.
    """
    lines = text.split("\n")
    headers = [
        number
        for number, line in enumerate(lines)
        if re.match(rf"\s*{pattern}", line) and _is_whole("\n".join(lines[:number]))
    ]
    return headers[index] if index < len(headers) else 0


def _is_whole(text: str) -> bool:
    """Returns whether the text is complete TOML, and not cut within a multi-line string."""
    try:
        tomlkit.parse(text)
    except TOMLKitError:
        return False
    return True
