"""Check a study: whether stored data are complete and unchanged, and whether the study can run."""

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from avrgym.questionnaires.questionnaire import SESSION_QUESTION_MOMENTS
from avrgym.recording import answers_file
from avrgym.recording.reader import Recording, RecordingError, read_recording
from avrgym.recording.schema import Metrics
from avrgym.recording.streams import SampleTimes, collect_streams, compute_stream_sample_times
from avrgym.study.checking.consent_checks import check_consents
from avrgym.study.checking.database_checks import check_database, check_private_files
from avrgym.study.checking.design_checks import check_design, check_stored_designs
from avrgym.study.checking.finding import Finding, make_excluded_trial_finding
from avrgym.study.checking.interim_looks import check_interim_looks
from avrgym.study.checking.participation_checks import check_participation
from avrgym.study.checking.plugin_checks import check_plugins
from avrgym.study.checking.policy_files import check_used_policies
from avrgym.study.checking.preflight import check_initial_states, find_policy_errors
from avrgym.study.checking.repeat_checks import check_repeats
from avrgym.study.checking.tracking_loss import describe_excess_tracking_loss
from avrgym.study.design.design import Design
from avrgym.study.people.retention import describe_due_deletions, read_recording_deletion_times, today_utc
from avrgym.study.storage.answers import (
    find_items_answered_in_visit,
    had_open_questionnaire,
    has_open_questionnaire,
)
from avrgym.study.storage.attempts import CHECKSUM_MISMATCH_MESSAGE, compute_recording_sha256
from avrgym.study.storage.database_rows import (
    RECORDINGS_FOLDER,
    Participant,
    StudyAnswer,
    StudyEvent,
    StudySession,
    Trial,
    TrialAttempt,
    format_pseudonym,
)
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.session_designs import read_session_designs
from avrgym.study.storage.sites import OMITTED_RECORDING_EVENT
from avrgym.study.storage.state_transitions import ALLOCATED_STATES, UNKNOWN_PARTICIPATION_STATE, StudyError
from avrgym.study.storage.store import StudyStore, find_rows

_MAX_LISTED = 3
"""Maximum number of clock resets in a message."""


def check_study(store: StudyStore) -> list[Finding]:
    """Returns the findings of all checks of a study. Only recordings in the object store are downloaded."""
    findings: list[Finding] = []
    for check in STUDY_CHECKS:
        try:
            findings += check(store)
        except StudyError as error:  # a damaged row can stop a check
            finding = Finding("database", str(error))
            findings += [finding] if finding not in findings else []
    return findings


def check_object_store(store: StudyStore) -> Iterator[Finding]:
    """Download recordings that are only in the object store. Yields a finding if the object store cannot be used."""
    try:
        fetch_recordings(store)
    except StudyError as error:
        yield Finding("recordings", str(error))


def check_participants(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about missing recordings, missing answers, and differences between recordings and database."""
    for participant in store.read_participants():
        yield from _check_participant(store, participant, store.read_attempts(participant.pseudonym))


def check_orphaned_files(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about files in the recordings folder that belong to no attempt."""
    people = [participant.pseudonym for participant in store.read_participants()]
    recordings = [attempt.recording for person in people for attempt in store.read_attempts(person)]
    gone = {
        format_pseudonym(each.number) for each in store.read_deleted_participants()
    }  # another check reports them
    expected = {*recordings, *(answers_file.get_answers_path(name).as_posix() for name in recordings)}
    return (
        _check_stray(store, name) for name in _files(store) if name not in expected and not _is_of(name, gone)
    )


def _is_of(name: str, pseudonyms: Collection[str]) -> bool:
    """Returns whether the recording with the path ``name`` belongs to one of these participants."""
    return name.split("/")[1] in pseudonyms


def _check_stray(store: StudyStore, name: str) -> Finding:
    """Returns the finding about a file that belongs to no attempt. A killed session can leave this file."""
    sessions = [
        each for person in store.read_participants() for each in store.read_sessions(person.pseudonym)
    ]
    own = name.rpartition("/")[0] in {session.recordings_folder for session in sessions}
    if own and not _is_completed(store.folder / name):
        return Finding(name, "was created for an attempt that never started", is_error=False)
    return Finding(name, "belongs to no attempt of this study")


def _is_completed(path: Path) -> bool:
    try:
        return read_recording(path).result == "completed"
    except (OSError, RecordingError):
        return False


def check_retention_periods(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about data after the end of their retention period."""
    return (
        Finding("retention", words, is_error=False) for words in describe_due_deletions(store, today_utc())
    )


def check_policy_loading(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about policies that cannot be loaded."""
    return (Finding(f"policy {name}", fault) for name, fault in find_policy_errors(store))


def _check_participant(
    store: StudyStore, participant: Participant, attempts: list[TrialAttempt]
) -> Iterator[Finding]:
    pseudonym = participant.pseudonym
    if attempts and participant.consented_at is None and participant.state != UNKNOWN_PARTICIPATION_STATE:
        yield Finding(pseudonym, "has attempts without consent")
    sessions = {session.id: session for session in store.read_sessions(pseudonym)}
    trials = store.read_trials(pseudonym)
    by_id = {trial.id: trial for trial in trials}
    answers = store.read_answers(pseudonym)
    asked = {use.session.id: use.design for use in read_session_designs(store, [participant])}
    for attempt in attempts:
        if attempt.trial not in by_id:
            yield Finding(str(attempt), f"belongs to no trial of {pseudonym}")
            continue
        own = [answer for answer in answers if answer.attempt == attempt.id]
        yield from _check_attempt(
            store,
            participant,
            sessions[attempt.session],
            by_id[attempt.trial],
            attempt,
            own,
            asked.get(attempt.session, store.design),
        )
    for session in sessions.values():
        yield from _check_session(store, session, asked.get(session.id, store.design))
    for trial in trials:
        completed = [a for a in attempts if a.trial == trial.id and a.state == "completed"]
        if len(completed) != (trial.state == "completed"):
            yield Finding(str(trial), f"is {trial.state} with {len(completed)} completed attempts")


def _check_session(store: StudyStore, session: StudySession, design: Design) -> Iterator[Finding]:
    """Yields a finding about unanswered items of an ended session.

    After a crash, the next session shows these items. Of the interrupted sessions, only the last session is checked.
    """
    answered = find_items_answered_in_visit(store, session)
    missing = [
        item.id
        for when in SESSION_QUESTION_MOMENTS
        for item in design.list_items_at_moment(when)
        if (when, item.id) not in answered
    ]
    last = session.id == store.read_sessions(format_pseudonym(session.participant))[-1].id
    if missing and (session.state == "closed" or (session.state == "interrupted" and last)):
        yield Finding(str(session), f"has unanswered items: {', '.join(missing)}", is_error=False)


def _check_attempt(
    store: StudyStore,
    participant: Participant,
    session: StudySession,
    trial: Trial,
    attempt: TrialAttempt,
    answers: list[StudyAnswer],
    design: Design,
) -> Iterator[Finding]:
    completed = attempt.state == "completed"
    if completed and not trial.practice:
        given = {answer.item for answer in answers}
        missing = [item.id for item in design.list_items_at_moment("after_trial") if item.id not in given]
        if missing:
            yield _not_answered(store, attempt, missing)
    try:
        path = store.resolve_path(attempt.recording)
    except StudyError as error:
        yield Finding(attempt.recording, str(error))
        return
    if path.is_file():
        yield from _check_recording(store, participant, trial, attempt, path, answers)
    elif participant.site_number is None and session.station != store.station_name:
        yield Finding(
            attempt.recording, f"is at another station; it was recorded at {session.station}", is_error=False
        )
    elif why := _not_merged(store, attempt):
        yield Finding(attempt.recording, f"was omitted at the merge of sites: {why}", is_error=False)
    elif at := read_recording_deletion_times(store).get(participant.number):
        yield Finding(attempt.recording, f"was deleted by schedule at {at}", is_error=False)
    elif completed or attempt.sha256 is not None:
        yield Finding(attempt.recording, "is missing")


def _not_answered(store: StudyStore, attempt: TrialAttempt, missing: list[str]) -> Finding:
    """Returns the finding about missing answers to the questionnaire after a completed trial."""
    with store.database.read_transaction() as connection:
        opened, still_open = (
            had_open_questionnaire(connection, attempt),
            has_open_questionnaire(store, connection, attempt),
        )
    items = ", ".join(missing)
    if not opened:
        return Finding(attempt.recording, f"completed without answers to {items}")
    state = "its questionnaire is open" if still_open else "its questionnaire was skipped"
    return Finding(attempt.recording, f"{state}: no answer to {items}", is_error=False)


def _not_merged(store: StudyStore, attempt: TrialAttempt) -> str:
    """Returns the reason why a merge of sites omitted this recording; empty if it was not omitted."""
    with store.database.read_transaction() as connection:
        events = find_rows(connection, StudyEvent, attempt=attempt.id)
    return next((event.detail for event in events if event.name == OMITTED_RECORDING_EVENT), "")


def _check_recording(
    store: StudyStore,
    participant: Participant,
    trial: Trial,
    attempt: TrialAttempt,
    path: Path,
    answers: list[StudyAnswer],
) -> Iterator[Finding]:
    has_checksum = attempt.state == "completed" or attempt.sha256 is not None
    if has_checksum and compute_recording_sha256(store, attempt.recording) != attempt.sha256:
        yield Finding(attempt.recording, CHECKSUM_MISMATCH_MESSAGE)
    try:
        recording = read_recording(path)
    except (OSError, RecordingError) as error:
        yield Finding(attempt.recording, f"cannot be read: {error}", is_error=attempt.state == "completed")
        return
    if attempt.state == "completed" and not recording.is_complete:
        yield Finding(attempt.recording, "is incomplete, but its trial is completed")
    if attempt.state == "completed" and _common_metrics(recording.metrics) != _common_metrics(
        attempt.metrics
    ):
        yield Finding(attempt.recording, "contains metrics that differ from the database")
    if attempt.state == "completed" and not trial.practice and participant.state in ALLOCATED_STATES:
        held = describe_excess_tracking_loss(recording, store.design)
        if held is not None:
            yield make_excluded_trial_finding(participant.pseudonym, trial.position, held)
    for name, times in _clocks(recording):
        if times.clock_resets:
            yield Finding(attempt.recording, _jumped(name, times), is_error=False)
    for name in _differences(recording, _stored(participant, trial, attempt), answers):
        yield Finding(attempt.recording, f"was recorded with another {name} than in the database")


def _clocks(recording: Recording) -> Iterator[tuple[str, SampleTimes]]:
    """Yields the name and the sample times of each recorded stream from another device."""
    return (
        (name, compute_stream_sample_times(recording.messages_by_topic, name))
        for name in sorted(collect_streams(recording.messages_by_topic))
    )


def _jumped(stream: str, times: SampleTimes) -> str:
    jumps = ", ".join(
        f"{reset.jump_s:+.3f} s at {reset.time_s:.1f} s" for reset in times.clock_resets[:_MAX_LISTED]
    )
    more = (
        f" and {len(times.clock_resets) - _MAX_LISTED} more" if len(times.clock_resets) > _MAX_LISTED else ""
    )
    return f"the clock of the stream {stream} jumped: {jumps}{more}; analysis and exports use corrected times"


def _common_metrics(metrics: Metrics) -> tuple[int | None, float | None, bool | None]:
    """Returns the metrics that must be equal in database and recording: steps, reward and success."""
    return metrics.steps, metrics.reward, metrics.success


def _stored(participant: Participant, trial: Trial, attempt: TrialAttempt) -> Mapping[str, Any]:
    """Returns the values of an attempt in the database, by name. Its recording must contain the same values."""
    values = {
        "environment": trial.environment,
        "policy": trial.policy,
        "seed": trial.seed,
        "practice": trial.practice,
        "simulated": participant.simulated,
    }
    return values if attempt.torso_height_m is None else values | {"torso height": attempt.torso_height_m}


def _differences(
    recording: Recording, stored: Mapping[str, Any], answers: list[StudyAnswer]
) -> Iterator[str]:
    """Yields the names of values that differ between recording and database.

    A truncated recording may lack answers.
    """
    configuration = recording.configuration
    recorded_values = {
        "environment": configuration.environment,
        "policy": configuration.policy,
        "seed": configuration.seed,
        "practice": configuration.practice,
        "simulated": configuration.simulated,
        "torso height": configuration.person.torso_height_m,
    }
    yield from (name for name, value in stored.items() if recorded_values[name] != value)
    recorded = {answer.item: answer.value for _, answer in recording.messages_by_topic["/answers"]}
    comparable = [answer for answer in answers if answer.item in recorded or recording.outcome is not None]
    if any(recorded.get(answer.item) != answer.value for answer in comparable):
        yield "answer"


def _files(store: StudyStore) -> list[str]:
    """Returns the paths of all files and symbolic links in the recordings folder, relative to the study's folder."""
    found: list[str] = []
    for folder, folders, files in os.walk(store.folder / RECORDINGS_FOLDER):
        links = [name for name in folders if (Path(folder) / name).is_symlink()]
        found += [str((Path(folder) / name).relative_to(store.folder).as_posix()) for name in files + links]
    return sorted(found)


STUDY_CHECKS: tuple[Callable[[StudyStore], Iterable[Finding]], ...] = (
    check_object_store,
    check_database,
    check_policy_loading,
    check_used_policies,
    check_design,
    check_stored_designs,
    check_initial_states,
    check_private_files,
    check_consents,
    check_participation,
    check_participants,
    check_plugins,
    check_interim_looks,
    check_repeats,
    check_orphaned_files,
    check_retention_periods,
)
