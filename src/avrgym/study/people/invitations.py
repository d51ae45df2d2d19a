"""Invitations to a hosted study: links with a random token, an expiry time and a number of places.

The study stores only checksums of tokens. At enrolment, the participant receives a personal token. It opens the
participant's page until the study ends. Only the identity file contains the participant's id at a recruitment service.
"""

import secrets
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import sqlalchemy as sa

from avrgym.models.human import Sex
from avrgym.study.design.toml_validation import NAME_PATTERN
from avrgym.study.people.identities import PossibleDuplicateError
from avrgym.study.people.participants import enrol_participant
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database_rows import (
    Invitation,
    InvitationUse,
    format_pseudonym,
    parse_participant_number,
)
from avrgym.study.storage.free_text import check_single_line
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_row, find_rows
from avrgym.vr.server.session_links import compute_token_sha256

TOKEN_LENGTH_BYTES = 16
MAX_PARTICIPANTS_PER_INVITATION = 1_000_000
MAX_VALIDITY_DAYS = 3650
_enrolling = threading.Lock()


class InvitationError(StudyError):
    """An invitation cannot be used. ``reason``: ``unknown``, ``expired``, ``full``, ``closed`` or ``duplicate``."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True)
class NewInvitation:
    """A new invitation with its token, which is not stored."""

    id: int
    label: str
    token: str
    expires_at: str
    places: int


@dataclass(frozen=True)
class InvitationSummary:
    """An invitation. ``used``: number of participants enrolled with it. ``state``: ``open``, or why it is unusable."""

    id: int
    label: str
    expires_at: str
    places: int
    used: int
    state: str


@dataclass(frozen=True)
class RecruitmentServiceIds:
    """Ids of a recruitment service: participant, study and session. Empty without a service."""

    participant_id: str = ""
    study_id: str = ""
    session_id: str = ""


def create_invitations(
    store: StudyStore, labels: Sequence[str], *, days: float, places: int = 1
) -> list[NewInvitation]:
    """Create one invitation for each label. An empty label is allowed.

    Args:
        store: the study.
        labels: references of the experimenter, without names.
        days: time until the invitations expire, in days.
        places: maximum number of participants of each invitation.

    Raises:
        StudyError: for an invalid or repeated label, or for an invalid number. No invitation is created then.
    """
    if not 0.0 < days <= MAX_VALIDITY_DAYS:
        raise StudyError(
            f"invitations are valid for {days:g} days; allowed: more than 0, at most {MAX_VALIDITY_DAYS}"
        )
    if not 1 <= places <= MAX_PARTICIPANTS_PER_INVITATION:
        raise StudyError(
            f"an invitation has {places} places; allowed: 1 to {MAX_PARTICIPANTS_PER_INVITATION}"
        )
    named = [label for label in labels if label]
    for label in named:
        if not NAME_PATTERN.fullmatch(label):
            raise StudyError(f"{label!r} is not a valid label; allowed: at most 40 letters, digits, - and _")
    expires_at = (datetime.now(UTC) + timedelta(days=days)).isoformat(timespec="microseconds")
    created: list[NewInvitation] = []
    with store.write_transaction() as connection:
        known = [each.label for each in find_rows(connection, Invitation)]
        for label in named:
            if named.count(label) > 1 or label in known:
                raise StudyError(f"label {label} is used twice; allowed: a unique label for each invitation")
        for label in labels:
            token = secrets.token_urlsafe(TOKEN_LENGTH_BYTES)
            key = hash_chain.insert_row(
                connection,
                schema.INVITATION_TABLE,
                created_at=make_utc_timestamp(),
                sha256=compute_token_sha256(token),
                label=label or None,
                expires_at=expires_at,
                places=places,
            )
            created.append(NewInvitation(key, label, token, expires_at, places))
    return created


def list_invitations(store: StudyStore) -> list[InvitationSummary]:
    """Returns all invitations in the order of creation."""
    with store.database.read_transaction() as connection:
        uses = [use.invitation for use in find_rows(connection, InvitationUse)]
        return [
            InvitationSummary(
                each.id,
                each.label or "",
                each.expires_at,
                each.places,
                uses.count(each.id),
                _refusal(each, uses.count(each.id)) or "open",
            )
            for each in find_rows(connection, Invitation)
        ]


def close_invitation(store: StudyStore, invitation: int) -> None:
    """Close an invitation against further enrolments. Raises ``StudyError`` for an unknown id."""
    with store.write_transaction() as connection:
        if not find_rows(connection, Invitation, id=invitation):
            raise StudyError(
                f"there is no invitation {invitation}; `avrgym study invitations` lists all invitations"
            )
        hash_chain.update_row(connection, schema.INVITATION_TABLE, invitation, closed_at=make_utc_timestamp())


def find_valid_invitation(store: StudyStore, token: str) -> Invitation:
    """Returns the invitation with this token.

    Raises:
        InvitationError: if it is unknown, expired or closed, or has no free place.
    """
    with store.database.read_transaction() as connection:
        return _usable(connection, token)


def enrol_with_invitation(
    store: StudyStore,
    token: str,
    sex: Sex,
    *,
    age_years: int | None = None,
    language: str = "",
    service: RecruitmentServiceIds = RecruitmentServiceIds(),
    simulated: bool = False,
) -> tuple[str, str]:
    """Enrol a participant with an invitation. Returns the pseudonym and the participant's personal token.

    Arguments: see ``enrol_participant``. ``service.participant`` is stored as the contact in the identity file.

    Raises:
        InvitationError: if the invitation cannot be used, or if the id at the recruitment service is already enrolled.
        StudyError: see ``enrol_participant``. The invitation is then not used.
    """
    for what, value in (("study id", service.study_id), ("session id", service.session_id)):
        check_single_line(f"the {what}", value)
    with _enrolling:
        find_valid_invitation(store, token)
        try:
            pseudonym = enrol_participant(
                store,
                sex,
                age_years=age_years,
                language=language,
                contact="" if simulated else service.participant_id,
                simulated=simulated,
            )
        except PossibleDuplicateError:
            raise InvitationError("duplicate", "this person takes part in the study already") from None
        own = secrets.token_urlsafe(TOKEN_LENGTH_BYTES)
        with store.write_transaction() as connection:
            hash_chain.insert_row(
                connection,
                schema.INVITATION_USE_TABLE,
                invitation=_usable(connection, token).id,
                participant=parse_participant_number(pseudonym),
                used_at=make_utc_timestamp(),
                sha256=compute_token_sha256(own),
                service_study=service.study_id or None,
                service_session=service.session_id or None,
            )
    return pseudonym, own


def read_pseudonyms_by_token_sha256(store: StudyStore) -> dict[str, str]:
    """Returns the pseudonym of each participant with a personal token, by the token's checksum."""
    table = schema.INVITATION_USE_TABLE
    used = sa.select(table.c.sha256, table.c.participant).where(table.c.participant.is_not(None))
    with store.database.read_transaction() as connection:
        return {sha256: format_pseudonym(number) for sha256, number in connection.execute(used)}


def replace_participant_token(store: StudyStore, pseudonym: str) -> str:
    """Create a new personal token for a participant. Returns the token. The earlier token becomes invalid.

    Raises ``StudyError`` for a participant without an invitation.
    """
    own = secrets.token_urlsafe(TOKEN_LENGTH_BYTES)
    with store.write_transaction() as connection:
        use = find_row(
            connection,
            InvitationUse,
            f"invitation of {pseudonym}",
            participant=parse_participant_number(pseudonym),
        )
        hash_chain.update_row(
            connection, schema.INVITATION_USE_TABLE, use.id, sha256=compute_token_sha256(own)
        )
    return own


def _usable(connection: sa.Connection, token: str) -> Invitation:
    found = find_rows(connection, Invitation, sha256=compute_token_sha256(token))
    if not found:
        raise InvitationError("unknown", "this invitation is unknown; open the link again as you received it")
    used = len(find_rows(connection, InvitationUse, invitation=found[0].id))
    reason = _refusal(found[0], used)
    if reason:
        raise InvitationError(reason, _MESSAGES[reason])
    return found[0]


_MESSAGES = {
    "closed": "this invitation is closed",
    "expired": "this invitation has expired",
    "full": "this invitation has been used; each place is for one participant",
}


def _refusal(invitation: Invitation, used: int) -> str:
    """Returns the reason why an invitation cannot be used; empty if it can be used."""
    if invitation.closed_at is not None:
        return "closed"
    if datetime.now(UTC) >= datetime.fromisoformat(invitation.expires_at):
        return "expired"
    return "full" if used >= invitation.places else ""
