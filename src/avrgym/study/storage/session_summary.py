"""Time in VR, breaks and completed trials of each session."""

from collections.abc import Iterable
from dataclasses import dataclass

from avrgym.study.storage.answers import find_session_ids_of_visit
from avrgym.study.storage.database_rows import (
    StudyEvent,
    StudySession,
    format_pseudonym,
    parse_participant_number,
)
from avrgym.study.storage.store import StudyStore, find_rows

HEADSET_TIME_EVENT, BREAK_START_EVENT = "headset used", "break begun"
"""Names of the events for a time in VR, and for the start of a break."""


@dataclass(frozen=True)
class SessionSummary:
    """Summary of a session. ``trials``: number of completed trials. ``minutes``: time in VR. ``breaks``: number of
    breaks.
    """

    number: int
    opened_at: str
    closed_at: str | None
    state: str
    trials: int
    minutes: float
    breaks: int


def summarise_sessions(store: StudyStore, pseudonym: str) -> list[SessionSummary]:
    """Returns a summary of each session of a participant, in order."""
    events = _events_of(store, pseudonym)
    completed = [each.session for each in store.read_attempts(pseudonym) if each.state == "completed"]
    return [
        SessionSummary(
            session.number,
            session.opened_at,
            session.closed_at,
            session.state,
            completed.count(session.id),
            _headset_s(events, {session.id}) / 60.0,
            sum(event.session == session.id and event.name == BREAK_START_EVENT for event in events),
        )
        for session in store.read_sessions(pseudonym)
    ]


def compute_earlier_time_in_vr_s(store: StudyStore, session: StudySession) -> float:
    """Returns the time in VR (s) in the interrupted sessions directly before a session."""
    pseudonym = format_pseudonym(session.participant)
    sessions = store.read_sessions(pseudonym)
    return _headset_s(
        _events_of(store, pseudonym), set(find_session_ids_of_visit(sessions, session.id)) - {session.id}
    )


def _events_of(store: StudyStore, pseudonym: str) -> list[StudyEvent]:
    """Returns the events of a participant, in the order of storage."""
    with store.database.read_transaction() as connection:
        return find_rows(connection, StudyEvent, participant=parse_participant_number(pseudonym))


def _headset_s(events: Iterable[StudyEvent], sessions: set[int]) -> float:
    used = [event for event in events if event.session in sessions and event.name == HEADSET_TIME_EVENT]
    return sum(float(event.detail.removeprefix("seconds ")) for event in used)
