"""Authentication of participants by their personal tokens."""

from dataclasses import asdict, dataclass
from typing import Self

from avrgym.study.people.invitations import personal_tokens
from avrgym.study.storage.polling import PollingThread
from avrgym.study.storage.store import Store
from avrgym.vr.server.authentication import AuthenticatedClient, Tokens
from avrgym.vr.server.session_links import token_sha256

REFRESH_INTERVAL_S = 1.0
"""Interval in seconds at which tokens are read. A replaced token becomes invalid within this time."""


class InvitedParticipants(PollingThread):
    """Context manager that finds the participant of a personal token.

    A thread reads all tokens every second. Requests therefore never wait for the database in the server's event loop,
    which also passes on the data of all sessions.
    """

    def __init__(self, store: Store) -> None:
        super().__init__("participants", REFRESH_INTERVAL_S)
        self._store = store
        self._pseudonyms: dict[str, str] = {}

    def pseudonym(self, token: str) -> str | None:
        """Returns the pseudonym of the participant with this token; ``None`` for another token."""
        return self._pseudonyms.get(token_sha256(token))

    def poll(self) -> None:
        """Read the tokens from the database."""
        self._pseudonyms = personal_tokens(self._store)

    def __enter__(self) -> Self:
        self.poll()
        return super().__enter__()


@dataclass(frozen=True)
class ParticipantTokens(Tokens):
    """Personal tokens of participants. This server rejects the shared tokens of ``Tokens``."""

    participants: InvitedParticipants

    @classmethod
    def of_study(cls, store: Store) -> Self:
        """Returns the tokens of a study's participants."""
        return cls(**asdict(Tokens.new()), participants=InvitedParticipants(store))

    def client_of_token(self, token: str) -> AuthenticatedClient | None:
        """Returns the participant with this token, with the pseudonym as the name; ``None`` for another token."""
        pseudonym = self.participants.pseudonym(token)
        return None if pseudonym is None else AuthenticatedClient("participant", pseudonym)
