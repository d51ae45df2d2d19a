"""The items of answers, with the words and the scale that each participant read.

An item is the same if its words, its scale and its end labels are the same, also in translation. A changed item is
``L1 (version 2)`` in tables, tests and figures: answers to different items are never pooled. A validated
questionnaire changes as a whole, and scores of its versions are separate too.
"""

from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property
from typing import Any

import msgspec

from avrgym.questionnaires.questionnaire import MOST_POINTS, Item, Questionnaire
from avrgym.recording.reader import RecordingError, read_configuration
from avrgym.study.design.design import Design
from avrgym.study.design.fixed import Wordings
from avrgym.study.storage.recorded_design import as_recorded
from avrgym.study.storage.rows import GivenAnswer, Participant, StoredDesign, Trial, TrialAttempt
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.study.storage.uses import design_of, translation
from avrgym.study.storage.versions import Catalogue, Form, Version, in_order

NOT_STORED = "unknown"
"""The questionnaire of items whose words are not stored."""
UNKNOWN = "(neither the database nor a recording contains its words)"


class Asked:
    """The items that the participants of a study answered, or some of them."""

    def __init__(self, store: Store, participants: Sequence[Participant] | None = None) -> None:
        self._store = store
        self._catalogue = Catalogue()
        self._forms: dict[bytes, Form] = {}
        self._of_answers: dict[int, Version] = {}
        stored: dict[int, list[StoredDesign]] = {}
        for row in store.designs():
            if row.session is not None:
                stored.setdefault(row.participant, []).append(row)
        everyone = store.participants() if participants is None else participants
        for participant in sorted(everyone, key=lambda each: (each.simulated, each.number)):
            reading = _Reading(self, store, participant, stored.get(participant.number, []))
            for answer in store.answers(participant.pseudonym):
                self._take(participant, answer, reading.form(answer))

    @property
    def design(self) -> Design:
        """The study's design with the items that participants answered."""
        return in_order(self._store.design, self._catalogue)

    @property
    def versions(self) -> list[Version]:
        """All versions of all items that participants answered, ordered by item."""
        return self._catalogue.versions

    def contains(self, answer: GivenAnswer) -> bool:
        """Whether an answer was there when this was read."""
        return answer.id in self._of_answers

    def item(self, answer: GivenAnswer) -> Item:
        """The item of an answer, by its name among all versions."""
        return self._of_answers[answer.id].item

    def questionnaire(self, answer: GivenAnswer) -> Questionnaire:
        """The questionnaire of an answer's item."""
        return self._catalogue.questionnaires[self._of_answers[answer.id].questionnaire]

    def value(self, answer: GivenAnswer) -> int:
        """The value of an answer on the scale of its item."""
        return self.questionnaire(answer).scale_of(self.item(answer)).counts_as(answer.value)

    def form(self, participant: Participant, design: Design, wordings: Wordings | None) -> Form:
        """The items of a design for a participant."""
        language = participant.language or design.languages[0]
        content: Any = [design.questionnaires, language, wordings]
        key = msgspec.json.encode(content, order="deterministic")
        if key not in self._forms:
            translate = translation(self._store, language, wordings)
            self._forms[key] = self._catalogue.form(design, language, translate)
        return self._forms[key]

    def _take(self, participant: Participant, answer: GivenAnswer, form: Form) -> None:
        version = form.versions.get(answer.item)
        if version is None or answer.value > version.item.points:
            version = self._unknown(participant, answer)
        version.asked[participant.pseudonym] = version.asked.get(participant.pseudonym, 0) + 1
        self._of_answers[answer.id] = version

    def _unknown(self, participant: Participant, answer: GivenAnswer) -> Version:
        """The item of an answer whose words are not stored."""
        item = Item(answer.item, UNKNOWN, MOST_POINTS, "?", "?")
        version = self._catalogue.version(item, item, participant.language or "", NOT_STORED)
        when = "after_trial" if answer.attempt is not None else "after_session"
        self._catalogue.add(Questionnaire(NOT_STORED, when, (version.item,)))
        return version


class _Reading:
    """Finds the item of each answer of a participant: in the database, else in the trial's recording."""

    def __init__(
        self, asked: Asked, store: Store, participant: Participant, stored: list[StoredDesign]
    ) -> None:
        self._asked, self._store, self._participant, self._stored = asked, store, participant, stored
        self._by_row: dict[int, Form] = {}
        self._by_attempt: dict[int | None, Form] = {}

    def form(self, answer: GivenAnswer) -> Form:
        """The items that the participant read when an answer was given."""
        own = [row for row in self._stored if row.stored_at <= answer.answered_at]
        own = own or [row for row in self._stored if row.session == answer.session]
        return self._of_row(own[-1]) if own else self._of_attempt(answer.attempt)

    def _of_row(self, row: StoredDesign) -> Form:
        if row.id not in self._by_row:
            design = design_of(row)
            self._by_row[row.id] = self._asked.form(self._participant, design, row.wordings)
        return self._by_row[row.id]

    def _of_attempt(self, attempt: int | None) -> Form:
        if attempt not in self._by_attempt:
            design = self._store.design
            with suppress(OSError, RecordingError, StudyError, KeyError):  # other checks report it
                design = self._recorded(self._attempts[attempt or 0])
            self._by_attempt[attempt] = self._asked.form(self._participant, design, None)
        return self._by_attempt[attempt]

    def _recorded(self, attempt: TrialAttempt) -> Design:
        """The present design with what the recording of an attempt reports."""
        design = self._store.design
        translate = translation(self._store, self._participant.language or design.languages[0], None)
        configuration = read_configuration(self._store.path(attempt.recording))
        return as_recorded(design, self._trials[attempt.trial], configuration, translate)

    @cached_property
    def _attempts(self) -> dict[int, TrialAttempt]:
        return {each.id: each for each in self._store.attempts(self._participant.pseudonym)}

    @cached_property
    def _trials(self) -> dict[int, Trial]:
        return {each.id: each for each in self._store.trials(self._participant.pseudonym)}
