"""Where in a TOML text a value stands, for errors that name the line."""

import re
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from avrgym.system.type_guards import is_table

Place = tuple[str | int, ...]
"""The keys and indices that lead to a value."""

_MARK = "avrgym-marks-this-place"


def line_of(text: str, place: Place) -> int:
    """The line on which a value begins, from 1."""
    match place:
        case (str(key), int(index), *rest):
            header, below = _header(text, rf"\[\[\s*{re.escape(key)}\s*\]\]", index), (key, 0, *rest)
        case (str(key), *_):
            header, below = _header(text, rf"\[\s*{re.escape(key)}\s*\]", 0), place
        case _:
            header, below = 0, place
    return header + _marked_line("\n".join(text.split("\n")[header:]), below if header else place)


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


def _header(text: str, pattern: str, index: int) -> int:
    """The line, from 0, of the header of a table, the so many-th that looks like it; 0 where there is none.

    Tables of one array may stand far from each other, and tomlkit writes them side by side: what stands above a
    table tells nothing of the lines below.
    """
    lines = text.split("\n")
    headers = [
        number
        for number, line in enumerate(lines)
        if re.match(rf"\s*{pattern}", line) and _is_whole("\n".join(lines[:number]))
    ]
    return headers[index] if index < len(headers) else 0


def _is_whole(text: str) -> bool:
    """Whether a text ends between two lines of TOML, and not within a text of several lines."""
    try:
        tomlkit.parse(text)
    except TOMLKitError:
        return False
    return True
