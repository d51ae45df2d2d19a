"""Describes table columns, in annotations of dataclass fields.

A row is a dataclass with fields such as ``Annotated[float | None, Column("Reaction time.", unit="s", empty="none")]``.
Codebooks are generated from these annotations.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

TEXT, INTEGER, NUMBER, BOOLEAN, TIME = "text", "whole number", "number", "truth", "time"
TYPE_NAMES: Mapping[Any, str] = {str: TEXT, int: INTEGER, float: NUMBER, bool: BOOLEAN}


@dataclass(frozen=True)
class Column:
    """Description of a table column for codebooks.

    ``type``: type of the values, by default the annotated type. ``unit``: unit of the values, by default ``1`` for
    numbers. ``allowed``: the allowed values. ``empty``: the meaning of an empty table cell; without this text, all
    cells have values.
    """

    meaning: str
    type: str = ""
    unit: str = ""
    allowed: str = ""
    empty: str = ""


def describe_columns(row: type) -> dict[str, Column]:
    """Returns the column descriptions of a dataclass, by field name.

    Raises:
        TypeError: for a field without a ``Column``.
    """
    hints = get_type_hints(row, include_extras=True)
    return {field.name: _described(row, field.name, hints[field.name]) for field in fields(row)}


def _described(row: type, name: str, hint: Any) -> Column:
    column = next((each for each in getattr(hint, "__metadata__", ()) if isinstance(each, Column)), None)
    if column is None:
        raise TypeError(f"field {row.__name__}.{name} has no description; annotate its type with a Column")
    kind = column.type or _type_of(hint)
    return replace(
        column,
        type=kind,
        unit=column.unit or ("1" if kind == NUMBER else ""),
        allowed=column.allowed or ("true, false" if kind == BOOLEAN else ""),
    )


def _type_of(hint: Any) -> str:
    kinds = [each for each in _union_members(hint) if each is not NoneType]
    return TYPE_NAMES[kinds[0]]


def _union_members(hint: Any) -> tuple[Any, ...]:
    if get_origin(hint) is Annotated:
        return _union_members(get_args(hint)[0])
    return get_args(hint) or (hint,)
