"""Versions of questionnaire items, and the version that belongs to each answer.

Two items are the same version if their text, scale and end labels are the same in all languages. A changed item ``L1``
has the name ``L1 (version 2)`` in tables, tests and figures. Answers to different versions are never pooled. If one
item of a validated questionnaire changes, all its items become new versions with separate scores.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import msgspec

from avrgym.commands.respondents import CAREGIVER_RESPONDENT
from avrgym.questionnaires.questionnaire import MAX_OPTION_COUNT, QUESTION_MOMENTS, Item, Questionnaire
from avrgym.recording.reader import RecordingError, read_header
from avrgym.study.design.design import Design
from avrgym.study.design.design_comparison import DesignTexts
from avrgym.study.storage.database_rows import Participant, StoredDesign, StudyAnswer, Trial, TrialAttempt
from avrgym.study.storage.session_designs import (
    design_from_recording,
    design_from_row,
    make_sentence_translator,
    translate_item,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore

Items = tuple[Item, ...]


@dataclass(frozen=True)
class ItemVersion:
    """A version of an item.

    ``item``: the item with the name of this version. ``design_item_name``: the item's name in the design.
    ``version_number``: number of the version, from 1. ``questionnaire_name``: name of the questionnaire.
    ``items_by_language``: the translated item, by language. ``answer_count_by_participant``: number of answers, by
    pseudonym.
    """

    item: Item
    design_item_name: str
    version_number: int
    questionnaire_name: str
    items_by_language: dict[str, Item] = field(default_factory=dict[str, Item])
    answer_count_by_participant: dict[str, int] = field(default_factory=dict[str, int])


@dataclass(frozen=True)
class ParticipantItemVersions:
    """The item versions that a participant read. ``version_by_item_id``: by the item's name in the design."""

    version_by_item_id: Mapping[str, ItemVersion]


@dataclass(frozen=True)
class _QuestionnaireVersion:
    """A version of a questionnaire. Only validated questionnaires have more than one version."""

    content: Any
    texts: dict[str, Items] = field(default_factory=dict[str, Items])


class ItemCatalogue:
    """All versions of items and questionnaires that participants read."""

    def __init__(self) -> None:
        self.questionnaire_by_name: dict[str, Questionnaire] = {}
        self._versions: dict[str, list[tuple[Item, int, ItemVersion]]] = {}
        self._questionnaire_versions: dict[str, list[_QuestionnaireVersion]] = {}

    @property
    def item_versions(self) -> list[ItemVersion]:
        """All versions of all items, ordered by item, then by version number."""
        return [version for versions in self._versions.values() for _, _, version in versions]

    def add_design_items(
        self, design: Design, language: str, translate: Callable[[str], str]
    ) -> ParticipantItemVersions:
        """Add the items of a design in a language. Returns the version of each item."""
        found: dict[str, ItemVersion] = {}
        for questionnaire in design.questionnaires:
            words = tuple(translate_item(item, translate) for item in questionnaire.items)
            number = self._questionnaire_number(questionnaire, language, words)
            name = format_version_name(questionnaire.name, number)
            own = number if questionnaire.use else 0
            for item, read in zip(questionnaire.items, words, strict=True):
                found[item.id] = self.find_or_add_version(item, read, language, name, own)
            items = tuple(found[item.id].item for item in questionnaire.items)
            self.add_questionnaire(msgspec.structs.replace(questionnaire, name=name, items=items))
        return ParticipantItemVersions(found)

    def find_or_add_version(
        self, item: Item, words: Item, language: str, questionnaire: str, questionnaire_number: int = 0
    ) -> ItemVersion:
        """Returns the version of an item. A new version is added if the item or its text in this language is new.

        ``words``: the item with its texts in the language. ``questionnaire``: name of the questionnaire version.
        ``questionnaire_number``: number of this version; 0 if the questionnaire is not validated.
        """
        versions = self._versions.setdefault(item.id, [])
        for known, known_number, version in versions:
            if (known, known_number) == (item, questionnaire_number) and version.items_by_language.setdefault(
                language, words
            ) == words:
                return version
        number = len(versions) + 1
        named = msgspec.structs.replace(item, id=format_version_name(item.id, number))
        version = ItemVersion(named, item.id, number, questionnaire, {language: words})
        versions.append((item, questionnaire_number, version))
        return version

    def add_questionnaire(self, questionnaire: Questionnaire) -> None:
        """Add a questionnaire. If the catalogue contains its name, add only its new items and moments."""
        known = self.questionnaire_by_name.get(questionnaire.name, questionnaire)
        ids = {item.id for item in known.items}
        items = (*known.items, *(item for item in questionnaire.items if item.id not in ids))
        moments = tuple(each for each in QUESTION_MOMENTS if each in {*known.moments, *questionnaire.moments})
        when = known.when if set(moments) == set(known.moments) else moments
        self.questionnaire_by_name[known.name] = msgspec.structs.replace(known, items=items, when=when)

    def _questionnaire_number(self, questionnaire: Questionnaire, language: str, words: Items) -> int:
        """Returns the version number of a questionnaire, from 1."""
        content = (
            [questionnaire.use, questionnaire.weights, questionnaire.items] if questionnaire.use else None
        )
        versions_of_name = self._questionnaire_versions.setdefault(questionnaire.name, [])
        for number, known in enumerate(versions_of_name, start=1):
            if known.content == content and (
                content is None or known.texts.setdefault(language, words) == words
            ):
                return number
        versions_of_name.append(_QuestionnaireVersion(content, {language: words}))
        return len(versions_of_name)


def format_version_name(name: str, version: int) -> str:
    """Returns the name of a version of an item or questionnaire. The first version has the name in the design."""
    return name if version == 1 else f"{name} (version {version})"


def parse_design_name(name: str) -> str:
    """Returns the name that an item version or questionnaire version has in the design."""
    return name.partition(" (version ")[0]


def add_item_versions_to_design(design: Design, catalogue: ItemCatalogue) -> Design:
    """Returns the design with all item versions of a catalogue, in the design's order."""
    versions = {version.item.id: version for version in catalogue.item_versions}
    answered = {version.design_item_name for version in versions.values()}
    combined = ItemCatalogue()
    for questionnaire in catalogue.questionnaire_by_name.values():
        combined.add_questionnaire(questionnaire)
    for questionnaire in design.questionnaires:
        new = tuple(item for item in questionnaire.items if item.id not in answered)
        if new:
            combined.add_questionnaire(msgspec.structs.replace(questionnaire, items=new))
    places = _places(design)

    def rank(item: Item) -> tuple[int, int]:
        version = versions.get(item.id)
        return places.get(
            version.design_item_name if version else item.id, len(places)
        ), version.version_number if version else 0

    names = [each.name for each in design.questionnaires]
    ordered = sorted(
        combined.questionnaire_by_name.values(),
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


UNKNOWN_QUESTIONNAIRE = "unknown"
"""Name of the questionnaire for items without a stored text."""
UNKNOWN_ITEM_TEXT = "(neither the database nor a recording contains its text)"
"""Text of items without a stored text."""


class AnsweredItems:
    """The item version of each answer. ``participants``: only answers of these participants; default: all."""

    def __init__(self, store: StudyStore, participants: Sequence[Participant] | None = None) -> None:
        self._store = store
        self._catalogue = ItemCatalogue()
        self._forms: dict[bytes, ParticipantItemVersions] = {}
        self._of_answers: dict[int, ItemVersion] = {}
        stored: dict[int, list[StoredDesign]] = {}
        for row in store.read_stored_designs():
            if row.session is not None:
                stored.setdefault(row.participant, []).append(row)
        everyone = store.read_participants() if participants is None else participants
        for participant in sorted(everyone, key=lambda each: (each.simulated, each.number)):
            own_items = _ParticipantItems(self, store, participant, stored.get(participant.number, []))
            for answer in store.read_answers(participant.pseudonym):
                self._take(participant, answer, own_items.form(answer))

    @property
    def design(self) -> Design:
        """The study's current design with all answered item versions."""
        return add_item_versions_to_design(self._store.design, self._catalogue)

    @property
    def item_versions(self) -> list[ItemVersion]:
        """All answered item versions, ordered by item."""
        return self._catalogue.item_versions

    def contains(self, answer: StudyAnswer) -> bool:
        """Returns whether the answer existed when this object was created."""
        return answer.id in self._of_answers

    def find_item(self, answer: StudyAnswer) -> Item:
        """Returns the item of an answer, with the name of its version."""
        return self._of_answers[answer.id].item

    def find_questionnaire(self, answer: StudyAnswer) -> Questionnaire:
        """Returns the questionnaire that contains the answer's item."""
        return self._catalogue.questionnaire_by_name[self._of_answers[answer.id].questionnaire_name]

    def compute_answer_value(self, answer: StudyAnswer) -> int:
        """Returns the value of an answer on its item's response scale."""
        return (
            self.find_questionnaire(answer)
            .find_response_scale(self.find_item(answer))
            .compute_option_value(answer.value)
        )

    def find_design_item_versions(
        self, participant: Participant, design: Design, wordings: DesignTexts | None
    ) -> ParticipantItemVersions:
        """Returns the item versions of a design in the participant's language."""
        language = participant.language or design.languages[0]
        content: Any = [design.questionnaires, language, wordings]
        key = msgspec.json.encode(content, order="deterministic")
        if key not in self._forms:
            translate = make_sentence_translator(self._store, language, wordings)
            self._forms[key] = self._catalogue.add_design_items(design, language, translate)
        return self._forms[key]

    def _take(self, participant: Participant, answer: StudyAnswer, form: ParticipantItemVersions) -> None:
        version = form.version_by_item_id.get(answer.item)
        if version is None or answer.value > version.item.points:
            version = self._unknown(participant, answer)
        version.answer_count_by_participant[participant.pseudonym] = (
            version.answer_count_by_participant.get(participant.pseudonym, 0) + 1
        )
        self._of_answers[answer.id] = version

    def _unknown(self, participant: Participant, answer: StudyAnswer) -> ItemVersion:
        """Returns an item version for an answer without a stored text."""
        item = Item(answer.item, UNKNOWN_ITEM_TEXT, MAX_OPTION_COUNT, "?", "?")
        version = self._catalogue.find_or_add_version(
            item, item, participant.language or "", UNKNOWN_QUESTIONNAIRE
        )
        about = CAREGIVER_RESPONDENT if answer.respondent == CAREGIVER_RESPONDENT else "after_session"
        when = "after_trial" if answer.attempt is not None else about
        self._catalogue.add_questionnaire(Questionnaire(UNKNOWN_QUESTIONNAIRE, when, (version.item,)))
        return version


class _ParticipantItems:
    """Finds the item versions that a participant read, in the database or in the trial's recording."""

    def __init__(
        self,
        answered_items: AnsweredItems,
        store: StudyStore,
        participant: Participant,
        stored: list[StoredDesign],
    ) -> None:
        self._answered_items, self._store, self._participant, self._stored = (
            answered_items,
            store,
            participant,
            stored,
        )
        self._by_row: dict[int, ParticipantItemVersions] = {}
        self._by_attempt: dict[int | None, ParticipantItemVersions] = {}

    def form(self, answer: StudyAnswer) -> ParticipantItemVersions:
        """Returns the item versions that the participant read at the time of an answer."""
        own = [row for row in self._stored if row.stored_at <= answer.answered_at]
        own = own or [row for row in self._stored if row.session == answer.session]
        return self._of_row(own[-1]) if own else self._of_attempt(answer.attempt)

    def _of_row(self, row: StoredDesign) -> ParticipantItemVersions:
        if row.id not in self._by_row:
            design = design_from_row(row)
            self._by_row[row.id] = self._answered_items.find_design_item_versions(
                self._participant, design, row.wordings
            )
        return self._by_row[row.id]

    def _of_attempt(self, attempt: int | None) -> ParticipantItemVersions:
        if attempt not in self._by_attempt:
            design = self._store.design
            with suppress(OSError, RecordingError, StudyError, KeyError):  # another check reports it
                design = self._recorded(self._attempts[attempt or 0])
            self._by_attempt[attempt] = self._answered_items.find_design_item_versions(
                self._participant, design, None
            )
        return self._by_attempt[attempt]

    def _recorded(self, attempt: TrialAttempt) -> Design:
        """Returns the current design, with the values that the attempt's recording contains."""
        design = self._store.design
        translate = make_sentence_translator(
            self._store, self._participant.language or design.languages[0], None
        )
        configuration = read_header(self._store.resolve_path(attempt.recording)).configuration
        return design_from_recording(design, self._trials[attempt.trial], configuration, translate)

    @cached_property
    def _attempts(self) -> dict[int, TrialAttempt]:
        return {each.id: each for each in self._store.read_attempts(self._participant.pseudonym)}

    @cached_property
    def _trials(self) -> dict[int, Trial]:
        return {each.id: each for each in self._store.read_trials(self._participant.pseudonym)}
