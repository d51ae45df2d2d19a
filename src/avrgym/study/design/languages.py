"""Check that each language of a study has all texts that participants read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from avrgym.questionnaires.questionnaire import Questionnaire
from avrgym.study.design import functioning
from avrgym.study.design.instruments import FOLDER as INSTRUMENTS
from avrgym.study.design.validation import ValidationError, check_unique
from avrgym.tasks.registry import TASKS
from avrgym.texts.interface_texts import TEXTS_FOLDER, TextsError, read_texts

if TYPE_CHECKING:
    from avrgym.study.design.design import Design


ENGLISH = "en"
"""In which AVR Gym's own sentences are: tasks, and the instruments whose words it brings."""
NAMED = 3
"""As many missing sentences are named; of more, how many there are."""


def check_languages(design: Design, folder: Path) -> None:
    """Raise ``ValidationError`` for the first language that has not all that participants of a design read.

    ``folder`` is the study's. The first language is that of the design itself; its sentences need translations into
    each of the others, and those that AVR Gym brings into each but English.
    """
    check_unique(("languages",), design.languages)
    for index, language in enumerate(design.languages):
        try:
            texts = read_texts(language, folder)
        except TextsError as error:
            raise ValidationError(("languages", index), str(error)) from None
        own = _own(design) if index > 0 else ()
        brought = _brought(design) if language != ENGLISH else ()
        untranslated = texts.untranslated([*own, *brought])
        if untranslated:
            named = ", ".join(f'"{sentence}"' for sentence in untranslated[:NAMED])
            more = f" and {len(untranslated) - NAMED} more" if len(untranslated) > NAMED else ""
            allowed = (
                f"a line for each under [sentences] of {TEXTS_FOLDER}/{language}.toml in the study's folder"
            )
            raise ValidationError(
                ("languages", index),
                f"no translation into {language} of {named}{more}; allowed: {allowed}",
            )


def participant_sentences(design: Design) -> list[str]:
    """All sentences of a design that participants read, in the language that they are written in."""
    return [*_own(design), *_brought(design)]


def _own(design: Design) -> Iterator[str]:
    """The sentences that the design itself says to participants."""
    yield design.consent.text
    yield from (question.text for question in design.inclusion)
    yield from design.goals.values()
    for questionnaire in design.questionnaires:
        if not _is_brought(questionnaire):
            yield from _words(questionnaire)


def _brought(design: Design) -> Iterator[str]:
    """Those that AVR Gym says in it."""
    yield from (TASKS[task].goal for task in design.tasks if not design.goals.get(task))
    if design.ask_functioning:
        yield from functioning.sentences()
    for questionnaire in design.questionnaires:
        if _is_brought(questionnaire):
            yield from _words(questionnaire)


def _is_brought(questionnaire: Questionnaire) -> bool:
    instrument = questionnaire.instrument
    return instrument is not None and all(item.text for item in instrument.items)


def _words(questionnaire: Questionnaire) -> Iterator[str]:
    for item in questionnaire.items:
        yield from (item.text, item.low, item.high, *item.labels)


def text_files(design: Design, folder: Path) -> list[str]:
    """Translations, and words of instruments that AVR Gym may not bring, as far as a design takes them from a folder.

    Names are relative to the folder, with ``/``.
    """
    used = dict.fromkeys(each.use for each in design.questionnaires if each.use)
    names = [f"{TEXTS_FOLDER}/{language}.toml" for language in design.languages]
    names += [f"{INSTRUMENTS}/{name}.toml" for name in used]
    return [name for name in names if (folder / name).is_file()]
