"""Where in a TOML text a value stands, for errors that name the line."""

from typing import Any

import tomlkit

from avrgym.system.plain_values import is_table

Place = tuple[str | int, ...]
"""The keys and indices that lead to a value."""

_MARK = "avrgym-marks-this-place"


def line_of(text: str, place: Place) -> int:
    """The line on which a value begins, from 1: where a mark stands that is put in its place."""
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
