"""A participant's sessions: trials, attempts, answers, each stored before the session goes on."""

import hashlib
import math
import os
from collections.abc import Mapping

import sqlalchemy as sa

from avrgym.study import schema
from avrgym.study.questionnaire import Item, validate_answer
from avrgym.study.recording import RecordingError, read_recording
from avrgym.study.rows import Figure, GivenAnswer, Participant, StudySession, Trial, TrialAttempt
from avrgym.study.states import StudyError
from avrgym.study.store import (
    Store,
    change_state,
    find,
    find_all,
    find_participant,
    is_running,
    now,
    record_event,
)

BROKEN_OFF = ("stopped", "interrupted", "failed")
"""How an attempt may end that does not complete its trial."""


def open_session(store: Store, pseudonym: str, *, take_over: bool = False) -> StudySession:
    """Begin a session of a participant at this station.

    What a session that crashed left open is ended first: an attempt whose recording and answers are whole
    completes its trial, any other is kept as interrupted.

    Args:
        store: the study.
        pseudonym: the participant.
        take_over: also end a session that may still run elsewhere.

    Raises:
        StudyError: without consent and an allocated order, or while another session runs.
    """
    with store.database.write() as connection:
        participant = find_participant(connection, pseudonym)
        if participant.state != "allocated" or participant.consented_at is None:
            raise StudyError(f"{participant} is {participant.state}; only the allocated have sessions")
        own = find_all(connection, StudySession, participant=participant.number)
        for session in own:
            if session.state == "open" and not take_over and may_run(store, session):
                raise StudyError(
                    f"{session} is open at {session.station} since {session.opened_at}; close it there, or take over"
                )
        end_open_sessions(store, connection, participant, attempts="interrupted", sessions="interrupted")
        return _insert_session(store, connection, participant, len(own) + 1)


def close_session(store: Store, session_id: int) -> None:
    """End a session; an attempt that runs is kept as interrupted. The last trial completes the participant."""
    with store.database.write() as connection:
        session = find(connection, StudySession, f"session {session_id}", id=session_id)
        _end_session(store, connection, session, attempts="interrupted", after="closed")
        trials = find_all(connection, Trial, participant=session.participant)
        participant = find(connection, Participant, "participant", number=session.participant)
        if participant.state == "allocated" and all(trial.state == "completed" for trial in trials):
            change_state(connection, participant, "completed", {"participant": participant.number})


def begin_attempt(store: Store, session_id: int, position: int) -> TrialAttempt:
    """Begin the next attempt at a trial by its position; its recording's folder is made, the file is not.

    Raises:
        StudyError: unless the session is open, the trial is planned or skipped, and nothing else runs.
    """
    with store.database.write() as connection:
        session = _open_session(connection, session_id)
        trial = _trial_at(connection, session, position)
        earlier = find_all(connection, TrialAttempt, trial=trial.id)
        about = _about(session)
        change_state(connection, trial, "running", about)
        _check_idle(connection, session)
        number, recording = _free_recording(store, session, trial, len(earlier) + 1)
        row = {
            "trial": trial.id,
            "session": session.id,
            "number": number,
            "state": "running",
            "recording": recording,
            "figures": {},
            "started_at": now(),
        }
        inserted = connection.execute(sa.insert(schema.ATTEMPT).values(row)).inserted_primary_key
        assert inserted is not None
        record_event(connection, "attempt running", recording, {**about, "attempt": inserted[0]})
        return find(connection, TrialAttempt, "attempt", id=inserted[0])


def record_answer(store: Store, attempt_id: int, item_id: str, value: int, response_time_s: float) -> None:
    """Store one answer to an item that is asked after a trial.

    Raises:
        StudyError: unless the attempt runs, or for an answer that is none or was given already.
    """
    with store.database.write() as connection:
        attempt = _running(connection, attempt_id)
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
        session = _open_session(connection, session_id)
        given = find_all(connection, GivenAnswer, session=session.id, attempt=None)
        _insert_answer(connection, items, given, (item_id, value, response_time_s), {"session": session.id})


def complete_attempt(store: Store, attempt_id: int, figures: Mapping[str, Figure]) -> None:
    """Complete a trial: its recording is closed, its questionnaire answered.

    Args:
        store: the study.
        attempt_id: the attempt that runs.
        figures: what it gave, such as steps, reward and success.

    Raises:
        StudyError: unless it runs, has its recording and, but for practice, all answers.
    """
    with store.database.write() as connection:
        attempt = _running(connection, attempt_id)
        missing = _unanswered(store, connection, attempt)
        if missing:
            raise StudyError(f"{attempt} is not complete: {', '.join(missing)} not answered")
        if not store.path(attempt.recording).is_file():
            raise StudyError(f"{attempt} is not complete: there is no {attempt.recording}")
        _end_attempt(store, connection, attempt, "completed", figures)


def end_attempt(
    store: Store, attempt_id: int, state: str, figures: Mapping[str, Figure] | None = None
) -> None:
    """End an attempt that does not complete its trial: stopped, interrupted or failed; the trial is repeated.

    Raises:
        StudyError: unless the attempt runs, or for another state.
    """
    if state not in BROKEN_OFF:
        raise StudyError(f"an attempt does not break off as {state!r}; allowed: {', '.join(BROKEN_OFF)}")
    with store.database.write() as connection:
        _end_attempt(store, connection, _running(connection, attempt_id), state, figures or {})


def skip_trial(store: Store, session_id: int, position: int) -> None:
    """Put a planned trial behind all others."""
    with store.database.write() as connection:
        session = _open_session(connection, session_id)
        trial = _trial_at(connection, session, position)
        change_state(connection, trial, "skipped", _about(session), f"trial {position}")


def tell(store: Store, session_id: int, name: str, detail: str = "", attempt_id: int | None = None) -> None:
    """Store anything else that happened in a session, such as a lost connection."""
    with store.database.write() as connection:
        session = find(connection, StudySession, f"session {session_id}", id=session_id)
        attempt = {} if attempt_id is None else {"attempt": attempt_id}
        record_event(connection, name, detail, {**_about(session), **attempt})


def end_open_sessions(
    store: Store, connection: sa.Connection, participant: Participant, *, attempts: str, sessions: str
) -> None:
    """End all of a participant's open sessions within a transaction, and what runs in them, in these states."""
    for session in find_all(connection, StudySession, participant=participant.number, state="open"):
        _end_session(store, connection, session, attempts=attempts, after=sessions)


def may_run(store: Store, session: StudySession) -> bool:
    """Whether the process behind an open session may still run; only of this station's can that be known."""
    return session.station != store.station or is_running(session.process)


def sha256_of(store: Store, recording: str) -> str | None:
    """The checksum of a recording, or ``None`` when there is none."""
    path = store.path(recording)
    if not path.is_file():
        return None
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _insert_session(
    store: Store, connection: sa.Connection, participant: Participant, number: int
) -> StudySession:
    row = {
        "participant": participant.number,
        "number": number,
        "state": "open",
        "station": store.station,
        "process": os.getpid(),
        "opened_at": now(),
    }
    inserted = connection.execute(sa.insert(schema.SESSION).values(row)).inserted_primary_key
    assert inserted is not None
    session = find(connection, StudySession, "session", id=inserted[0])
    record_event(connection, "session open", session.name, _about(session))
    return session


def _end_session(
    store: Store, connection: sa.Connection, session: StudySession, *, attempts: str, after: str
) -> None:
    for attempt in find_all(connection, TrialAttempt, session=session.id, state="running"):
        figures = _whole_figures(store, connection, attempt) if attempts == "interrupted" else None
        if figures is not None:
            _end_attempt(store, connection, attempt, "completed", figures)
        else:
            _end_attempt(store, connection, attempt, attempts, {})
    change_state(connection, session, after, _about(session), closed_at=now())


def _whole_figures(
    store: Store, connection: sa.Connection, attempt: TrialAttempt
) -> dict[str, Figure] | None:
    """The figures of an attempt that only lacked being stored as completed; ``None`` for any other."""
    try:
        recording = read_recording(store.path(attempt.recording))
    except (OSError, RecordingError):
        return None
    outcome = dict(recording.outcome or {})
    finished = recording.complete and outcome.pop("result", None) == "completed"
    return outcome if finished and not _unanswered(store, connection, attempt) else None


def _end_attempt(
    store: Store, connection: sa.Connection, attempt: TrialAttempt, after: str, figures: Mapping[str, Figure]
) -> None:
    trial = find(connection, Trial, "trial", id=attempt.trial)
    session = find(connection, StudySession, "session", id=attempt.session)
    about = {**_about(session), "attempt": attempt.id}
    change_state(
        connection, attempt, after, about, attempt.recording,
        ended_at=now(), sha256=sha256_of(store, attempt.recording), figures=_finite(figures),
    )  # fmt: skip
    change_state(connection, trial, "completed" if after == "completed" else "planned", about)


def _finite(figures: Mapping[str, Figure]) -> dict[str, Figure]:
    for name, value in figures.items():
        if not isinstance(value, bool | int | float) or not math.isfinite(value):
            raise StudyError(f"{name}: {value!r} is no figure; allowed: finite numbers, true and false")
    return dict(figures)


def _unanswered(store: Store, connection: sa.Connection, attempt: TrialAttempt) -> list[str]:
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
    connection.execute(sa.insert(schema.ANSWER).values(row))


def _check_idle(connection: sa.Connection, session: StudySession) -> None:
    running = find_all(connection, TrialAttempt, session=session.id, state="running")
    if running:
        raise StudyError(f"{running[0]} still runs; end it before another begins")


def _free_recording(store: Store, session: StudySession, trial: Trial, number: int) -> tuple[int, str]:
    """The first attempt's number, from the given one, whose file does not exist yet, and that file."""
    store.path(session.folder).mkdir(parents=True, exist_ok=True)
    while True:
        recording = f"{session.folder}/trial-{trial.position:02}_attempt-{number}.mcap"
        if not os.path.lexists(store.path(recording)):
            return number, recording
        number += 1


def _open_session(connection: sa.Connection, session_id: int) -> StudySession:
    session = find(connection, StudySession, f"session {session_id}", id=session_id)
    if session.state != "open":
        raise StudyError(f"{session} is {session.state}; it must be open")
    return session


def _running(connection: sa.Connection, attempt_id: int) -> TrialAttempt:
    attempt = find(connection, TrialAttempt, f"attempt {attempt_id}", id=attempt_id)
    if attempt.state != "running":
        raise StudyError(f"{attempt} is {attempt.state}; it must be running")
    return attempt


def _trial_at(connection: sa.Connection, session: StudySession, position: int) -> Trial:
    return find(connection, Trial, f"trial {position}", participant=session.participant, position=position)


def _about(session: StudySession) -> dict[str, int]:
    return {"participant": session.participant, "session": session.id}
