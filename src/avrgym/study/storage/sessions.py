"""Open and close a participant's sessions at a station, and store their events."""

import os

import msgspec
import sqlalchemy as sa

from avrgym.recording.configuration import HeadsetCheck
from avrgym.recording.schema import AttemptEnd
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.answers import has_open_questionnaire
from avrgym.study.storage.attempts import EMPTY_METRICS, recover_attempt_metrics, store_attempt_end
from avrgym.study.storage.database_rows import Participant, StudySession, Trial, TrialAttempt
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import (
    StudyStore,
    change_state,
    find_open_session,
    find_participant,
    find_row,
    find_rows,
    find_session,
    find_trial,
    make_event_subject,
    record_event,
    store_design,
)
from avrgym.system.processes import is_process_running
from avrgym.vr.headset_check import format_measurements, format_result


def open_session(store: StudyStore, pseudonym: str, *, take_over: bool = False) -> StudySession:
    """Open a session of a participant at this station. Returns the stored session.

    Sessions that a crash left open are ended first. If the robot had finished, the running attempt becomes completed;
    otherwise it becomes interrupted.

    Args:
        store: the study.
        pseudonym: the participant.
        take_over: end an open session, even if another station may still be running it.

    Raises:
        StudyError: if the participant is not allocated, must consent again, or has a running session.
    """
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        if participant.state != "allocated" or participant.consented_at is None:
            raise StudyError(
                f"{participant} is {participant.state}; only allocated participants can have sessions"
            )
        check_consent_version(store, participant)
        own = find_rows(connection, StudySession, participant=participant.number)
        for session in own:
            if session.state == "open" and not take_over and may_be_running(store, session):
                raise StudyError(
                    f"{session} is open at {session.station} since {session.opened_at}; close it at that station first"
                )
        end_open_sessions(store, connection, participant, attempts="interrupted", sessions="interrupted")
        return _insert_session(store, connection, participant, len(own) + 1)


def check_consent_version(store: StudyStore, participant: Participant) -> None:
    """Raises ``StudyError`` if the participant must first agree to the current version of the consent text."""
    present = store.design.consent.version
    if participant.must_reconsent(present):
        raise StudyError(
            f"{participant} agreed to version {participant.consent_version} of the consent text; the current version "
            f"is {present}: re-consent on the dashboard or with `avrgym study consent {store.folder} {participant}`"
        )


def close_session(store: StudyStore, session_id: int) -> None:
    """End a session. A running attempt is interrupted.

    If all trials and questionnaires are completed, the participant becomes completed.
    """
    with store.database.write_transaction() as connection:
        session = find_session(connection, session_id)
        _end_session(store, connection, session, attempts="interrupted", after="closed")
        participant = find_row(connection, Participant, "participant", number=session.participant)
        if participant.state == "allocated" and has_completed_study(store, connection, participant):
            change_state(connection, participant, "completed", {"participant": participant.number})


def has_completed_study(store: StudyStore, connection: sa.Connection, participant: Participant) -> bool:
    """Returns whether a participant has completed all trials and questionnaires."""
    trials = find_rows(connection, Trial, participant=participant.number)
    completed = all(trial.state == "completed" for trial in trials)
    return completed and not _is_any_open(store, connection, trials)


def _is_any_open(store: StudyStore, connection: sa.Connection, trials: list[Trial]) -> bool:
    attempts = [each for trial in trials for each in find_rows(connection, TrialAttempt, trial=trial.id)]
    return any(has_open_questionnaire(store, connection, attempt) for attempt in attempts)


def skip_trial(store: StudyStore, session_id: int, position: int) -> None:
    """Move a planned trial to the end of the participant's remaining trials."""
    with store.database.write_transaction() as connection:
        session = find_open_session(connection, session_id)
        trial = find_trial(connection, session, position)
        change_state(connection, trial, "skipped", make_event_subject(session), f"trial {position}")


def record_session_event(
    store: StudyStore, session_id: int, name: str, detail: str = "", attempt_id: int | None = None
) -> None:
    """Store an event of a session, such as a lost connection."""
    with store.database.write_transaction() as connection:
        session = find_session(connection, session_id)
        event = make_event_subject(session)
        if attempt_id is not None:
            attempt = find_row(
                connection, TrialAttempt, f"attempt {attempt_id}", id=attempt_id, session=session_id
            )
            event["attempt"] = attempt.id
        record_event(connection, name, detail, event)


def store_headset_check(store: StudyStore, session_id: int, check: HeadsetCheck) -> None:
    """Store the result of a headset check in the session's row and as an event. The row has only the latest result."""
    with store.database.write_transaction() as connection:
        session = find_open_session(connection, session_id)
        hash_chain.update_row(
            connection, schema.SESSION_TABLE, session.id, headset_check=msgspec.to_builtins(check)
        )
        detail = f"{format_result(check)} {format_measurements(check)}"
        record_event(connection, "headset checked", detail, make_event_subject(session))


def end_open_sessions(
    store: StudyStore,
    connection: sa.Connection,
    participant: Participant,
    *,
    attempts: AttemptEnd,
    sessions: str,
) -> None:
    """End the open sessions and running attempts of a participant.

    ``sessions`` and ``attempts``: the new states. If ``attempts`` is ``interrupted``, an attempt becomes completed if
    the robot had finished.
    """
    for session in find_rows(connection, StudySession, participant=participant.number, state="open"):
        _end_session(store, connection, session, attempts=attempts, after=sessions)


def may_be_running(store: StudyStore, session: StudySession) -> bool:
    """Returns whether the process of an open session may still be running.

    The result is ``True`` for a process at another station, and ``False`` in a merged study.
    """
    return not store.read_sites() and (
        session.station != store.station_name or is_process_running(session.process_id)
    )


def _insert_session(
    store: StudyStore, connection: sa.Connection, participant: Participant, number: int
) -> StudySession:
    row = {
        "participant": participant.number,
        "number": number,
        "state": "open",
        "station": store.station_name,
        "process_id": os.getpid(),
        "opened_at": make_utc_timestamp(),
    }
    session = find_session(connection, hash_chain.insert_row(connection, schema.SESSION_TABLE, **row))
    record_event(connection, "session open", session.name, make_event_subject(session))
    store_design(store, connection, make_event_subject(session))
    return session


def _end_session(
    store: StudyStore, connection: sa.Connection, session: StudySession, *, attempts: AttemptEnd, after: str
) -> None:
    """End a session and its running attempts.

    A simulated participant repeats an interrupted trial. Results of a dry run therefore depend only on its seeds.
    """
    participant = find_row(connection, Participant, "participant", number=session.participant)
    writer_ended = not participant.simulated and not may_be_running(store, session)
    for attempt in find_rows(connection, TrialAttempt, session=session.id, state="running"):
        closed = attempts == "interrupted"
        metrics = (
            recover_attempt_metrics(store, connection, attempt, writer_ended=writer_ended) if closed else None
        )
        ended = attempts if metrics is None else "completed"
        store_attempt_end(store, connection, attempt, ended, metrics or EMPTY_METRICS, closed=closed)
    change_state(connection, session, after, make_event_subject(session), closed_at=make_utc_timestamp())
