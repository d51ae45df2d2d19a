"""Converts values of JSON types to structs. Error messages contain the allowed values."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

StructType = TypeVar("StructType", bound=msgspec.Struct)


def convert_to_struct(values: Any, kind: type[StructType], *, strict: bool = True) -> StructType:
    """Returns a struct of type ``kind`` with the values of a table of JSON types.

    ``strict``: whether to reject numbers in the form of text. If it is false, such texts are converted to numbers.

    Raises:
        ValueError: for an unknown field, or a value that is not allowed. The message contains the field's name, its
            value and the allowed values.
    """
    try:
        return msgspec.convert(values, kind, strict=strict)
    except msgspec.ValidationError as error:
        raise ValueError(_describe_error(str(error), values, kind)) from None


def _describe_error(text: str, values: Any, kind: type[msgspec.Struct]) -> str:
    message, _, path = text.partition(" - at `$")
    place: list[str | int] = [name or int(index) for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", path)]
    allowed = inspect.type_info(kind)
    value = values
    for key in place:
        allowed = _type_below(allowed, key)
        value = _value_below(value, key)
    unknown = re.search(r"unknown field `(.+)`", message)
    if unknown and isinstance(allowed, inspect.StructType):
        names = ", ".join(each.encode_name for each in allowed.fields)
        return f"unknown name {unknown[1]!r}; allowed: {names}"
    words = _describe_type(allowed)
    if not words:
        return message  # raised by the struct itself
    names = [each for each in place if isinstance(each, str)]
    verb = "contains" if place and isinstance(place[-1], int) else "is"
    return f"{'.'.join(names) or 'the value'} {verb} {value!r}; allowed: {words}"


def _type_below(whole: inspect.Type, key: str | int) -> inspect.Type:
    """Returns the type of a field, or of an entry of a list; any type for other containers."""
    whole = _plain_type(whole)
    if isinstance(whole, inspect.StructType):
        return next(each.type for each in whole.fields if each.encode_name == key)
    return whole.item_type if isinstance(whole, inspect.CollectionType) else inspect.AnyType()


def _plain_type(kind: inspect.Type) -> inspect.Type:
    """Returns the type without its annotations. For an optional type, returns the type that is not ``None``."""
    if isinstance(kind, inspect.Metadata):
        return _plain_type(kind.type)
    if isinstance(kind, inspect.UnionType):
        others = tuple(each for each in kind.types if not isinstance(each, inspect.NoneType))
        return _plain_type(others[0]) if len(others) == 1 else inspect.UnionType(others)
    return kind


def _value_below(whole: Any, key: str | int) -> Any:
    if isinstance(whole, Mapping | Sequence):
        return whole[key]  # pyright: ignore[reportUnknownVariableType, reportArgumentType, reportCallIssue]
    return getattr(whole, str(key))


def _describe_type(kind: inspect.Type) -> str:
    """Returns the allowed values in words; empty for structs and any type."""
    match _plain_type(kind):
        case inspect.UnionType(types=types):
            return ", ".join(_describe_type(each) for each in types)
        case inspect.LiteralType(values=values):
            return ", ".join(str(each) for each in values)
        case inspect.FloatType(ge=low, le=high) | inspect.IntType(ge=low, le=high) if low is not None:
            return f"{low:g} to {high:g}" if high is not None else f"{low:g} or more"
        case inspect.IntType():
            return "an integer"
        case inspect.FloatType():
            return "a number"
        case inspect.BoolType():
            return "true or false"
        case inspect.StrType(max_length=length):
            return f"a text of at most {length} characters" if length else "a text"
        case inspect.CollectionType():
            return "a list"
        case _:
            return ""
