"""Versions of items and of validated questionnaires that participants read under one name."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from avrgym.questionnaires.questionnaire import MOMENTS, Item, Questionnaire
from avrgym.study.design.design import Design
from avrgym.study.storage.recorded_design import translated

Words = tuple[Item, ...]


@dataclass(frozen=True)
class Version:
    """An item as participants read it.

    ``item`` has its name among all versions, ``of`` is its name in the design, ``number`` counts its versions from 1.
    ``words`` are the texts by language, ``asked`` counts answers by participant.
    """

    item: Item
    of: str
    number: int
    questionnaire: str
    words: dict[str, Item] = field(default_factory=dict[str, Item])
    asked: dict[str, int] = field(default_factory=dict[str, int])


@dataclass(frozen=True)
class Form:
    """The items that a participant read, by their names in the design."""

    versions: Mapping[str, Version]


@dataclass(frozen=True)
class _Whole:
    """A version of a validated questionnaire, whose items change together; other questionnaires have one version."""

    content: Any
    words: dict[str, Words] = field(default_factory=dict[str, Words])


class Catalogue:
    """All items that participants read; items and questionnaires that change under one name become its versions."""

    def __init__(self) -> None:
        self.questionnaires: dict[str, Questionnaire] = {}
        self._versions: dict[str, list[tuple[Item, int, Version]]] = {}
        self._wholes: dict[str, list[_Whole]] = {}

    @property
    def versions(self) -> list[Version]:
        """All versions of all items, ordered by item."""
        return [version for versions in self._versions.values() for _, _, version in versions]

    def form(self, design: Design, language: str, translate: Callable[[str], str]) -> Form:
        """The items of a design for a participant who reads this language."""
        found: dict[str, Version] = {}
        for questionnaire in design.questionnaires:
            words = tuple(translated(item, translate) for item in questionnaire.items)
            whole = self._whole(questionnaire, language, words)
            name = numbered(questionnaire.name, whole)
            own = whole if questionnaire.use else 0
            for item, read in zip(questionnaire.items, words, strict=True):
                found[item.id] = self.version(item, read, language, name, own)
            items = tuple(found[item.id].item for item in questionnaire.items)
            self.add(msgspec.structs.replace(questionnaire, name=name, items=items))
        return Form(found)

    def version(self, item: Item, words: Item, language: str, questionnaire: str, whole: int = 0) -> Version:
        """The version of an item; a new one where the item, or its words in this language, were not asked before."""
        versions = self._versions.setdefault(item.id, [])
        for known, of, version in versions:
            if (known, of) == (item, whole) and version.words.setdefault(language, words) == words:
                return version
        number = len(versions) + 1
        named = msgspec.structs.replace(item, id=numbered(item.id, number))
        version = Version(named, item.id, number, questionnaire, {language: words})
        versions.append((item, whole, version))
        return version

    def add(self, questionnaire: Questionnaire) -> None:
        """Add a questionnaire, or add its items and moments to the existing one."""
        known = self.questionnaires.get(questionnaire.name, questionnaire)
        ids = {item.id for item in known.items}
        items = (*known.items, *(item for item in questionnaire.items if item.id not in ids))
        moments = tuple(each for each in MOMENTS if each in {*known.moments, *questionnaire.moments})
        when = known.when if set(moments) == set(known.moments) else moments
        self.questionnaires[known.name] = msgspec.structs.replace(known, items=items, when=when)

    def _whole(self, questionnaire: Questionnaire, language: str, words: Words) -> int:
        """The number of a questionnaire among those of its name, from 1."""
        content = (
            [questionnaire.use, questionnaire.weights, questionnaire.items] if questionnaire.use else None
        )
        wholes = self._wholes.setdefault(questionnaire.name, [])
        for number, known in enumerate(wholes, start=1):
            if known.content == content and (
                content is None or known.words.setdefault(language, words) == words
            ):
                return number
        wholes.append(_Whole(content, {language: words}))
        return len(wholes)


def numbered(name: str, version: int) -> str:
    """The name of a version; the first version has the name of its item in the design."""
    return name if version == 1 else f"{name} (version {version})"


def first_name(name: str) -> str:
    """The name in the design of any version of an item or a questionnaire."""
    return name.partition(" (version ")[0]


def in_order(design: Design, catalogue: Catalogue) -> Design:
    """A design with all items that participants read, in its own order; other items are unchanged."""
    versions = {version.item.id: version for version in catalogue.versions}
    of = {version.of for version in versions.values()}
    whole = Catalogue()
    for questionnaire in catalogue.questionnaires.values():
        whole.add(questionnaire)
    for questionnaire in design.questionnaires:
        new = tuple(item for item in questionnaire.items if item.id not in of)
        if new:
            whole.add(msgspec.structs.replace(questionnaire, items=new))
    places = _places(design)

    def rank(item: Item) -> tuple[int, int]:
        version = versions.get(item.id)
        return places.get(version.of if version else item.id, len(places)), version.number if version else 0

    names = [each.name for each in design.questionnaires]
    ordered = sorted(
        whole.questionnaires.values(),
        key=lambda each: names.index(each.name) if each.name in names else len(names),
    )
    return msgspec.structs.replace(
        design,
        questionnaires=tuple(
            msgspec.structs.replace(each, items=tuple(sorted(each.items, key=rank))) for each in ordered
        ),
    )


def _places(design: Design) -> dict[str, int]:
    ids: Iterable[str] = (item.id for each in design.questionnaires for item in each.items)
    return {name: place for place, name in enumerate(ids)}
