"""What a check of this computer is, and what it finds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "error"]
"""A fault: something that AVR Gym does fails here. A warning: it does less, or less well, than it could."""


@dataclass(frozen=True)
class Finding:
    """What a check found, and what to do about it in one line; ``fix`` is empty where all is well."""

    state: State
    message: str
    fix: str = ""


@dataclass(frozen=True)
class Check:
    """A question about this computer; ``run`` finds the answer and changes nothing."""

    name: str
    run: Callable[[], Finding]


def ok(message: str) -> Finding:
    """All is well."""
    return Finding("ok", message)


def warning(message: str, fix: str) -> Finding:
    """Something works less well than it could."""
    return Finding("warning", message, fix)


def error(message: str, fix: str) -> Finding:
    """Something does not work."""
    return Finding("error", message, fix)
