"""Experimenters with personal tokens. A token is shown once; the study stores only its checksum."""

import secrets
from typing import Self

from avrgym.study.design.toml_validation import NAME_PATTERN
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.audit_log import UNNAMED_PERSON
from avrgym.study.storage.database_rows import Experimenter
from avrgym.study.storage.polling_thread import PollingThread
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_rows
from avrgym.vr.server.session_links import compute_token_sha256

TOKEN_LENGTH_BYTES = 16
TOKEN_REFRESH_INTERVAL_S = 1.0
"""Interval in seconds at which a server reads the tokens. A revoked token becomes invalid within this time."""


def add_experimenter(store: StudyStore, name: str) -> str:
    """Create a personal token for an experimenter. Returns the token; the study stores only its checksum.

    Raises:
        StudyError: for an invalid name, or if the experimenter already has a token.
    """
    if not NAME_PATTERN.fullmatch(name) or name == UNNAMED_PERSON:
        raise StudyError(
            f"{name!r} is not a valid name; allowed: at most 40 letters, digits, - and _, but not {UNNAMED_PERSON}"
        )
    token = secrets.token_urlsafe(TOKEN_LENGTH_BYTES)
    with store.database.write_transaction() as connection:
        if any(each.name == name for each in find_rows(connection, Experimenter, revoked_at=None)):
            raise StudyError(
                f"{name} has a token already; revoke it first with `avrgym study revoke-experimenter`"
            )
        row = {"name": name, "token_sha256": compute_token_sha256(token), "created_at": make_utc_timestamp()}
        hash_chain.insert_row(connection, schema.EXPERIMENTER_TABLE, **row)
    return token


def revoke_experimenter(store: StudyStore, name: str) -> None:
    """Revoke the token of an experimenter. Raises ``StudyError`` if the experimenter has no token."""
    with store.database.write_transaction() as connection:
        valid = find_rows(connection, Experimenter, revoked_at=None)
        own = [each for each in valid if each.name == name]
        if not own:
            names = ", ".join(each.name for each in valid) or "nobody"
            raise StudyError(f"{name!r} has no token; allowed: {names}")
        hash_chain.update_row(
            connection, schema.EXPERIMENTER_TABLE, own[0].id, revoked_at=make_utc_timestamp()
        )


def list_experimenters(store: StudyStore) -> list[Experimenter]:
    """Returns all experimenters in the order of creation, including those with a revoked token."""
    with store.database.read_transaction() as connection:
        return find_rows(connection, Experimenter)


class ExperimenterTokens(PollingThread):
    """Context manager that finds the experimenter of a valid token. A thread reads all valid tokens every second."""

    def __init__(self, store: StudyStore) -> None:
        super().__init__("experimenters", TOKEN_REFRESH_INTERVAL_S)
        self._store = store
        self._names: dict[str, str] = {}

    def find_experimenter_name(self, token: str) -> str | None:
        """Returns the name of the experimenter with this token; ``None`` for an invalid token."""
        return self._names.get(compute_token_sha256(token))

    def poll(self) -> None:
        """Read the valid tokens from the database."""
        valid = [each for each in list_experimenters(self._store) if each.revoked_at is None]
        self._names = {each.token_sha256: each.name for each in valid}

    def __enter__(self) -> Self:
        self.poll()
        return super().__enter__()
