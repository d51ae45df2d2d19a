"""Store answers to questionnaires. If an answer is changed, an event contains the earlier value."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import sqlalchemy as sa
from msgspec.structs import asdict

from avrgym.commands.respondents import CAREGIVER_RESPONDENT
from avrgym.questionnaires.questionnaire import SESSION_QUESTION_MOMENTS, Item, validate_answer
from avrgym.recording.schema import Answer
from avrgym.study.design.design import Design
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database_rows import (
    Participant,
    StudyAnswer,
    StudyEvent,
    StudySession,
    Trial,
    TrialAttempt,
    format_pseudonym,
)
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import (
    StudyStore,
    find_open_session,
    find_row,
    find_rows,
    find_running_attempt,
    find_session,
    make_event_subject,
    record_event,
)

ANSWER_CHANGED_EVENT = "answer changed"
"""Name of the event for a changed answer. Its detail contains the item and both values."""
AFTER_BREAK_MOMENT = "after_break"
"""The moment after a break. A participant may answer its items several times in a session."""
SESSION_ANSWER_EVENT_PREFIX = "answered"
"""First word of the event name for an answer about a session; the second word is the moment. Detail: the item."""
OPEN_QUESTIONNAIRE_EVENT, SKIPPED_QUESTIONNAIRE_EVENT = "questionnaire open", "questionnaire left"
"""Names of the events for a completed trial with unanswered items, and for items that the experimenter skipped."""


def record_trial_answer(store: StudyStore, attempt_id: int, answer: Answer) -> None:
    """Store an answer to an item after a trial.

    Raises:
        StudyError: for an invalid or second answer. Also if the attempt is not running and has no open questionnaire.
    """
    with store.database.write_transaction() as connection:
        attempt = _find_answerable(connection, attempt_id)
        given = find_rows(connection, StudyAnswer, attempt=attempt.id)
        items = store.design.list_items_at_moment("after_trial")
        about = {"session": attempt.session, "attempt": attempt.id}
        _insert_answer(connection, items, given, answer, about)


def change_trial_answer(store: StudyStore, attempt_id: int, answer: Answer) -> None:
    """Replace the answer to an item. An event contains the earlier value.

    Raises:
        StudyError: for an invalid answer, or if the item was not answered. Also if the attempt is not running and had
            no open questionnaire.
    """
    with store.database.write_transaction() as connection:
        attempt = _find_answerable(connection, attempt_id)
        given = find_rows(connection, StudyAnswer, attempt=attempt.id)
        event = {"session": attempt.session, "attempt": attempt.id}
        _change(connection, store.design.list_items_at_moment("after_trial"), given, answer, event)


def change_session_answer(store: StudyStore, session_id: int, answer: Answer, when: str) -> None:
    """Replace the answer to an item about a session. An event contains the earlier value.

    ``when``: the moment of the answer, one of ``QUESTION_MOMENTS``. Raises the errors of ``change_trial_answer``.
    """
    with store.database.write_transaction() as connection:
        session = find_open_session(connection, session_id)
        answers = find_rows(connection, StudyAnswer, session=session.id, attempt=None)
        moments = find_answer_moments(
            store.design, answers, find_rows(connection, StudyEvent, session=session.id)
        )
        given = [each for each in answers if moments[each.id] == when]
        _change(
            connection, store.design.list_items_at_moment(when), given, answer, make_event_subject(session)
        )


def record_session_answer(
    store: StudyStore, session_id: int, answer: Answer, when: str | None = None
) -> None:
    """Store an answer to an item before or after a session, or after a break.

    ``when``: the moment, one of ``QUESTION_MOMENTS``; required if the item is shown at several moments.

    Raises:
        StudyError: for an invalid or second answer, or if the session is not open.
    """
    moment = when or _only_moment(store.design, answer.item)
    with store.database.write_transaction() as connection:
        session = find_open_session(connection, session_id)
        answers = find_rows(connection, StudyAnswer, session=session.id, attempt=None)
        moments = find_answer_moments(
            store.design, answers, find_rows(connection, StudyEvent, session=session.id)
        )
        given = [each for each in answers if moments[each.id] == moment and moment != AFTER_BREAK_MOMENT]
        _insert_answer(
            connection, store.design.list_items_at_moment(moment), given, answer, {"session": session.id}
        )
        record_event(
            connection, f"{SESSION_ANSWER_EVENT_PREFIX} {moment}", answer.item, make_event_subject(session)
        )


def read_caregiver_answers(store: StudyStore, session_id: int) -> dict[str, int]:
    """Returns the caregiver's answers (option numbers from 1) to the questions for caregivers about a session, by item
    id.
    """
    with store.database.read_transaction() as connection:
        given = find_rows(
            connection, StudyAnswer, session=session_id, attempt=None, respondent=CAREGIVER_RESPONDENT
        )
    return {each.item: each.value for each in given}


def record_caregiver_answer(store: StudyStore, session_id: int, answer: Answer) -> None:
    """Store or change a caregiver's answer to a question for caregivers. The session may have ended.

    Raises:
        StudyError: for an invalid answer, or an unknown session.
    """
    items = store.design.list_items_at_moment(CAREGIVER_RESPONDENT)
    with store.database.write_transaction() as connection:
        session = find_session(connection, session_id)
        given = find_rows(
            connection, StudyAnswer, session=session.id, attempt=None, respondent=CAREGIVER_RESPONDENT
        )
        if any(each.item == answer.item for each in given):
            _change(connection, items, given, answer, make_event_subject(session))
        else:
            _insert_answer(connection, items, given, answer, {"session": session.id}, CAREGIVER_RESPONDENT)


def find_answer_moments(
    design: Design, answers: Iterable[StudyAnswer], events: Iterable[StudyEvent]
) -> dict[int, str]:
    """Returns the moment (one of ``QUESTION_MOMENTS``) of each answer, by the answer's id.

    ``answers`` and ``events`` must be in the order of storage. The event of an answer about a session contains its
    moment. Studies of earlier AVR Gym versions lack these events; the design then determines the moment.
    """
    of_events: dict[tuple[int | None, str], list[str]] = {}
    for event in events:
        if event.name.startswith(f"{SESSION_ANSWER_EVENT_PREFIX} "):
            of_events.setdefault((event.session, event.detail), []).append(
                event.name.removeprefix(f"{SESSION_ANSWER_EVENT_PREFIX} ")
            )
    moments: dict[int, str] = {}
    for answer in reversed(list(answers)):
        if answer.attempt is not None:
            moments[answer.id] = "after_trial"
        elif answer.respondent == CAREGIVER_RESPONDENT:
            moments[answer.id] = CAREGIVER_RESPONDENT
        else:
            own = of_events.get((answer.session, answer.item))
            moments[answer.id] = own.pop() if own else _only_moment(design, answer.item)
    return moments


def find_session_ids_of_visit(sessions: Sequence[StudySession], session_id: int) -> list[int]:
    """Returns the ids of the sessions in a visit: a session, and the interrupted sessions directly before it.

    ``sessions``: all sessions of a participant, in order.
    """
    ids: list[int] = []
    for session in sessions:
        ids.append(session.id)
        if session.id == session_id:
            break
        if session.state != "interrupted":
            ids.clear()
    return ids


def reconcile_answers(
    store: StudyStore, connection: sa.Connection, attempt: TrialAttempt, recorded: Sequence[Answer]
) -> list[Answer]:
    """Store recorded answers that the database lacks. Returns stored answers that the recording lacks.

    For each item, the source with more answers is newer, because answers are only added or changed.
    """
    items, event = (
        store.design.list_items_at_moment("after_trial"),
        {"session": attempt.session, "attempt": attempt.id},
    )
    before = find_rows(connection, StudyAnswer, attempt=attempt.id)
    counts = {each.item: 1 + _changes(connection, attempt, each.item) for each in before}
    for number, answer in enumerate(recorded):
        earlier = sum(each.item == answer.item for each in recorded[:number])
        given = find_rows(connection, StudyAnswer, attempt=attempt.id)
        if earlier >= counts.get(answer.item, 0):
            change = _change if any(each.item == answer.item for each in given) else _insert_answer
            change(connection, items, given, answer, event)
    recorded_counts = Counter(answer.item for answer in recorded)
    return [
        Answer(each.item, each.value, each.response_time_s)
        for each in before
        if counts[each.item] > recorded_counts[each.item]
    ]


def _changes(connection: sa.Connection, attempt: TrialAttempt, item: str) -> int:
    changed = find_rows(connection, StudyEvent, attempt=attempt.id, name=ANSWER_CHANGED_EVENT)
    return sum(event.detail.startswith(f"{item} from ") for event in changed)


def find_items_answered_in_visit(store: StudyStore, session: StudySession) -> set[tuple[str, str]]:
    """Returns moment and item of each answer about a session in the session's visit."""
    pseudonym = format_pseudonym(session.participant)
    visit = find_session_ids_of_visit(store.read_sessions(pseudonym), session.id)
    answers = [
        answer
        for answer in store.read_answers(pseudonym)
        if answer.attempt is None and answer.session in visit
    ]
    moments = find_answer_moments(store.design, answers, store.read_session_events(pseudonym))
    return {(moments[answer.id], answer.item) for answer in answers}


def _only_moment(design: Design, item_id: str) -> str:
    """Returns the moment of an item about a session. If the item has two moments, it is the first one."""
    questionnaire = design.find_item_questionnaire(item_id)
    moments = questionnaire.moments if questionnaire else ()
    return next(
        (moment for moment in SESSION_QUESTION_MOMENTS if moment in moments), SESSION_QUESTION_MOMENTS[-1]
    )


def find_attempts_with_open_questionnaire(
    store: StudyStore, attempts: Iterable[TrialAttempt]
) -> list[TrialAttempt]:
    """Returns the attempts with an open questionnaire, as defined by ``has_open_questionnaire``."""
    with store.database.read_transaction() as connection:
        return [attempt for attempt in attempts if has_open_questionnaire(store, connection, attempt)]


def has_open_questionnaire(store: StudyStore, connection: sa.Connection, attempt: TrialAttempt) -> bool:
    """Returns whether an attempt completed its trial, but has unanswered items that were not skipped."""
    names = _events_of(connection, attempt.id) if attempt.state == "completed" else set[str]()
    return (
        OPEN_QUESTIONNAIRE_EVENT in names
        and SKIPPED_QUESTIONNAIRE_EVENT not in names
        and bool(find_unanswered_items(store, connection, attempt))
    )


def skip_questionnaire(store: StudyStore, attempt_id: int, items: Sequence[str]) -> None:
    """Store that the experimenter skipped items of an attempt. ``items``: ids of the items."""
    with store.database.write_transaction() as connection:
        attempt = _find_answerable(connection, attempt_id)
        record_event(
            connection,
            SKIPPED_QUESTIONNAIRE_EVENT,
            ", ".join(items),
            {"session": attempt.session, "attempt": attempt.id},
        )


def had_open_questionnaire(connection: sa.Connection, attempt: TrialAttempt) -> bool:
    """Returns whether an attempt had unanswered items when it completed its trial."""
    return OPEN_QUESTIONNAIRE_EVENT in _events_of(connection, attempt.id)


def _find_answerable(connection: sa.Connection, attempt_id: int) -> TrialAttempt:
    """Returns an attempt that is running, or that completed its trial with unanswered items."""
    found = find_row(connection, TrialAttempt, f"attempt {attempt_id}", id=attempt_id)
    if found.state == "completed" and had_open_questionnaire(connection, found):
        return found
    return find_running_attempt(connection, attempt_id)


def _events_of(connection: sa.Connection, attempt_id: int) -> set[str]:
    return {event.name for event in find_rows(connection, StudyEvent, attempt=attempt_id)}


def find_unanswered_items(store: StudyStore, connection: sa.Connection, attempt: TrialAttempt) -> list[str]:
    """Returns the ids of the unanswered items of an attempt; empty for practice trials."""
    trial = find_row(connection, Trial, "trial", id=attempt.trial)
    if trial.practice:
        return []
    given = {answer.item for answer in find_rows(connection, StudyAnswer, attempt=attempt.id)}
    return [item.id for item in store.design.list_items_at_moment("after_trial") if item.id not in given]


def _change(
    connection: sa.Connection,
    items: tuple[Item, ...],
    given: list[StudyAnswer],
    answer: Answer,
    event: dict[str, int],
) -> None:
    _check(items, answer)
    earlier = next((each for each in given if each.item == answer.item), None)
    if earlier is None:
        raise StudyError(f"{answer.item} has no answer; only an existing answer can be changed")
    changed: dict[str, Any] = {
        "value": answer.value,
        "response_time_s": answer.response_time_s,
        "answered_at": make_utc_timestamp(),
    }
    if earlier.respondent != CAREGIVER_RESPONDENT:
        changed["respondent"] = _respondent(connection, earlier.session)
    hash_chain.update_row(connection, schema.ANSWER_TABLE, earlier.id, **changed)
    record_event(
        connection, ANSWER_CHANGED_EVENT, f"{answer.item} from {earlier.value} to {answer.value}", event
    )


def _insert_answer(
    connection: sa.Connection,
    items: tuple[Item, ...],
    given: list[StudyAnswer],
    answer: Answer,
    about: Mapping[str, int],
    respondent: str | None = None,
) -> None:
    """Store an answer. ``respondent``: by default, the person who answers for the participant.

    Raises ``StudyError`` for an invalid or second answer.
    """
    _check(items, answer)
    if any(earlier.item == answer.item for earlier in given):
        raise StudyError(f"{answer.item} is answered already; the participant can go back and change it")
    values = asdict(answer) | {
        "answered_at": make_utc_timestamp(),
        "respondent": respondent or _respondent(connection, about["session"]),
    }
    hash_chain.insert_row(connection, schema.ANSWER_TABLE, **values, **about)


def _respondent(connection: sa.Connection, session_id: int) -> str | None:
    """Returns the respondent of a session's participant; ``None`` if the participant answers."""
    session = find_row(connection, StudySession, f"session {session_id}", id=session_id)
    return find_row(connection, Participant, "participant", number=session.participant).respondent


def _check(items: tuple[Item, ...], answer: Answer) -> None:
    """Raises ``StudyError`` unless the answer is valid for one of the items."""
    try:
        validate_answer(items, answer.item, answer.value)
    except ValueError as error:
        raise StudyError(str(error)) from None
    if not 0 <= answer.response_time_s < math.inf:
        raise StudyError(f"the response time is {answer.response_time_s!r} s; allowed: 0 s or more")
