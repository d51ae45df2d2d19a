"""The items that participants answered, each version with its participants."""

from dataclasses import dataclass

from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.store import Store


@dataclass(frozen=True, kw_only=True)
class ItemRow:
    """An item in the words that people, or simulated participants, read; ``version`` counts those of one name from 1.

    ``asked_of`` are the participants who answered it, ``answers`` how many answers they gave.
    """

    simulated: bool
    questionnaire: str
    item: str
    version: int
    text: str
    least: int
    most: int
    points: int
    low: str
    high: str
    asked_of: str
    answers: int


def item_rows(store: Store, asked: AnsweredItems) -> list[ItemRow]:
    """A row for each version of an item and group of participants, ordered by item."""
    simulated = {each.pseudonym: each.simulated for each in store.participants()}
    scales = {item.id: own.scale_of(item) for own in asked.design.questionnaires for item in own.items}
    return [
        ItemRow(
            simulated=group,
            questionnaire=version.questionnaire,
            item=version.item.id,
            version=version.number,
            text=version.item.text,
            least=scale.lowest,
            most=scale.highest,
            points=scale.points,
            low=version.item.low,
            high=version.item.high,
            asked_of=", ".join(sorted(own)),
            answers=sum(own.values()),
        )
        for version in asked.versions
        for scale in (scales[version.item.id],)
        for group in (False, True)
        for own in ({name: n for name, n in version.asked.items() if simulated[name] is group},)
        if own
    ]
