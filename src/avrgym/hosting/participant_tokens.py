"""Authentication of participants by their personal tokens."""

from dataclasses import asdict, dataclass
from typing import Self

from avrgym.study.people.invitations import read_pseudonyms_by_token_sha256
from avrgym.study.storage.polling_thread import PollingThread
from avrgym.study.storage.store import StudyStore
from avrgym.vr.server.authentication import AuthenticatedClient, Tokens
from avrgym.vr.server.session_links import compute_token_sha256

REFRESH_INTERVAL_S = 1.0
"""Interval in seconds at which tokens are read. A replaced token becomes invalid within this time."""


class PersonalTokenReader(PollingThread):
    """Context manager that finds the participant of a personal token.

    A thread reads all tokens every second. Requests therefore never wait for the database in the server's event loop,
    which also passes on the data of all sessions.
    """

    def __init__(self, store: StudyStore) -> None:
        super().__init__("participants", REFRESH_INTERVAL_S)
        self._store = store
        self._pseudonyms: dict[str, str] = {}

    def find_pseudonym(self, token: str) -> str | None:
        """Returns the pseudonym of the participant with this token; ``None`` for another token."""
        return self._pseudonyms.get(compute_token_sha256(token))

    def poll(self) -> None:
        """Read the tokens from the database."""
        self._pseudonyms = read_pseudonyms_by_token_sha256(self._store)

    def __enter__(self) -> Self:
        self.poll()
        return super().__enter__()


@dataclass(frozen=True)
class ParticipantTokens(Tokens):
    """Personal tokens of participants. This server rejects the shared tokens of ``Tokens``."""

    token_reader: PersonalTokenReader

    @classmethod
    def load_for_study(cls, store: StudyStore) -> Self:
        """Returns the tokens of a study's participants."""
        return cls(**asdict(Tokens.generate()), token_reader=PersonalTokenReader(store))

    def find_client_by_token(self, token: str) -> AuthenticatedClient | None:
        """Returns the participant with this token, with the pseudonym as the name; ``None`` for another token."""
        pseudonym = self.token_reader.find_pseudonym(token)
        return None if pseudonym is None else AuthenticatedClient("participant", pseudonym)
