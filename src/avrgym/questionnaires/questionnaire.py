"""Items and questionnaires that participants answer, and validation of answers."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Annotated

import msgspec

from avrgym.questionnaires.instrument import Instrument, ResponseScale
from avrgym.questionnaires.registry import INSTRUMENTS
from avrgym.system import random_streams
from avrgym.texts.interface_texts import InterfaceTexts

QUESTION_MOMENTS = ("before_session", "after_trial", "after_break", "after_session", "caregiver")
"""Moments of questionnaires. ``caregiver``: a caregiver answers during or after a session."""
SESSION_QUESTION_MOMENTS = ("before_session", "after_session")
"""Moments of questions about a whole session."""
REPEATABLE_QUESTION_MOMENTS = ("after_break", "caregiver")
"""Moments at which the same item may be answered several times."""
ITEM_ORDERS = ("fixed", "random")
"""Orders of the items of a questionnaire."""
MAX_OPTION_COUNT = 101
"""Maximum number of different answers to an item."""


class Item(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A statement or question. Answers are numbered from 1 to ``points``.

    ``low`` and ``high``: labels of the lowest and the highest answer. ``labels``: labels of all answers, which the
    screen shows instead of numbers.
    """

    id: str
    text: Annotated[str, msgspec.Meta(min_length=1)]
    points: Annotated[int, msgspec.Meta(ge=2, le=MAX_OPTION_COUNT)]
    low: str
    high: str
    labels: tuple[str, ...] = ()


def translate_items(items: Sequence[Item], texts: InterfaceTexts) -> tuple[Item, ...]:
    """Returns the items with translated text and labels, in the language of ``texts``."""
    return tuple(
        msgspec.structs.replace(
            item,
            text=texts.translate(item.text),
            low=texts.translate(item.low),
            high=texts.translate(item.high),
            labels=tuple(texts.translate(label) for label in item.labels),
        )
        for item in items
    )


class Questionnaire(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A questionnaire of a study.

    ``when``: one or more of ``QUESTION_MOMENTS``. ``order``: one of ``ITEM_ORDERS``. ``use``: name of a validated
    questionnaire that defines items and scores. ``weights``: weights of its weighted score.
    """

    name: str
    when: str | Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    items: Annotated[tuple[Item, ...], msgspec.Meta(min_length=1)]
    order: str = "fixed"
    use: str | msgspec.UnsetType = msgspec.UNSET
    weights: Mapping[str, int] | msgspec.UnsetType = msgspec.UNSET

    @property
    def instrument(self) -> Instrument | None:
        """The validated questionnaire with the name ``use``; ``None`` for a questionnaire of the study."""
        return INSTRUMENTS[self.use] if self.use else None

    @property
    def moments(self) -> tuple[str, ...]:
        """The moments at which the items are shown, of ``QUESTION_MOMENTS``."""
        return (self.when,) if isinstance(self.when, str) else self.when

    def find_response_scale(self, item: Item) -> ResponseScale:
        """Returns the response scale of an item.

        Items of a validated questionnaire have its scale. Items with integer labels have these labels as values. All
        other items have the values 1 to ``points``. Tables, figures and exports contain values of this scale. Stored
        answers are always numbered from 1.
        """
        if self.instrument is not None:
            return self.instrument.response_scale
        return _numbered(item.labels) or ResponseScale(item.points, lowest_value=1)

    def describe_response_scale(self, item: Item) -> str:
        """Returns the response scale of an item as text, with its labels."""
        scale = self.find_response_scale(item)
        if item.labels and item.labels != tuple(map(str, scale.values)):
            return ", ".join(
                f"{value} ({label})" for value, label in zip(scale.values, item.labels, strict=True)
            )
        steps = f" in steps of {scale.step}" if scale.step != 1 else ""
        return f"from {scale.lowest_value} ({item.low}) to {scale.highest_value} ({item.high}){steps}"


def _numbered(labels: Sequence[str]) -> ResponseScale | None:
    """Returns the response scale of labels that are increasing, equally spaced integers; otherwise ``None``."""
    try:
        values = [int(label) for label in labels]
    except ValueError:
        return None
    steps = {after - before for before, after in pairwise(values)}
    return ResponseScale(len(values), values[0], *steps) if len(steps) == 1 and min(steps) > 0 else None


def _likert(id: str, text: str) -> Item:
    return Item(id, text, points=7, low="strongly disagree", high="strongly agree")


LIKERT_ITEMS = (
    _likert("L1", "The robot successfully assisted me with the task."),
    _likert("L2", "I felt comfortable with how the robot assisted me in VR."),
    _likert("L3", "I felt I would be safe if this were a real robot."),
    _likert("L4", "The robot moved with appropriate speed."),
)


def list_items_at_moment(questionnaires: Iterable[Questionnaire], when: str, seed: int) -> tuple[Item, ...]:
    """Returns the items that are shown at a moment, in order.

    ``when``: one of ``QUESTION_MOMENTS``. ``seed``: seed of random item orders.
    """
    rng = random_streams.make_item_order_rng(seed)
    ordered: list[Item] = []
    for questionnaire in questionnaires:
        if when in questionnaire.moments:
            count = len(questionnaire.items)
            indices = rng.permutation(count) if questionnaire.order == "random" else range(count)
            ordered += [questionnaire.items[index] for index in indices]
    return tuple(ordered)


def validate_answer(items: Sequence[Item], item_id: str, value: int) -> None:
    """Raises ``ValueError`` if ``items`` lacks the item, or if ``value`` is not an allowed answer to it."""
    by_id = {item.id: item for item in items}
    if item_id not in by_id:
        raise ValueError(f"no item {item_id!r}; allowed: {', '.join(by_id)}")
    points = by_id[item_id].points
    if type(value) is not int or not 1 <= value <= points:
        raise ValueError(f"{value!r} is not an answer to {item_id}; allowed: integers from 1 to {points}")
