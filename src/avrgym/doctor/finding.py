"""Checks of this computer and their results."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "error"]
"""Error: a function of AVR Gym fails on this computer. Warning: a function is limited."""


@dataclass(frozen=True)
class Finding:
    """The result of a check: a message, and how to fix the problem (empty if there is none)."""

    state: State
    message: str
    fix: str = ""


@dataclass(frozen=True)
class Check:
    """A check of this computer. ``run`` changes nothing."""

    name: str
    run: Callable[[], Finding]


def ok(message: str) -> Finding:
    """A result without a problem."""
    return Finding("ok", message)


def warning(message: str, fix: str) -> Finding:
    """The result that a function is limited."""
    return Finding("warning", message, fix)


def error(message: str, fix: str) -> Finding:
    """The result that a function fails."""
    return Finding("error", message, fix)
