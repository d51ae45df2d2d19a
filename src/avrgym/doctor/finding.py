"""What a check of this computer is, and what it finds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "fault"]
"""A fault: something that AVR Gym does fails here. A warning: it does less, or less well, than it could."""


@dataclass(frozen=True)
class Finding:
    """What a check found, and what to do about it in one line; ``cure`` is empty where all is well."""

    state: State
    found: str
    cure: str = ""


@dataclass(frozen=True)
class Check:
    """A question about this computer; ``look`` finds the answer and leaves everything as it was."""

    name: str
    look: Callable[[], Finding]


def ok(found: str) -> Finding:
    """All is well."""
    return Finding("ok", found)


def warning(found: str, cure: str) -> Finding:
    """Something works less well than it could."""
    return Finding("warning", found, cure)


def fault(found: str, cure: str) -> Finding:
    """Something does not work."""
    return Finding("fault", found, cure)
