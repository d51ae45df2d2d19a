"""Read the TOML files of a study into structs. Error messages contain the line and the allowed values."""

import re
import tomllib
from collections.abc import Callable, Container, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

import msgspec

from avrgym.system.files import read_user_text
from avrgym.system.toml_lines import ValuePath, find_line_number
from avrgym.system.type_guards import is_table

NAME_PATTERN = re.compile(r"[A-Za-z0-9_-]{1,40}")


class ValidationError(Exception):
    """An invalid value. ``place``: its key path (keys and indices)."""

    def __init__(self, place: ValuePath, message: str) -> None:
        super().__init__(message)
        self.key_path = place


def check_known_name(place: ValuePath, name: str, allowed: Iterable[str]) -> None:
    """Raises ``ValidationError`` if the name is not in ``allowed``. ``place``: key path of the name in the file."""
    if name not in (names := list(allowed)):
        raise ValidationError(place, f"unknown name {name!r}; allowed: {', '.join(names)}")


def check_allowed_value(place: ValuePath, value: str, allowed: tuple[str, ...]) -> None:
    """Raises ``ValidationError`` if the value is not in ``allowed``. ``place``: key path of the value in the file."""
    if value not in allowed:
        raise ValidationError(place, f"unknown value {value!r}; allowed: {', '.join(allowed)}")


def check_unique_names(place: ValuePath, names: tuple[str, ...]) -> None:
    """Raises ``ValidationError`` if a name occurs twice. ``place``: key path of the names in the file."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ValidationError((*place, index), f"{name!r} is listed twice; allowed: once")


def check_name_pattern(place: ValuePath, name: str, pattern: re.Pattern[str], what: str) -> None:
    """Raises ``ValidationError`` if the name does not match the pattern; ``what`` describes valid names."""
    if not pattern.fullmatch(name):
        raise ValidationError(place, f"{name!r} is not a valid name; allowed: {what}")


def check_id(place: ValuePath, name: str, known: Container[str]) -> None:
    """Raises ``ValidationError`` if the name is invalid or already in ``known``."""
    check_name_pattern(place, name, NAME_PATTERN, "1 to 40 letters, digits, - and _")
    if name in known:
        raise ValidationError(place, f"{name!r} is used twice; allowed: a unique name")


def check_keys(place: ValuePath, table: dict[str, Any], allowed: tuple[str, ...]) -> None:
    """Raises ``ValidationError`` if a table of the file has a key that is not in ``allowed``."""
    for key in table:
        check_known_name((*place, key), key, allowed)


StructType = TypeVar("StructType", bound=msgspec.Struct)
StructByKeyPath = Mapping[tuple[str, ...], type[msgspec.Struct]]
"""The struct of each table in a file, by the table's key path."""


class DesignError(ValueError):
    """The design or plan is invalid. The message contains file, line, error and allowed values."""


def read_text(path: Path) -> str:
    """Returns the text of a file. Raises ``DesignError`` if it is not UTF-8, and ``OSError`` if it cannot be read."""
    try:
        return read_user_text(path)
    except UnicodeDecodeError as error:
        raise DesignError(
            f"{path}: not a UTF-8 text: {error.reason} at byte {error.start}; save it as UTF-8"
        ) from None


def parse_toml(
    text: str,
    name: str,
    kind: type[StructType],
    tables: StructByKeyPath,
    check: Callable[[StructType], None],
    complete: Callable[[dict[str, Any]], dict[str, Any]] = lambda values: values,
) -> StructType:
    """Parse and validate a TOML text. Returns the struct with its values.

    Args:
        text: the contents of the file.
        name: name of the file in error messages.
        kind: struct of the whole file.
        tables: structs of the tables in the file, by key path.
        check: raises ``ValidationError`` for the first invalid value.
        complete: expands values before validation; may raise ``ValidationError``.

    Raises:
        DesignError: for invalid TOML or invalid values.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"at line (\d+)", str(error))
        place = f"{name}:{line[1]}" if line else name
        raise DesignError(f"{place}: invalid TOML: {error}; correct this line") from None
    try:
        found = msgspec.convert(complete(values), kind)
        check(found)
    except msgspec.ValidationError as error:
        place, message = _explain(error, {(): kind, **tables})
        raise DesignError(f"{name}:{find_line_number(text, _with_keys(values, place))}: {message}") from None
    except ValidationError as error:
        raise DesignError(f"{name}:{find_line_number(text, error.key_path)}: {error}") from None
    return found


def _with_keys(values: Any, place: ValuePath) -> ValuePath:
    """Returns the key path with the keys of mappings, because msgspec omits them.

    If several mappings match, the first mapping that contains the next key is used.
    """
    found: list[str | int] = []
    for key in place:
        if is_table(values) and isinstance(key, str) and key not in values:
            name = next((each for each in values if is_table(values[each]) and key in values[each]), None)
            if name is None:
                return place
            found.append(name)
            values = values[name]
        found.append(key)
        values = cast(Any, values)[key]
    return tuple(found)


def _explain(error: msgspec.ValidationError, tables: StructByKeyPath) -> tuple[ValuePath, str]:
    """Returns the path of the invalid value, and the error message without the path."""
    message, _, path = str(error).partition(" - at `$")
    place: ValuePath = tuple(
        int(index) if index else key for key, index in re.findall(r"\.(\w+)|\[(\d+)\]", path)
    )
    unknown = re.search(r"unknown field `(.+)`", message)
    if unknown:
        table = tables[tuple(key for key in place if isinstance(key, str))]
        allowed = ", ".join(table.__struct_encode_fields__)
        return (*place, unknown[1]), f"unknown name {unknown[1]!r}; allowed: {allowed}"
    named = f"{place[-1]}: " if place and isinstance(place[-1], str) else ""
    return place, named + message.replace("`", "")
