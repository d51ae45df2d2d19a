"""Where in a TOML text a value stands, for errors that name the line."""

import re
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from avrgym.system.plain_values import is_table

Place = tuple[str | int, ...]
"""The keys and indices that lead to a value."""

_MARK = "avrgym-marks-this-place"


def line_of(text: str, place: Place) -> int:
    """The line on which a value begins, from 1."""
    match place:
        case (str(key), int(index), *rest) if (header := _header(text, key, index)) is not None:
            below = "\n".join(text.split("\n")[header:])
            return header + _marked_line(below, (key, 0, *rest))
        case _:
            return _marked_line(text, place)


def _marked_line(text: str, place: Place) -> int:
    """The line of a value: where a mark stands that is put in its place."""
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


def _header(text: str, key: str, index: int) -> int | None:
    """The line, from 0, of the header of one table of an array; ``None`` where the array is written in one.

    Such tables may stand far from each other, and tomlkit writes them side by side.
    """
    lines = text.split("\n")
    pattern = re.compile(rf"\s*\[\[\s*{re.escape(key)}\s*\]\]")
    headers = [
        number
        for number, line in enumerate(lines)
        if pattern.match(line) and _is_whole("\n".join(lines[:number]))
    ]
    return headers[index] if index < len(headers) else None


def _is_whole(text: str) -> bool:
    """Whether a text ends between two lines of TOML, and not within a text of several lines."""
    try:
        tomlkit.parse(text)
    except TOMLKitError:
        return False
    return True
