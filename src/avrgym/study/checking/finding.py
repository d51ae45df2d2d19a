"""What a check of a study finds."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that was found: where, and what. ``wrong``: it must be mended."""

    where: str
    what: str
    wrong: bool = True


class ExcludedTrial(Finding):
    """That the exclusion rule keeps a trial out of the analysis."""


def excluded_trial(participant: str, position: int, why: str) -> ExcludedTrial:
    """The finding about a participant's trial."""
    return ExcludedTrial(
        f"{participant}, trial {position}", f"is left out of the analysis: {why}", wrong=False
    )
