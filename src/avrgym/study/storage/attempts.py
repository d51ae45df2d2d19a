"""Attempts at trials: each has one recording, and completes its trial or is followed by another attempt."""

import hashlib
import math
import os
from pathlib import Path

import msgspec
import sqlalchemy as sa

from avrgym.recording import answers_file
from avrgym.recording.reader import RecordingError, read_recording
from avrgym.recording.schema import ATTEMPT_ENDS, AttemptEnd, Metrics
from avrgym.recording.writer import end_cut_recording
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.answers import QUESTIONNAIRE_OPEN, reconcile_answers, unanswered_items
from avrgym.study.storage.rows import StudySession, Trial, TrialAttempt
from avrgym.study.storage.schema import now
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import (
    Store,
    change_state,
    find,
    find_all,
    find_open_session,
    find_running_attempt,
    find_session,
    find_trial,
    record_event,
    subject_of,
)
from avrgym.system.files import make_private_folder

INCOMPLETE_ENDS: tuple[AttemptEnd, ...] = tuple(end for end in ATTEMPT_ENDS if end != "completed")
"""End states of attempts that do not complete their trial."""
NO_METRICS = Metrics()
"""Metrics of an attempt without results."""
CHECKSUM_DIFFERS = "was changed: its checksum differs"
"""Fault of a recording that changed after the end of its attempt."""


def begin_attempt(
    store: Store,
    session_id: int,
    position: int,
    recording: Path | None = None,
    *,
    torso_height_m: float | None = None,
) -> TrialAttempt:
    """Begin the next attempt at a trial.

    Args:
        store: the study.
        session_id: an open session.
        position: the position of a planned or skipped trial.
        recording: the opened file in the session's folder; default: the next free name. The folder is created, the
            file is not.
        torso_height_m: the torso height of the simulated body, if it is known.

    Raises:
        StudyError: when another attempt runs in the session, or the file is in another folder.
    """
    with store.database.write() as connection:
        session = find_open_session(connection, session_id)
        trial = find_trial(connection, session, position)
        change_state(connection, trial, "running", subject_of(session))
        _check_idle(connection, session)
        number = len(find_all(connection, TrialAttempt, trial=trial.id)) + 1
        name = _name(store, session, recording) if recording else _free_name(store, session, trial, number)
        attempt = hash_chain.insert(
            connection,
            schema.ATTEMPT,
            trial=trial.id,
            session=session.id,
            number=number,
            state="running",
            recording=name,
            metrics={},
            torso_height_m=torso_height_m,
            started_at=now(),
        )
        record_event(connection, "attempt running", name, {**subject_of(session), "attempt": attempt})
        return find(connection, TrialAttempt, "attempt", id=attempt)


def complete_attempt(store: Store, attempt_id: int, metrics: Metrics) -> None:
    """Complete an attempt and its trial after its recording was closed. Its questionnaire may still be open.

    Args:
        store: the study.
        attempt_id: a running attempt.
        metrics: its results.

    Raises:
        StudyError: unless it is running and has a recording.
    """
    with store.database.write() as connection:
        attempt = find_running_attempt(connection, attempt_id)
        if not store.path(attempt.recording).is_file():
            raise StudyError(f"{attempt} cannot be completed: {attempt.recording} is missing")
        finish_attempt(store, connection, attempt, "completed", metrics)


def end_attempt(store: Store, attempt_id: int, state: AttemptEnd, metrics: Metrics = NO_METRICS) -> None:
    """End an attempt in a state of ``INCOMPLETE_ENDS``; its trial is planned again.

    Raises:
        StudyError: unless the attempt is running, or for another state.
    """
    if state not in INCOMPLETE_ENDS:
        raise StudyError(
            f"{state!r} is not an end state of an incomplete attempt; allowed: {', '.join(INCOMPLETE_ENDS)}"
        )
    with store.database.write() as connection:
        finish_attempt(store, connection, find_running_attempt(connection, attempt_id), state, metrics)


def finish_attempt(
    store: Store,
    connection: sa.Connection,
    attempt: TrialAttempt,
    after: AttemptEnd,
    metrics: Metrics,
    *,
    closed: bool = True,
) -> None:
    """End an attempt within a transaction; its trial is completed or planned again.

    ``closed``: nobody writes the recording any more, and its checksum is stored.
    """
    trial = find(connection, Trial, "trial", id=attempt.trial)
    session = find_session(connection, attempt.session)
    event = {**subject_of(session), "attempt": attempt.id}
    ended = {
        "ended_at": now(),
        "sha256": sha256_of(store, attempt.recording) if closed else None,
        "metrics": _finite(metrics),
    }
    change_state(connection, attempt, after, event, attempt.recording, **ended)
    change_state(connection, trial, "completed" if after == "completed" else "planned", event)
    missing = unanswered_items(store, connection, attempt) if after == "completed" else []
    if missing:
        record_event(connection, QUESTIONNAIRE_OPEN, ", ".join(missing), event)


def finished_metrics(
    store: Store, connection: sa.Connection, attempt: TrialAttempt, *, writer_ended: bool
) -> Metrics | None:
    """The metrics of an attempt if the robot had finished before the program ended, else ``None``.

    Answers are copied between recording and database until both contain the same. ``writer_ended``: nobody writes the
    recording any more; a truncated recording is completed.

    Raises:
        StudyError: when the recording or its answers cannot be completed on this disk.
    """
    path = store.path(attempt.recording)
    if not path.is_file():
        return None
    try:
        if writer_ended:
            end_cut_recording(path)
        recording = read_recording(path)
        if not (recording.complete and recording.result == "completed"):
            return None
        answers = [answer for _, answer in recording.topics["/answers"]]
        for answer in reconcile_answers(store, connection, attempt, answers):
            answers_file.append_answer(path, answer)
    except RecordingError:
        return None
    except OSError as error:
        raise StudyError(
            f"{attempt.recording} cannot be completed: {error}. Repair the cause and begin again"
        ) from error
    return recording.metrics


def sha256_of(store: Store, recording: str) -> str | None:
    """The checksum of a recording, if it exists."""
    path = store.path(recording)
    if not path.is_file():
        return None
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _finite(metrics: Metrics) -> dict[str, bool | int | float]:
    """Metrics as stored values; ``StudyError`` for values that are not finite."""
    values = msgspec.to_builtins(metrics)
    for name, value in values.items():
        if not math.isfinite(value):
            raise StudyError(f"{name} is {value!r}; allowed: finite numbers, true and false")
    return values


def _check_idle(connection: sa.Connection, session: StudySession) -> None:
    running = find_all(connection, TrialAttempt, session=session.id, state="running")
    if running:
        raise StudyError(f"{running[0]} is running; end it before another begins")


def _name(store: Store, session: StudySession, recording: Path) -> str:
    """The path, relative to the study, of a file that was opened for an attempt."""
    folder = store.path(session.folder)
    if recording.resolve().parent != folder.resolve() or not recording.is_file():
        raise StudyError(
            f"{recording} is not a file in {folder}; allowed: files in this folder of the session"
        )
    return f"{session.folder}/{recording.name}"


def _free_name(store: Store, session: StudySession, trial: Trial, number: int) -> str:
    """The first free name from this attempt number on."""
    make_private_folder(store.path(session.folder))
    while True:
        recording = f"{session.folder}/trial-{trial.position:02}_attempt-{number}.mcap"
        if not os.path.lexists(store.path(recording)):
            return recording
        number += 1
