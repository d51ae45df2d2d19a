"""Check that a study has all texts for participants in each of its languages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from avrgym.questionnaires.questionnaire import Questionnaire
from avrgym.study.design import functioning
from avrgym.study.design.instruments import INSTRUMENTS_FOLDER as INSTRUMENTS
from avrgym.study.design.toml_validation import ValidationError, check_unique_names
from avrgym.texts.interface_texts import TEXTS_FOLDER, InvalidTextsError, read_texts

if TYPE_CHECKING:
    from avrgym.study.design.design import Design


ENGLISH_LANGUAGE_TAG = "en"
"""Language of the sentences in AVR Gym: goals of tasks, and included questionnaires."""
MAX_LISTED_SENTENCES = 3
"""Maximum number of missing sentences in an error message."""


def check_translations(design: Design, folder: Path) -> None:
    """Raises ``ValidationError`` for the first language with missing texts.

    Sentences of the design are in its first language, and need translations into the other languages. Sentences of
    AVR Gym need translations into all languages except English.
    """
    check_unique_names(("languages",), design.languages)
    for index, language in enumerate(design.languages):
        try:
            texts = read_texts(language, folder)
        except InvalidTextsError as error:
            raise ValidationError(("languages", index), str(error)) from None
        own = _design_sentences(design) if index > 0 else ()
        included = _included_sentences(design) if language != ENGLISH_LANGUAGE_TAG else ()
        untranslated = texts.find_untranslated_sentences([*own, *included])
        if untranslated:
            named = ", ".join(f'"{sentence}"' for sentence in untranslated[:MAX_LISTED_SENTENCES])
            more = (
                f" and {len(untranslated) - MAX_LISTED_SENTENCES} more"
                if len(untranslated) > MAX_LISTED_SENTENCES
                else ""
            )
            allowed = (
                f"a line for each under [sentences] of {TEXTS_FOLDER}/{language}.toml in the study's folder"
            )
            raise ValidationError(
                ("languages", index),
                f"no translation into {language} of {named}{more}; allowed: {allowed}",
            )


def list_participant_sentences(design: Design) -> list[str]:
    """Returns all sentences that participants read, before translation."""
    return [*_design_sentences(design), *_included_sentences(design)]


def _design_sentences(design: Design) -> Iterator[str]:
    """Yields the sentences that the design contains."""
    yield design.consent.text
    yield from (question.text for question in design.inclusion)
    yield from design.goals.values()
    for questionnaire in design.questionnaires:
        if not _has_included_text(questionnaire):
            yield from _words(questionnaire)


def _included_sentences(design: Design) -> Iterator[str]:
    """Yields the sentences of AVR Gym that the design uses."""
    for task in design.tasks:
        if not design.goals.get(task):
            yield from {design.find_task_instruction(task, name) for name in ("", *design.conditions)}
    if design.ask_functioning:
        yield from functioning.list_functioning_sentences()
    for questionnaire in design.questionnaires:
        if _has_included_text(questionnaire):
            yield from _words(questionnaire)


def _has_included_text(questionnaire: Questionnaire) -> bool:
    instrument = questionnaire.instrument
    return instrument is not None and all(item.text for item in instrument.items)


def _words(questionnaire: Questionnaire) -> Iterator[str]:
    for item in questionnaire.items:
        yield from (item.text, item.low, item.high, *item.labels)


def find_text_files(design: Design, folder: Path) -> list[str]:
    """Returns the existing text files of the design: translations and questionnaire texts.

    Paths are relative to the study's folder.
    """
    used = dict.fromkeys(each.use for each in design.questionnaires if each.use)
    names = [f"{TEXTS_FOLDER}/{language}.toml" for language in design.languages]
    names += [f"{INSTRUMENTS}/{name}.toml" for name in used]
    return [name for name in names if (folder / name).is_file()]
