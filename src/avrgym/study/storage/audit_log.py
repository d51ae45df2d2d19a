"""The audit log of a study: each action and view, with person and time. Entries are never changed or removed.

Entries contain no names of participants, no notes and no reasons. The hash chain reveals changed and deleted entries.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from getpass import getuser

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database_rows import (
    AuditLogEntry,
    DeletedParticipant,
    Participant,
    Trial,
    parse_participant_number,
)
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.sites import ROW_ID_STRIDE
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_rows

PERSONAL_TOKEN_METHOD, SHARED_TOKEN_METHOD, SPECTATOR_TOKEN_METHOD, COMPUTER_ACCOUNT_METHOD = (
    "own token",
    "shared token",
    "spectator's token",
    "account",
)
IDENTIFICATION_METHODS = (
    PERSONAL_TOKEN_METHOD,
    SHARED_TOKEN_METHOD,
    SPECTATOR_TOKEN_METHOD,
    COMPUTER_ACCOUNT_METHOD,
)
"""Methods that identify a person: personal token, shared token, spectator's token, or account on the computer."""
UNNAMED_PERSON = "unnamed"
"""Stored name of every person with a shared token."""
ADD_EXPERIMENTER_ACTION, REVOKE_EXPERIMENTER_ACTION = "add experimenter", "revoke experimenter"
"""Names of two actions. The detail of their log entries is the name of an experimenter."""
REJECTED_COMMAND_DETAIL = "refused"
"""Detail of the log entry of a rejected command."""


@dataclass(frozen=True)
class AuditActor:
    """A person in the audit log. ``identification_method``: one of ``IDENTIFICATION_METHODS``."""

    name: str
    identification_method: str


def find_process_user() -> AuditActor:
    """Returns the user of this process. The name comes from the operating system, not from environment variables."""
    try:
        import pwd

        return AuditActor(pwd.getpwuid(os.getuid()).pw_name, COMPUTER_ACCOUNT_METHOD)
    except ModuleNotFoundError:  # Windows
        return AuditActor(getuser(), COMPUTER_ACCOUNT_METHOD)
    except KeyError:  # an account without a name, as in containers
        return AuditActor(f"account {os.getuid()}", COMPUTER_ACCOUNT_METHOD)


def add_log_entry(
    store: StudyStore,
    actor: AuditActor,
    name: str,
    participant: str | None = None,
    detail: str = "",
    *,
    at: str | None = None,
    shows_results: bool = False,
) -> None:
    """Add an entry to the audit log of a study.

    Args:
        store: the study.
        actor: the person.
        name: the action, such as ``export``.
        participant: pseudonym of the affected participant, if any.
        detail: further information without names of participants.
        at: time of the action; default: the current time.
        shows_results: the person viewed results; store the numbers of completed and planned participants.

    Raises:
        StudyError: if the study cannot be written.
    """
    with store.database.write_transaction() as connection:
        completed, planned = _progress(store, connection) if shows_results else (None, None)
        hash_chain.insert_row(
            connection,
            schema.AUDIT_LOG_TABLE,
            id=_next_id(connection),
            recorded_at=at or make_utc_timestamp(),
            person=actor.name,
            identified_by=actor.identification_method,
            action=name,
            participant=_number(participant),
            detail=detail,
            completed=completed,
            planned=planned,
        )


def _number(pseudonym: str | None) -> int | None:
    """Returns the participant's number; ``None`` for text that is not a pseudonym."""
    try:
        return None if pseudonym is None else parse_participant_number(pseudonym)
    except StudyError:
        return None


def _next_id(connection: sa.Connection) -> int:
    """Returns the id for a new log entry of this study. Ids from ``ROW_ID_STRIDE`` belong to merged sites."""
    ids = sa.select(sa.func.max(schema.AUDIT_LOG_TABLE.c.id)).where(
        schema.AUDIT_LOG_TABLE.c.id < ROW_ID_STRIDE
    )
    return (connection.execute(ids).scalar() or 0) + 1


def _progress(store: StudyStore, connection: sa.Connection) -> tuple[int | None, int | None]:
    """Returns the numbers of completed and planned participants; ``None`` before the first completed trial.

    The numbers include simulated participants only if all participants are simulated.
    """
    everyone = find_rows(connection, Participant)
    simulated = all(each.simulated for each in [*everyone, *find_rows(connection, DeletedParticipant)])
    own = {each.number: each for each in everyone if each.simulated is simulated}
    completed_trials = find_rows(connection, Trial, state="completed", practice=False)
    if not any(trial.participant in own for trial in completed_trials):
        return None, None
    return sum(each.state == "completed" for each in own.values()), store.design.participants


def describe_log_person(entry: AuditLogEntry, sites: Mapping[int, str]) -> str:
    """Returns the person of a log entry as text. ``sites``: names of the merged sites, by site number."""
    who = {
        PERSONAL_TOKEN_METHOD: entry.person,
        SHARED_TOKEN_METHOD: "an unnamed experimenter",
        SPECTATOR_TOKEN_METHOD: "a spectator",
        COMPUTER_ACCOUNT_METHOD: f"the account {entry.person}",
    }.get(entry.identified_by, entry.person)
    site = sites.get(entry.id // ROW_ID_STRIDE)
    return f"{who} of {site}" if site else who


def read_site_names(store: StudyStore) -> dict[int, str]:
    """Returns the names of the sites of a merged study, by site number."""
    return {site.number: site.name for site in store.read_sites()}
