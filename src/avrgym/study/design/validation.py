"""Read the TOML files of a study into structures, and report mistakes with their line and the allowed values."""

import re
import tomllib
from collections.abc import Callable, Container, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from avrgym.system.files import read_user_text
from avrgym.system.toml_lines import Place, line_of

NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")


class ValidationError(Exception):
    """An invalid value; ``place`` is its position in the file."""

    def __init__(self, place: Place, message: str) -> None:
        super().__init__(message)
        self.place = place


def check_known(place: Place, name: str, allowed: Iterable[str]) -> None:
    """Raise ``ValidationError`` for a name that is not allowed."""
    if name not in (names := list(allowed)):
        raise ValidationError(place, f"unknown name {name!r}; allowed: {', '.join(names)}")


def check_choice(place: Place, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ``ValidationError`` for a value that is not one of the choices."""
    if value not in allowed:
        raise ValidationError(place, f"{value!r} is not known; allowed: {', '.join(allowed)}")


def check_unique(place: Place, names: tuple[str, ...]) -> None:
    """Raise ``ValidationError`` for a duplicate name in an array."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ValidationError((*place, index), f"{name!r} is listed twice; allowed: once")


def check_pattern(place: Place, name: str, pattern: re.Pattern[str], what: str) -> None:
    """Raise ``ValidationError`` for a name with other characters."""
    if not pattern.fullmatch(name):
        raise ValidationError(
            place, f"{name!r} is not a valid name; allowed: {what}, in letters, digits, - and _"
        )


def check_id(place: Place, name: str, known: Container[str]) -> None:
    """Raise ``ValidationError`` for an invalid or duplicate name."""
    check_pattern(place, name, NAME, "at most 40 characters")
    if name in known:
        raise ValidationError(place, f"{name!r} is used twice; allowed: a unique name")


def check_fields(place: Place, table: dict[str, Any], allowed: tuple[str, ...]) -> None:
    """Raise ``ValidationError`` for an unknown key of a table."""
    for key in table:
        check_known((*place, key), key, allowed)


Kind = TypeVar("Kind", bound=msgspec.Struct)
Tables = Mapping[tuple[str, ...], type[msgspec.Struct]]
"""The struct of each table in a file, by its path of keys."""


class DesignError(ValueError):
    """An invalid design or plan. The message contains file, line, fault and allowed values."""


def read_text(path: Path) -> str:
    """The text of a file; ``DesignError`` if it is not text, ``OSError`` if it cannot be read."""
    try:
        return read_user_text(path)
    except UnicodeDecodeError as error:
        raise DesignError(
            f"{path}: not text in UTF-8: {error.reason} at byte {error.start}; save it as UTF-8"
        ) from None


def parse_toml(
    text: str,
    name: str,
    kind: type[Kind],
    tables: Tables,
    check: Callable[[Kind], None],
    complete: Callable[[dict[str, Any]], dict[str, Any]] = lambda values: values,
) -> Kind:
    """The struct in a text in TOML.

    Args:
        text: the text of the file.
        name: the name of the file for errors.
        kind: the struct of the whole file.
        tables: the structs of its tables.
        check: raises ``ValidationError`` for the first invalid value.
        complete: expands values before the conversion; may raise ``ValidationError``.

    Raises:
        DesignError: for invalid TOML and invalid values.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"at line (\d+)", str(error))
        place = f"{name}:{line[1]}" if line else name
        raise DesignError(f"{place}: not TOML: {error}") from None
    try:
        found = msgspec.convert(complete(values), kind)
        check(found)
    except msgspec.ValidationError as error:
        place, message = _explain(error, {(): kind, **tables})
        raise DesignError(f"{name}:{line_of(text, place)}: {message}") from None
    except ValidationError as error:
        raise DesignError(f"{name}:{line_of(text, error.place)}: {error}") from None
    return found


def _explain(error: msgspec.ValidationError, tables: Tables) -> tuple[Place, str]:
    """The position of an error, and its message without the path."""
    message, _, path = str(error).partition(" - at `$")
    place: Place = tuple(
        int(index) if index else key for key, index in re.findall(r"\.(\w+)|\[(\d+)\]", path)
    )
    unknown = re.search(r"unknown field `(.+)`", message)
    if unknown:
        table = tables[tuple(key for key in place if isinstance(key, str))]
        allowed = ", ".join(table.__struct_fields__)
        return (*place, unknown[1]), f"unknown name {unknown[1]!r}; allowed: {allowed}"
    named = f"{place[-1]}: " if place and isinstance(place[-1], str) else ""
    return place, named + message.replace("`", "")
