"""Results of the paper, and rows of tables."""

from typing import NamedTuple


class Reached(NamedTuple):
    """A row of a table of the paper."""

    success: int
    """Percent of episodes or trials."""
    reward: int


SIMULATION = {
    "avrgym/FeedingJaco-v1": Reached(75, 82),
    "avrgym/FeedingPR2-v1": Reached(77, 103),
    "avrgym/DrinkingJaco-v1": Reached(32, 144),
    "avrgym/DrinkingPR2-v1": Reached(59, 380),
    "avrgym/ScratchItchJaco-v1": Reached(48, 218),
    "avrgym/ScratchItchPR2-v1": Reached(35, 62),
    "avrgym/BedBathingJaco-v1": Reached(28, 118),
    "avrgym/BedBathingPR2-v1": Reached(13, 85),
}
"""Its Original policies in its own simulation (section VII)."""
ENVIRONMENTS = tuple(SIMULATION)
VIRTUAL_REALITY = {
    "original": {
        "avrgym/FeedingJaco-v1": Reached(63, 37),
        "avrgym/FeedingPR2-v1": Reached(100, 122),
        "avrgym/DrinkingJaco-v1": Reached(0, -92),
        "avrgym/DrinkingPR2-v1": Reached(75, 502),
        "avrgym/ScratchItchJaco-v1": Reached(0, -69),
        "avrgym/ScratchItchPR2-v1": Reached(25, 25),
        "avrgym/BedBathingJaco-v1": Reached(0, -126),
        "avrgym/BedBathingPR2-v1": Reached(0, -87),
    },
    "revised": {
        "avrgym/FeedingJaco-v1": Reached(45, 36),
        "avrgym/FeedingPR2-v1": Reached(100, 113),
        "avrgym/DrinkingJaco-v1": Reached(42, 199),
        "avrgym/DrinkingPR2-v1": Reached(75, 458),
        "avrgym/ScratchItchJaco-v1": Reached(62, 95),
        "avrgym/ScratchItchPR2-v1": Reached(45, 36),
        "avrgym/BedBathingJaco-v1": Reached(0, -16),
        "avrgym/BedBathingPR2-v1": Reached(0, -18),
    },
}
"""Its Original and Revised policies with eight people in virtual reality (tables I and II)."""


def short(environment: str) -> str:
    """An environment's id without namespace and version."""
    return environment.removeprefix("avrgym/").removesuffix("-v1")


def row(*cells: object) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(map(str, cells))} |"
