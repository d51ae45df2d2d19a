"""Versions of items: translations share a version; other texts, scales and end labels do not."""

from collections.abc import Callable

import msgspec
import pytest

from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, Item, Questionnaire
from avrgym.study.design.design import Design, parse_design, read_default_design_text
from avrgym.study.storage.item_versions import ItemCatalogue, add_item_versions_to_design

DESIGN = parse_design(read_default_design_text())
TLX = parse_design(
    read_default_design_text().replace(
        "[goals]", '[[questionnaires]]\nuse = "nasa-tlx"\nwhen = "after_trial"\n[goals]'
    )
)
L1 = LIKERT_ITEMS[0]


def english(sentence: str) -> str:
    return sentence


def german(sentence: str) -> str:
    return f"{sentence} (deutsch)"


def other_german(sentence: str) -> str:
    return f"{sentence} (anders)"


def with_first_item(design: Design, item: Item) -> Design:
    first, *others = design.questionnaires
    changed = msgspec.structs.replace(first, items=(item, *first.items[1:]))
    return msgspec.structs.replace(design, questionnaires=(changed, *others))


def names(*asked: tuple[Design, str, Callable[[str], str]]) -> list[list[str]]:
    """The versions of items of each participant; each read a design in a language."""
    catalogue = ItemCatalogue()
    forms = [catalogue.add_design_items(*each) for each in asked]
    return [[version.item.id for version in form.version_by_item_id.values()] for form in forms]


def test_translations_are_the_same_version() -> None:
    plain = [item.id for item in LIKERT_ITEMS]
    assert names((DESIGN, "en", english), (DESIGN, "de", german), (DESIGN, "en", english)) == [plain] * 3


def test_changed_translation_is_a_new_version() -> None:
    first, second, third, fourth = names(
        (DESIGN, "en", english), (DESIGN, "de", german), (DESIGN, "de", other_german), (DESIGN, "de", german)
    )
    assert first == second == fourth
    assert third == [f"{item.id} (version 2)" for item in LIKERT_ITEMS]


@pytest.mark.parametrize(
    "change",
    [
        {"text": "Another statement."},
        {"points": 5},
        {"low": "strongly agree", "high": "strongly disagree"},
        {"labels": tuple("abcdefg")},
    ],
    ids=["words", "points", "ends", "labels"],
)
def test_changed_item_is_a_new_version_and_others_are_not(change: dict[str, object]) -> None:
    changed = with_first_item(DESIGN, msgspec.structs.replace(L1, **change))
    first, second, third = names((DESIGN, "en", english), (changed, "en", english), (DESIGN, "en", english))
    assert first == third == ["L1", "L2", "L3", "L4"]
    assert second == ["L1 (version 2)", "L2", "L3", "L4"]


def test_instrument_changes_as_a_whole() -> None:
    tlx = TLX.questionnaires[1]
    items = (msgspec.structs.replace(tlx.items[0], text="Another question?"), *tlx.items[1:])
    changed = msgspec.structs.replace(tlx, items=items)
    later = msgspec.structs.replace(TLX, questionnaires=(TLX.questionnaires[0], changed))
    catalogue = ItemCatalogue()
    for design in (TLX, later):
        catalogue.add_design_items(design, "en", english)
    found = {
        each.name: [item.id for item in each.items]
        for each in add_item_versions_to_design(TLX, catalogue).questionnaires
    }
    ids = [item.id for item in tlx.items]
    assert found == {
        "likert": ["L1", "L2", "L3", "L4"],
        "nasa-tlx": ids,
        "nasa-tlx (version 2)": [f"{name} (version 2)" for name in ids],
    }


def test_unedited_design_has_only_first_versions() -> None:
    catalogue = ItemCatalogue()
    for translate in (english, english):
        catalogue.add_design_items(TLX, "en", translate)
    assert add_item_versions_to_design(TLX, catalogue) == TLX


def test_unanswered_items_are_from_the_design() -> None:
    catalogue = ItemCatalogue()
    catalogue.add_design_items(DESIGN, "en", english)
    more = Questionnaire("more", "after_session", (msgspec.structs.replace(L1, id="M1"),))
    later = msgspec.structs.replace(DESIGN, questionnaires=(*DESIGN.questionnaires, more))
    assert add_item_versions_to_design(later, catalogue) == later
