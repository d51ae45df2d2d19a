"""Start and end attempts at trials. Each attempt has one recording. An incomplete attempt is repeated."""

import hashlib
import math
import os
from pathlib import Path

import msgspec
import sqlalchemy as sa

from avrgym.recording import answers_file
from avrgym.recording.input_profile import InputProfile
from avrgym.recording.reader import RecordingError, read_recording
from avrgym.recording.schema import ATTEMPT_ENDS, AttemptEnd, Metrics
from avrgym.recording.writer import complete_truncated_recording
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.answers import OPEN_QUESTIONNAIRE_EVENT, find_unanswered_items, reconcile_answers
from avrgym.study.storage.database_rows import StudySession, Trial, TrialAttempt
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import (
    StudyStore,
    change_state,
    find_open_session,
    find_row,
    find_rows,
    find_running_attempt,
    find_session,
    find_trial,
    make_event_subject,
    record_event,
)
from avrgym.system.files import make_private_folder

INCOMPLETE_END_STATES: tuple[AttemptEnd, ...] = tuple(end for end in ATTEMPT_ENDS if end != "completed")
"""End states of attempts that did not complete their trial."""
EMPTY_METRICS = Metrics()
"""Metrics of an attempt that has no results."""
CHECKSUM_MISMATCH_MESSAGE = "was changed: its checksum differs"
"""Error message for a recording that changed after the end of its attempt."""


def begin_attempt(
    store: StudyStore,
    session_id: int,
    position: int,
    recording: Path | None = None,
    *,
    torso_height_m: float | None = None,
    input_profile: InputProfile | None = None,
) -> TrialAttempt:
    """Start the next attempt at a trial. Returns the stored attempt.

    Args:
        store: the study.
        session_id: id of an open session.
        position: position of a planned or skipped trial in the participant's trial order.
        recording: an existing file in the session's folder; default: the next free file name. A missing folder is
            created; the file is not created.
        torso_height_m: torso height of the simulated body, if known.
        input_profile: the participant's input devices and actions, if known.

    Raises:
        StudyError: if another attempt is running in the session, or if the file is in another folder.
    """
    with store.database.write_transaction() as connection:
        session = find_open_session(connection, session_id)
        trial = find_trial(connection, session, position)
        change_state(connection, trial, "running", make_event_subject(session))
        _check_idle(connection, session)
        number = len(find_rows(connection, TrialAttempt, trial=trial.id)) + 1
        name = _name(store, session, recording) if recording else _free_name(store, session, trial, number)
        attempt = hash_chain.insert_row(
            connection,
            schema.ATTEMPT_TABLE,
            trial=trial.id,
            session=session.id,
            number=number,
            state="running",
            recording=name,
            metrics={},
            torso_height_m=torso_height_m,
            input_profile=None if input_profile is None else msgspec.to_builtins(input_profile),
            started_at=make_utc_timestamp(),
        )
        record_event(connection, "attempt running", name, {**make_event_subject(session), "attempt": attempt})
        return find_row(connection, TrialAttempt, "attempt", id=attempt)


def complete_attempt(store: StudyStore, attempt_id: int, metrics: Metrics) -> None:
    """Store that an attempt completed its trial. The recording must be closed. Answers may still be missing.

    Args:
        store: the study.
        attempt_id: a running attempt.
        metrics: metrics of the attempt.

    Raises:
        StudyError: if the attempt is not running or has no recording.
    """
    with store.database.write_transaction() as connection:
        attempt = find_running_attempt(connection, attempt_id)
        if not store.resolve_path(attempt.recording).is_file():
            raise StudyError(
                f"{attempt} cannot be completed: {attempt.recording} is missing; restore the file"
            )
        store_attempt_end(store, connection, attempt, "completed", metrics)


def end_incomplete_attempt(
    store: StudyStore, attempt_id: int, state: AttemptEnd, metrics: Metrics = EMPTY_METRICS
) -> None:
    """End an incomplete attempt. Its trial becomes planned again.

    Args:
        store: the study.
        attempt_id: a running attempt.
        state: one of ``INCOMPLETE_END_STATES``.
        metrics: metrics of the attempt.

    Raises:
        StudyError: for another state, or if the attempt is not running.
    """
    if state not in INCOMPLETE_END_STATES:
        raise StudyError(
            f"{state!r} is not an end state of an incomplete attempt; allowed: {', '.join(INCOMPLETE_END_STATES)}"
        )
    with store.database.write_transaction() as connection:
        store_attempt_end(store, connection, find_running_attempt(connection, attempt_id), state, metrics)


def store_attempt_end(
    store: StudyStore,
    connection: sa.Connection,
    attempt: TrialAttempt,
    after: AttemptEnd,
    metrics: Metrics,
    *,
    closed: bool = True,
) -> None:
    """Store the end of an attempt within a transaction. Its trial becomes completed or planned again.

    ``after``: the attempt's new state. ``closed``: the recording is closed, so its checksum is stored.
    """
    trial = find_row(connection, Trial, "trial", id=attempt.trial)
    session = find_session(connection, attempt.session)
    event = {**make_event_subject(session), "attempt": attempt.id}
    ended = {
        "ended_at": make_utc_timestamp(),
        "sha256": compute_recording_sha256(store, attempt.recording) if closed else None,
        "metrics": _finite(metrics),
    }
    change_state(connection, attempt, after, event, attempt.recording, **ended)
    change_state(connection, trial, "completed" if after == "completed" else "planned", event)
    missing = find_unanswered_items(store, connection, attempt) if after == "completed" else []
    if missing:
        record_event(connection, OPEN_QUESTIONNAIRE_EVENT, ", ".join(missing), event)


def recover_attempt_metrics(
    store: StudyStore, connection: sa.Connection, attempt: TrialAttempt, *, writer_ended: bool
) -> Metrics | None:
    """Returns the metrics of an attempt after a crash; ``None`` if the robot had not finished.

    Missing answers are copied from the recording to the database, and from the database to the recording.
    ``writer_ended``: no process writes the recording, so a truncated recording is completed.

    Raises:
        StudyError: if the recording or its answers cannot be written.
    """
    path = store.resolve_path(attempt.recording)
    if not path.is_file():
        return None
    try:
        if writer_ended:
            complete_truncated_recording(path)
        recording = read_recording(path)
        if not (recording.is_complete and recording.result == "completed"):
            return None
        answers = [answer for _, answer in recording.messages_by_topic["/answers"]]
        for answer in reconcile_answers(store, connection, attempt, answers):
            answers_file.append_answer(path, answer)
    except RecordingError:
        return None
    except OSError as error:
        raise StudyError(
            f"{attempt.recording} cannot be completed: {error}. Correct this and run the command again"
        ) from error
    return recording.metrics


def compute_recording_sha256(store: StudyStore, recording: str) -> str | None:
    """Returns the SHA-256 of a recording; ``None`` if it does not exist."""
    path = store.resolve_path(recording)
    if not path.is_file():
        return None
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _finite(metrics: Metrics) -> dict[str, bool | int | float]:
    """Returns the metrics as stored values. Raises ``StudyError`` for a value that is not finite."""
    values = msgspec.to_builtins(metrics)
    for name, value in values.items():
        if not math.isfinite(value):
            raise StudyError(f"the metric {name} is {value!r}; allowed: finite numbers, true and false")
    return values


def _check_idle(connection: sa.Connection, session: StudySession) -> None:
    running = find_rows(connection, TrialAttempt, session=session.id, state="running")
    if running:
        raise StudyError(f"the attempt {running[0]} is running; end it before you start another attempt")


def _name(store: StudyStore, session: StudySession, recording: Path) -> str:
    """Returns the path of an attempt's recording, relative to the study's folder."""
    folder = store.resolve_path(session.recordings_folder)
    if recording.resolve().parent != folder.resolve() or not recording.is_file():
        raise StudyError(f"{recording} is not a file in {folder}; allowed: files in the session's folder")
    return f"{session.recordings_folder}/{recording.name}"


def _free_name(store: StudyStore, session: StudySession, trial: Trial, number: int) -> str:
    """Returns the first unused path for a recording, with attempt number ``number`` or higher."""
    make_private_folder(store.resolve_path(session.recordings_folder))
    while True:
        recording = f"{session.recordings_folder}/trial-{trial.position:02}_attempt-{number}.mcap"
        if not os.path.lexists(store.resolve_path(recording)):
            return recording
        number += 1
