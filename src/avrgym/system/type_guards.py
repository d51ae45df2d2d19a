"""Values as JSON and TOML have them, told apart at run time with the types of what is in them."""

from collections.abc import Sequence
from typing import Any, TypeGuard


def is_table(value: object) -> TypeGuard[dict[str, Any]]:
    """Whether a value is an object of JSON, or a table of TOML: their keys are text."""
    return isinstance(value, dict)


def is_array(value: object) -> TypeGuard[Sequence[Any]]:
    """Whether a value is an array of JSON or TOML, which in Python may be a list or a tuple."""
    return isinstance(value, list | tuple)
