"""Answers: what counts as one, and that none is ever replaced."""

import math
from collections.abc import Mapping

import sqlalchemy as sa

from avrgym.study import ledger, schema
from avrgym.study.questionnaire import Item, validate_answer
from avrgym.study.rows import GivenAnswer, Trial, TrialAttempt
from avrgym.study.schema import now
from avrgym.study.states import StudyError
from avrgym.study.store import Store, find, find_all, find_open_session, find_running_attempt


def record_answer(store: Store, attempt_id: int, item_id: str, value: int, response_time_s: float) -> None:
    """Store one answer to an item that is asked after a trial.

    Raises:
        StudyError: unless the attempt runs, or for an answer that is none or was given already.
    """
    with store.database.write() as connection:
        attempt = find_running_attempt(connection, attempt_id)
        given = find_all(connection, GivenAnswer, attempt=attempt.id)
        items = store.design.items_at("after_trial")
        about = {"session": attempt.session, "attempt": attempt.id}
        _insert_answer(connection, items, given, (item_id, value, response_time_s), about)


def record_session_answer(
    store: Store, session_id: int, item_id: str, value: int, response_time_s: float
) -> None:
    """Store one answer to an item that is asked before or after a session.

    Raises:
        StudyError: unless the session is open, or for an answer that is none or was given already.
    """
    items = (*store.design.items_at("before_session"), *store.design.items_at("after_session"))
    with store.database.write() as connection:
        session = find_open_session(connection, session_id)
        given = find_all(connection, GivenAnswer, session=session.id, attempt=None)
        _insert_answer(connection, items, given, (item_id, value, response_time_s), {"session": session.id})


def unanswered(store: Store, connection: sa.Connection, attempt: TrialAttempt) -> list[str]:
    """The items that are still to be answered before an attempt completes its trial."""
    trial = find(connection, Trial, "trial", id=attempt.trial)
    if trial.practice:
        return []
    given = {answer.item for answer in find_all(connection, GivenAnswer, attempt=attempt.id)}
    return [item.id for item in store.design.items_at("after_trial") if item.id not in given]


def _insert_answer(
    connection: sa.Connection,
    items: tuple[Item, ...],
    given: list[GivenAnswer],
    answer: tuple[str, int, float],
    about: Mapping[str, int],
) -> None:
    """Store item, value and response time, unless that is no answer or the item was answered before."""
    item, value, response_time_s = answer
    try:
        validate_answer(items, item, value)
    except ValueError as error:
        raise StudyError(str(error)) from None
    if any(earlier.item == item for earlier in given):
        raise StudyError(f"{item} is answered already; an answer is never replaced")
    if not 0 <= response_time_s < math.inf:
        raise StudyError(f"{response_time_s!r} is no response time; allowed: seconds from 0")
    row = {"item": item, "value": value, "response_time_s": response_time_s, "answered_at": now(), **about}
    ledger.insert(connection, schema.ANSWER, **row)
