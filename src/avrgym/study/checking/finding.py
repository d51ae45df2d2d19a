"""Findings of the checks of a study."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A finding of a check.

    ``where``: file, participant, trial or part of the study. ``is_error``: the finding must be corrected.
    """

    where: str
    message: str
    is_error: bool = True


class ExcludedTrialFinding(Finding):
    """The finding that a trial is excluded from the analysis because of tracking loss."""


def make_excluded_trial_finding(participant: str, position: int, why: str) -> ExcludedTrialFinding:
    """Returns the finding that a trial is excluded.

    ``position``: number of the trial, from 1. ``why``: reason as text.
    """
    return ExcludedTrialFinding(
        f"{participant}, trial {position}", f"is left out of the analysis: {why}", is_error=False
    )
