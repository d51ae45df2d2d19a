"""Checks of this computer and their results."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

FindingState = Literal["ok", "warning", "error"]
"""State of a finding. ``error``: a part of AVR Gym does not work on this computer. ``warning``: a part is limited."""


@dataclass(frozen=True)
class Finding:
    """Result of a check: state, message, and instructions to fix the problem (empty without a problem)."""

    state: FindingState
    message: str
    fix: str = ""


@dataclass(frozen=True)
class Check:
    """A check of this computer. ``run_check``: function that returns the finding, without changes to the computer."""

    name: str
    run_check: Callable[[], Finding]


def make_ok_finding(message: str) -> Finding:
    """Returns a finding in the state ``ok``: no problem was found."""
    return Finding("ok", message)


def make_warning_finding(message: str, fix: str) -> Finding:
    """Returns a finding in the state ``warning``: a part of AVR Gym is limited."""
    return Finding("warning", message, fix)


def make_error_finding(message: str, fix: str) -> Finding:
    """Returns a finding in the state ``error``: a part of AVR Gym does not work."""
    return Finding("error", message, fix)
