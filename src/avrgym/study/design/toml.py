"""What a study's files in TOML say, read into structures; mistakes are answered with their line and what is allowed."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import tomlkit
from tomlkit.exceptions import ParseError, TOMLKitError

from avrgym.study.design.wrong import Wrong
from avrgym.system.toml_places import Place, line_of
from avrgym.system.user_text import read_user_text

Kind = TypeVar("Kind", bound=msgspec.Struct)
Tables = Mapping[tuple[str, ...], type[msgspec.Struct]]
"""The structure of each table within a file, by the names that lead to it."""


class DesignError(ValueError):
    """A design, or a plan, that cannot be used; the message names file, line, what is wrong and what is allowed."""


def read_text(path: Path) -> str:
    """The text of a file; ``DesignError`` where it is none, ``OSError`` where it cannot be read."""
    try:
        return read_user_text(path)
    except UnicodeDecodeError as error:
        raise DesignError(
            f"{path}: not text in UTF-8: {error.reason} at byte {error.start}; save it as UTF-8"
        ) from None


def parse(
    text: str,
    name: str,
    kind: type[Kind],
    tables: Tables,
    check: Callable[[Kind], None],
    complete: Callable[[dict[str, Any]], dict[str, Any]] = lambda values: values,
) -> Kind:
    """The structure that a text in TOML holds.

    Args:
        text: the file's.
        name: of the file, for errors.
        kind: what the whole file is.
        tables: what its tables are.
        check: raises ``Wrong`` for the first value that no type forbids but that cannot be.
        complete: adds what the values stand for, and raises ``Wrong`` too.

    Raises:
        DesignError: for anything else than such a structure.
    """
    try:
        values = tomlkit.parse(text).unwrap()
    except ParseError as error:
        raise DesignError(f"{name}:{error.line}: not TOML: {error}") from None
    except TOMLKitError as error:
        raise DesignError(f"{name}: not TOML: {error}") from None
    try:
        found = msgspec.convert(complete(values), kind)
        check(found)
    except msgspec.ValidationError as error:
        place, message = _explain(error, {(): kind, **tables})
        raise DesignError(f"{name}:{line_of(text, place)}: {message}") from None
    except Wrong as error:
        raise DesignError(f"{name}:{line_of(text, error.place)}: {error}") from None
    return found


def _explain(error: msgspec.ValidationError, tables: Tables) -> tuple[Place, str]:
    """Where the error is, and its words without the path."""
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
