"""What can be wrong with a single value of a design, where it stands, and what is allowed."""

import re
from collections.abc import Container, Iterable
from typing import Any

from avrgym.system.toml_places import Place

NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")


class Wrong(Exception):
    """A value that no type forbids but that cannot be; ``place`` is where it stands."""

    def __init__(self, place: Place, message: str) -> None:
        super().__init__(message)
        self.place = place


def check_known(place: Place, name: str, allowed: Iterable[str]) -> None:
    """Raise ``Wrong`` for a name that is none of those allowed."""
    if name not in (names := list(allowed)):
        raise Wrong(place, f"unknown name {name!r}; allowed: {', '.join(names)}")


def check_choice(place: Place, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ``Wrong`` for a value that is no choice."""
    if value not in allowed:
        raise Wrong(place, f"{value!r} is not known; allowed: {', '.join(allowed)}")


def check_unique(place: Place, names: tuple[str, ...]) -> None:
    """Raise ``Wrong`` for a name that stands twice in an array."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise Wrong((*place, index), f"{name!r} stands here twice; allowed: once")


def check_pattern(place: Place, name: str, pattern: re.Pattern[str], what: str) -> None:
    """Raise ``Wrong`` for a name of other characters."""
    if not pattern.fullmatch(name):
        raise Wrong(place, f"{name!r} is no name; allowed: {what}, in letters, digits, - and _")


def check_id(place: Place, name: str, known: Container[str]) -> None:
    """Raise ``Wrong`` for a name that is none, or that another has."""
    check_pattern(place, name, NAME, "at most 40 characters")
    if name in known:
        raise Wrong(place, f"{name!r} stands twice; allowed: a name that no other has")


def check_fields(place: Place, table: dict[str, Any], allowed: tuple[str, ...]) -> None:
    """Raise ``Wrong`` for a key of a table that it may not have."""
    for key in table:
        check_known((*place, key), key, allowed)
