"""What a check of a study finds."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that was found: where, and what. ``wrong``: it must be mended."""

    where: str
    what: str
    wrong: bool = True
