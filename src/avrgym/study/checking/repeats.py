"""Find repeats: attempts that a later attempt replaced. A repeat has a reason, and a person that requested it."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from avrgym.study.storage.audit_log import describe_log_person, read_site_names
from avrgym.study.storage.database_rows import AuditLogEntry, Participant, StudyEvent, Trial, TrialAttempt
from avrgym.study.storage.store import StudyStore

TECHNICAL_REASON, PARTICIPANT_REASON, EXPERIMENTER_REASON, UNKNOWN_REASON = (
    "technical",
    "participant",
    "experimenter",
    "unknown",
)
REPEAT_REASONS = (TECHNICAL_REASON, PARTICIPANT_REASON, EXPERIMENTER_REASON, UNKNOWN_REASON)
"""Reasons of repeats: technical fault, participant, experimenter, or unknown."""
UNKNOWN_EXPERIMENTER_NAME = "not in the log"
"""Used instead of the experimenter's name if no log entry matches."""
RepeatCause = tuple[str, str]
"""A reason of a repeat (one of ``REPEAT_REASONS``), and the cause as text."""

CAUSE_BY_ATTEMPT_STATE: Mapping[str, RepeatCause] = {
    "repeated": (EXPERIMENTER_REASON, "repeated"),
    "skipped": (EXPERIMENTER_REASON, "skipped"),
    "paused": (EXPERIMENTER_REASON, "paused"),
    "ended": (EXPERIMENTER_REASON, "session ended"),
    "failed": (TECHNICAL_REASON, "recording failed"),
}
CAUSE_BY_EVENT: Mapping[str, RepeatCause] = {
    "tracking timed out": (TECHNICAL_REASON, "tracking lost"),
    "visibility lost": (TECHNICAL_REASON, "scene not visible"),
    "time lost": (TECHNICAL_REASON, "computer was suspended"),
    "connection lost": (TECHNICAL_REASON, "network"),
    "torso height corrected": (EXPERIMENTER_REASON, "torso height corrected"),
}
COMMANDS_BY_ATTEMPT_STATE = {
    "repeated": ("repeat",),
    "skipped": ("skip",),
    "paused": ("pause",),
    "ended": ("end", "withdraw"),
    "stopped": ("stop",),
    "interrupted": ("recalibrate", "correct torso height"),
}
"""Commands in the log that can end an attempt, by the attempt's state."""
_ENDED = re.compile(r"attempt (?!running)")


@dataclass(frozen=True)
class ReplacedAttempt:
    """An attempt that a later attempt replaced.

    ``repeat_reason``: one of ``REPEAT_REASONS``. ``cause_text``: the cause as text. ``requested_by``: name of the
    experimenter that requested the repeat (``UNKNOWN_EXPERIMENTER_NAME`` if unknown); empty for other reasons.
    """

    participant: Participant
    trial: Trial
    attempt: TrialAttempt
    repeat_reason: str
    cause_text: str
    requested_by: str

    @property
    def is_requested(self) -> bool:
        """Whether the reason is ``EXPERIMENTER_REASON``: an experimenter requested the repeat."""
        return self.repeat_reason == EXPERIMENTER_REASON

    @property
    def success(self) -> bool | None:
        """Whether the replaced attempt succeeded; ``None`` if this is not stored."""
        return self.attempt.metrics.success


@dataclass(frozen=True)
class AttemptedTrial:
    """A trial with at least one attempt, not a practice trial. Attempts and repeats are in order of time."""

    participant: Participant
    trial: Trial
    attempts: Sequence[TrialAttempt]
    replaced_attempts: Sequence[ReplacedAttempt]

    @property
    def requested_repeat_count(self) -> int:
        """Number of repeats that an experimenter requested."""
        return sum(repeat.is_requested for repeat in self.replaced_attempts)


def list_attempted_trials(store: StudyStore) -> list[AttemptedTrial]:
    """Returns all trials with an attempt, except practice trials, ordered by participant and position."""
    causes = _Causes(store)
    return [
        AttemptedTrial(person, trial, own, [causes.repeat(person, trial, attempt) for attempt in own[:-1]])
        for person in store.read_participants()
        for trial, own in _attempts(store, person)
    ]


def _attempts(store: StudyStore, person: Participant) -> Iterator[tuple[Trial, list[TrialAttempt]]]:
    attempts = defaultdict[int, list[TrialAttempt]](list)
    for attempt in store.read_attempts(person.pseudonym):
        attempts[attempt.trial].append(attempt)
    for trial in store.read_trials(person.pseudonym):
        if not trial.practice and trial.id in attempts:
            yield trial, sorted(attempts[trial.id], key=lambda attempt: attempt.number)


class _Causes:
    """Find the cause of an attempt's end in the events next to it, and the person in the log."""

    def __init__(self, store: StudyStore) -> None:
        self._sites = read_site_names(store)
        self._log = defaultdict[int | None, list[AuditLogEntry]](list)
        for entry in store.read_audit_log():
            self._log[entry.participant].append(entry)
        self._events = defaultdict[int | None, list[StudyEvent]](list)
        self._ends: dict[int, int] = {}
        for event in store.read_events():
            own = self._events[event.session]
            if event.attempt is not None and _ENDED.match(event.name):
                self._ends[event.attempt] = len(own)
            own.append(event)
        self._interrupted = {
            session.id
            for person in store.read_participants()
            for session in store.read_sessions(person.pseudonym)
            if session.state == "interrupted"
        }

    def repeat(self, person: Participant, trial: Trial, attempt: TrialAttempt) -> ReplacedAttempt:
        entry = self._command(person, attempt)
        reason, cause = self._cause(attempt, entry)
        by = describe_log_person(entry, self._sites) if entry is not None else UNKNOWN_EXPERIMENTER_NAME
        return ReplacedAttempt(
            person, trial, attempt, reason, cause, by if reason == EXPERIMENTER_REASON else ""
        )

    def _command(self, person: Participant, attempt: TrialAttempt) -> AuditLogEntry | None:
        """Returns the last command in the log that can have ended the attempt; ``None`` if there is none."""
        ended_at = attempt.ended_at or ""
        fitting = [
            entry
            for entry in self._log[person.number]
            if entry.action in COMMANDS_BY_ATTEMPT_STATE.get(attempt.state, ())
            and attempt.started_at <= entry.recorded_at <= ended_at
        ]
        return max(fitting, key=lambda entry: entry.recorded_at, default=None)

    def _cause(self, attempt: TrialAttempt, entry: AuditLogEntry | None) -> RepeatCause:
        if attempt.state in CAUSE_BY_ATTEMPT_STATE:
            return CAUSE_BY_ATTEMPT_STATE[attempt.state]
        before, after = self._next_to_end(attempt)
        if attempt.state == "stopped":
            stop = next((event for event in after if event.name == "stopped"), None)
            if stop is None:
                return UNKNOWN_REASON, "stopped"
            return (
                EXPERIMENTER_REASON if stop.detail.startswith("by experimenter") else PARTICIPANT_REASON
            ), "stopped"
        cause = next((event for event in [*after, *before] if event.name in CAUSE_BY_EVENT), None)
        if cause is not None:
            return CAUSE_BY_EVENT[cause.name]
        if entry is not None:
            return EXPERIMENTER_REASON, "measured again"
        return self._without_event(attempt, after)

    def _without_event(self, attempt: TrialAttempt, after: Sequence[StudyEvent]) -> RepeatCause:
        """Returns the cause of an interruption that no event explains, from the events after it."""
        details = [event.detail for event in after if event.name == "phase entered"]
        if any("phase waiting" in detail for detail in details):
            return PARTICIPANT_REASON, "left VR"
        if any("phase calibration" in detail for detail in details):
            return UNKNOWN_REASON, "measured again"
        closed = any(event.name in ("session closed", "session interrupted") for event in after)
        if closed or attempt.session in self._interrupted:
            return TECHNICAL_REASON, "restart"
        return UNKNOWN_REASON, "interrupted"

    def _next_to_end(self, attempt: TrialAttempt) -> tuple[list[StudyEvent], list[StudyEvent]]:
        """Returns the events next to the end of an attempt: its last event, and the events until the next phase.

        Both lists are empty if the end of the attempt is not stored.
        """
        own, end = self._events[attempt.session], self._ends.get(attempt.id)
        if end is None:
            return [], []
        before = [event for event in own[max(end - 1, 0) : end] if event.attempt == attempt.id]
        after: list[StudyEvent] = []
        for event in own[end + 1 :]:
            after.append(event)
            if event.name in ("phase entered", "attempt running"):
                break
        return before, after
