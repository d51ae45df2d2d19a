"""Stages of a participant at home: the next step, computed from the study's database and the running sessions."""

from collections.abc import Mapping
from typing import Any

import msgspec

from avrgym.hosting.session_pool import SessionPool
from avrgym.hosting.settings import FinalPage, HostSettings
from avrgym.study.people.participants import read_consent_text, read_participant_texts
from avrgym.study.sessions.study_visit import has_unfinished_trials
from avrgym.study.storage.database_rows import Participant, StudyEvent
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_participant, find_rows, record_event

SAFETY_CONFIRMED_EVENT = "safety confirmed"
FINAL_PAGE_BY_STATE: Mapping[str, str] = {
    "excluded": "screened_out",
    "withdrawn": "withdrawn",
    "completed": "completed",
}
"""Last page (a field of ``HostSettings``) by final state of a participant."""


class ConsentStage(msgspec.Struct, frozen=True, tag="consent"):
    """The participant reads the consent text and decides. ``sha256``: checksum of the text."""

    version: str
    language: str
    text: str
    sha256: str


class InclusionStage(msgspec.Struct, frozen=True, tag="inclusion"):
    """The participant answers the inclusion questions: ids and texts."""

    questions: tuple[tuple[str, str], ...]


class SafetyStage(msgspec.Struct, frozen=True, tag="safety"):
    """The participant prepares chair and room, and confirms this."""


class ReadyForSessionStage(msgspec.Struct, frozen=True, tag="ready"):
    """The participant can start a session. ``minutes``: expected duration. ``trials``: number of remaining trials.

    ``is_open``: whether the experimenter permits new sessions. ``problem``: error of the latest session, if any.
    """

    minutes: int
    trials: int
    is_open: bool
    problem: str = ""


class WaitingStage(msgspec.Struct, frozen=True, tag="waiting"):
    """The participant waits for a session. ``ahead``: number of earlier participants. ``minutes``: estimated wait."""

    ahead: int
    minutes: int


class SessionStage(msgspec.Struct, frozen=True, tag="session"):
    """A session is running. ``path``: address of its page. ``token``: token of the page."""

    path: str
    token: str


class FinalStage(msgspec.Struct, frozen=True, tag="ended"):
    """The study has ended for this participant. ``ending``: ``completed``, ``screened_out`` or ``withdrawn``.

    ``code`` and ``redirect``: see ``FinalPage``.
    """

    ending: str
    code: str
    redirect: str


Stage = (
    ConsentStage
    | InclusionStage
    | SafetyStage
    | ReadyForSessionStage
    | WaitingStage
    | SessionStage
    | FinalStage
)


def find_stage(
    store: StudyStore, settings: HostSettings, pool: SessionPool, pseudonym: str, *, is_open: bool
) -> Stage:
    """Returns the stage of a participant. ``is_open``: whether the experimenter permits new sessions.

    Raises:
        StudyError: if the participant's state is unknown after a loss of the database.
    """
    participant = store.read_participant(pseudonym)
    ending = FINAL_PAGE_BY_STATE.get(participant.state)
    if ending is not None and not (ending == "completed" and pool.find_participant_session(pseudonym)):
        given: FinalPage = getattr(settings, ending)
        return FinalStage(ending, given.code, given.redirect)
    if participant.state == "enrolled" or participant.must_reconsent(store.design.consent.version):
        shown = read_consent_text(store, participant)
        return ConsentStage(shown.version, shown.language, shown.text, shown.sha256)
    if participant.state == "consented":
        texts = read_participant_texts(store, participant)
        asked = store.design.inclusion
        return InclusionStage(tuple((each.id, texts.translate(each.text)) for each in asked))
    if participant.state not in ("allocated", "completed"):
        raise StudyError(f"the state of {pseudonym} is {participant.state}; contact the experimenter")
    if not has_confirmed_safety(store, participant):
        return SafetyStage()
    return _session_stage(store, settings, pool, pseudonym, is_open=is_open)


def _session_stage(
    store: StudyStore, settings: HostSettings, pool: SessionPool, pseudonym: str, *, is_open: bool
) -> Stage:
    session = pool.find_participant_session(pseudonym)
    if session is not None:
        return SessionStage(f"session/{session.id}/", session.link_token)
    place = pool.find_waiting_list_place(pseudonym)
    if place is not None:
        return WaitingStage(place.num_participants_ahead, round_up_to_minutes(place.estimated_wait_s))
    if _is_finished(store, pool, pseudonym):
        if (
            store.read_participant(pseudonym).state == "allocated"
        ):  # the session may have ended since the first query
            close_session(store, open_session(store, pseudonym).id)  # the participant is completed then
        return find_stage(store, settings, pool, pseudonym, is_open=is_open)
    remaining = len(store.read_remaining_trials(pseudonym))
    return ReadyForSessionStage(
        round_up_to_minutes(pool.estimated_session_duration_s),
        remaining,
        is_open,
        pool.find_session_error(pseudonym),
    )


def _is_finished(store: StudyStore, pool: SessionPool, pseudonym: str) -> bool:
    """Returns whether no trial or question remains, even after a crash of the session's last process."""
    has_questions = bool(store.design.list_items_at_moment("after_session")) and not pool.find_session_error(
        pseudonym
    )
    return not has_questions and not has_unfinished_trials(store, pseudonym)


def round_up_to_minutes(seconds: float) -> int:
    """Returns a duration in whole minutes, rounded up."""
    return -int(-seconds // 60.0)


def has_confirmed_safety(store: StudyStore, participant: Participant) -> bool:
    """Returns whether the participant has confirmed that chair and room are prepared."""
    with store.database.read_transaction() as connection:
        return bool(
            find_rows(connection, StudyEvent, participant=participant.number, name=SAFETY_CONFIRMED_EVENT)
        )


def record_participant_event(store: StudyStore, pseudonym: str, name: str, detail: str = "") -> None:
    """Store an event of a participant outside a session, such as a confirmed preparation of the room."""
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        record_event(connection, name, detail, {"participant": participant.number})


def encode_stage(stage: Stage) -> dict[str, Any]:
    """Returns the stage as JSON values. The value ``type`` is the name of the stage."""
    return msgspec.to_builtins(stage)
