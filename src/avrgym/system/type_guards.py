"""Type guards for the values of JSON and TOML."""

from collections.abc import Sequence
from typing import Any, TypeGuard


def is_table(value: object) -> TypeGuard[dict[str, Any]]:
    """Whether a value is an object of JSON or a table of TOML."""
    return isinstance(value, dict)


def is_array(value: object) -> TypeGuard[Sequence[Any]]:
    """Whether a value is an array of JSON or TOML: a list or a tuple."""
    return isinstance(value, list | tuple)
