"""Store a participant's answers about functioning (disability), diagnosis and assistive devices."""

import msgspec

from avrgym.study.design.functioning import (
    ASSISTIVE_DEVICES,
    DECLINED_ANSWER,
    DIFFICULTY_LEVELS,
    FUNCTIONING_QUESTIONS,
    NONE_ANSWER,
)
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.free_text import check_single_line
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_participant, record_event


class FunctioningAnswers(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A participant's answers: a level for each question, numbers of device classes, and a diagnosis as free text."""

    levels: dict[str, str]
    devices: tuple[str, ...] = ()
    diagnosis: str = ""


def record_functioning_answers(store: StudyStore, pseudonym: str, answers: FunctioningAnswers) -> None:
    """Store a participant's answers. They replace earlier answers.

    Raises:
        StudyError: if the design has no questions about functioning, before consent, for a simulated participant, or
            for an invalid answer.
    """
    if not store.design.ask_functioning:
        raise StudyError(
            "the study has no questions about functioning; set ask_functioning = true in study.toml"
        )
    _check(answers)
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        if participant.simulated:
            raise StudyError(f"{pseudonym} is a simulated participant; allowed: a person")
        if participant.consented_at is None:
            raise StudyError(f"{pseudonym} has not consented; record the consent first")
        given = msgspec.to_builtins(answers)
        hash_chain.update_row(connection, schema.PARTICIPANT_TABLE, participant.number, functioning=given)
        record_event(connection, "functioning recorded", "", {"participant": participant.number})


def _check(answers: FunctioningAnswers) -> None:
    if set(answers.levels) != set(FUNCTIONING_QUESTIONS):
        raise StudyError(
            f"each question needs an answer or {DECLINED_ANSWER!r}; the questions are "
            f"{', '.join(FUNCTIONING_QUESTIONS)}"
        )
    for question, level in answers.levels.items():
        if level not in DIFFICULTY_LEVELS:
            raise StudyError(f"{question} is {level!r}; allowed: {', '.join(DIFFICULTY_LEVELS)}")
    for device in answers.devices:
        if device not in ASSISTIVE_DEVICES:
            raise StudyError(f"unknown device class {device!r}; allowed: {', '.join(ASSISTIVE_DEVICES)}")
    alone = {NONE_ANSWER, DECLINED_ANSWER} & set(answers.devices)
    if alone and len(answers.devices) > 1:
        answer = alone.pop()
        raise StudyError(
            f"devices contains {answer!r} and other answers; allowed: only {answer!r}, or one or more device classes"
        )
    check_single_line("the diagnosis", answers.diagnosis)
