"""Type guards for values that were read from JSON or TOML."""

from collections.abc import Sequence
from typing import Any, TypeGuard


def is_table(value: object) -> TypeGuard[dict[str, Any]]:
    """Returns whether a value is a JSON object or a TOML table."""
    return isinstance(value, dict)


def is_array(value: object) -> TypeGuard[Sequence[Any]]:
    """Returns whether a value is a JSON or TOML array (a list or a tuple)."""
    return isinstance(value, list | tuple)
