"""The audit log of a study: actions and views, with the person. Entries are only added.

Entries contain no names of participants, notes or reasons. The hash chain reveals changed and deleted entries.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from getpass import getuser

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.rows import LogEntry, Participant, Tombstone, Trial, participant_number
from avrgym.study.storage.schema import now
from avrgym.study.storage.sites import ROWS_PER_SITE
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_all

OWN_TOKEN, SHARED_TOKEN, SPECTATORS_TOKEN, ACCOUNT = (
    "own token",
    "shared token",
    "spectator's token",
    "account",
)
KNOWN_BY = (OWN_TOKEN, SHARED_TOKEN, SPECTATORS_TOKEN, ACCOUNT)
"""Means of identification: a personal token, a shared token, or an account on the computer."""
UNNAMED = "unnamed"
"""The name of a person with a shared token."""
ADD_EXPERIMENTER, REVOKE_EXPERIMENTER = "add experimenter", "revoke experimenter"
"""Commands whose detail names an experimenter."""
REFUSED = "refused"
"""The detail of a command that changed nothing."""


@dataclass(frozen=True)
class Actor:
    """A person, and the means of identification, one of ``KNOWN_BY``."""

    name: str
    known_by: str


def account_actor() -> Actor:
    """The user of this process by the operating system, not by environment variables."""
    try:
        import pwd

        return Actor(pwd.getpwuid(os.getuid()).pw_name, ACCOUNT)
    except ModuleNotFoundError:  # Windows
        return Actor(getuser(), ACCOUNT)
    except KeyError:  # an account without a name, as in containers
        return Actor(f"account {os.getuid()}", ACCOUNT)


def add_entry(
    store: Store,
    actor: Actor,
    name: str,
    participant: str | None = None,
    detail: str = "",
    *,
    at: str | None = None,
    shows_results: bool = False,
) -> None:
    """Add an entry to a study's log.

    Args:
        store: the study.
        actor: the person.
        name: the action, such as ``export``.
        participant: the pseudonym of the participant, if the action is about one.
        detail: a detail without names of participants.
        at: the time; default: now.
        shows_results: the person saw results; the number of completed participants is stored.

    Raises:
        StudyError: when the study cannot be written.
    """
    with store.database.write() as connection:
        completed, planned = _progress(store, connection) if shows_results else (None, None)
        hash_chain.insert(
            connection,
            schema.LOG,
            id=_next_id(connection),
            at=at or now(),
            person=actor.name,
            known_by=actor.known_by,
            name=name,
            participant=_number(participant),
            detail=detail,
            completed=completed,
            planned=planned,
        )


def _number(pseudonym: str | None) -> int | None:
    """The number of a participant; ``None`` for text that is not a pseudonym."""
    try:
        return None if pseudonym is None else participant_number(pseudonym)
    except StudyError:
        return None


def _next_id(connection: sa.Connection) -> int:
    """The id after the last entry of this study; larger ids belong to merged sites."""
    ids = sa.select(sa.func.max(schema.LOG.c.id)).where(schema.LOG.c.id < ROWS_PER_SITE)
    return (connection.execute(ids).scalar() or 0) + 1


def _progress(store: Store, connection: sa.Connection) -> tuple[int | None, int | None]:
    """Numbers of completed and planned participants; ``None`` while there are no results.

    Simulated participants count only in a study without people.
    """
    everyone = find_all(connection, Participant)
    simulated = all(each.simulated for each in [*everyone, *find_all(connection, Tombstone)])
    own = {each.number: each for each in everyone if each.simulated is simulated}
    completed_trials = find_all(connection, Trial, state="completed", practice=False)
    if not any(trial.participant in own for trial in completed_trials):
        return None, None
    return sum(each.state == "completed" for each in own.values()), store.design.participants


def describe_person(entry: LogEntry, sites: Mapping[int, str]) -> str:
    """The person of an entry as text; ``sites`` are the names of merged sites by number."""
    who = {
        OWN_TOKEN: entry.person,
        SHARED_TOKEN: "an unnamed experimenter",
        SPECTATORS_TOKEN: "a spectator",
        ACCOUNT: f"the account {entry.person}",
    }.get(entry.known_by, entry.person)
    site = sites.get(entry.id // ROWS_PER_SITE)
    return f"{who} of {site}" if site else who


def site_names(store: Store) -> dict[int, str]:
    """The names of the sites that a study was merged from, by number."""
    return {site.number: site.name for site in store.sites()}
