"""Tokens of experimenters and spectators, and session links of participants and caregivers."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Self

from avrgym.study.people.experimenters import ExperimenterTokens
from avrgym.vr.server.authentication import (
    CODE_REQUIRED_REJECTION,
    EXPIRED_LINK_REJECTION,
    AuthenticatedClient,
    TokenRejection,
    Tokens,
)
from avrgym.vr.server.session_links import SessionLinks


@dataclass(frozen=True)
class StudyTokens(Tokens):
    """Shared tokens for roles, personal tokens of experimenters, and session links of participants and caregivers.

    The shared token for ``participant`` is invalid: participants use the link of their session.
    """

    experimenter_tokens: ExperimenterTokens
    participant_links: SessionLinks
    caregiver_links: SessionLinks = field(default_factory=SessionLinks)

    @classmethod
    def load_for_study(
        cls,
        path: Path,
        experimenters: ExperimenterTokens,
        links: SessionLinks,
        caregiver_links: SessionLinks | None = None,
    ) -> Self:
        """Returns the tokens of a study. The file at ``path`` contains the shared tokens.

        Raises ``ValueError`` for a file without tokens.
        """
        return cls(
            **asdict(Tokens.load_or_create(path)),
            experimenter_tokens=experimenters,
            participant_links=links,
            caregiver_links=caregiver_links or SessionLinks(),
        )

    def find_client_by_token(self, token: str) -> AuthenticatedClient | None:
        """Returns the role and experimenter of a token; ``None`` for an invalid token."""
        if self.participant_links.is_current_link_token(token):
            return AuthenticatedClient("participant")
        if self.caregiver_links.is_current_link_token(token):
            return AuthenticatedClient("caregiver")
        name = self.experimenter_tokens.find_experimenter_name(token)
        found = (
            super().find_client_by_token(token) if name is None else AuthenticatedClient("experimenter", name)
        )
        return None if found == AuthenticatedClient("participant") else found

    def find_rejection(self, token: str) -> TokenRejection:
        """Returns the reason why a token is rejected. For an ended link, it is in the participant's language."""
        if not token:
            return CODE_REQUIRED_REJECTION
        language = self.participant_links.find_expired_link_language(
            token
        ) or self.caregiver_links.find_expired_link_language(token)
        return (
            super().find_rejection(token)
            if language is None
            else replace(EXPIRED_LINK_REJECTION, language=language)
        )
