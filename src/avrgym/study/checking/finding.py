"""Findings of the checks of a study."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A finding: its place, a message, and whether it is an error that must be corrected."""

    where: str
    message: str
    is_error: bool = True


class ExcludedTrial(Finding):
    """A trial that the exclusion rule excludes from the analysis."""


def excluded_trial(participant: str, position: int, why: str) -> ExcludedTrial:
    """The finding about an excluded trial."""
    return ExcludedTrial(
        f"{participant}, trial {position}", f"is left out of the analysis: {why}", is_error=False
    )
