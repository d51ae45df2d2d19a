"""The statements that participants rate after a trial, and what counts as an answer."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Item:
    """One statement, rated from 1 (``low``) to ``points`` (``high``)."""

    id: str
    text: str
    points: int
    low: str
    high: str


def _likert(id: str, text: str) -> Item:
    return Item(id, text, points=7, low="strongly disagree", high="strongly agree")


LIKERT_ITEMS = (
    _likert("L1", "The robot successfully assisted me with the task."),
    _likert("L2", "I felt comfortable with how the robot assisted me in VR."),
    _likert("L3", "I felt I would be safe if this were a real robot."),
    _likert("L4", "The robot moved with appropriate speed."),
)


def validate_answer(items: Sequence[Item], item_id: str, value: int) -> None:
    """Raise ``ValueError``, naming what is allowed, unless ``value`` answers one of the items."""
    by_id = {item.id: item for item in items}
    if item_id not in by_id:
        raise ValueError(f"no item {item_id!r}; allowed: {', '.join(by_id)}")
    points = by_id[item_id].points
    if type(value) is not int or not 1 <= value <= points:
        raise ValueError(f"{value!r} does not answer {item_id}; allowed: whole numbers from 1 to {points}")
