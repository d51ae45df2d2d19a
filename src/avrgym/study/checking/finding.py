"""What a check of a study finds."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that was found: where, and what. ``wrong``: it must be mended."""

    where: str
    what: str
    wrong: bool = True


class LeftOut(Finding):
    """That the exclusion rule keeps a trial out of the analysis."""


def left_out(participant: str, position: int, why: str) -> LeftOut:
    """The finding about a participant's trial."""
    return LeftOut(f"{participant}, trial {position}", f"is left out of the analysis: {why}", wrong=False)
