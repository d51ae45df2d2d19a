"""Tokens of experimenters and spectators, and session links of participants and caregivers."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Self

from avrgym.study.people.experimenters import Experimenters
from avrgym.vr.server.authentication import ENTER_CODE, LINK_ENDED, Caller, Refusal, Tokens
from avrgym.vr.server.session_links import SessionLinks


@dataclass(frozen=True)
class StudyTokens(Tokens):
    """Shared tokens for roles, personal tokens of experimenters, and session links of participants and caregivers.

    The shared token for ``participant`` is invalid: participants use the link of their session.
    """

    experimenters: Experimenters
    links: SessionLinks
    caregiver_links: SessionLinks = field(default_factory=SessionLinks)

    @classmethod
    def of_study(
        cls,
        path: Path,
        experimenters: Experimenters,
        links: SessionLinks,
        caregiver_links: SessionLinks | None = None,
    ) -> Self:
        """Returns the tokens of a study. The file at ``path`` contains the shared tokens.

        Raises ``ValueError`` for a file without tokens.
        """
        return cls(
            **asdict(Tokens.load_or_create(path)),
            experimenters=experimenters,
            links=links,
            caregiver_links=caregiver_links or SessionLinks(),
        )

    def caller(self, token: str) -> Caller | None:
        """Returns the role and experimenter of a token; ``None`` for an invalid token."""
        if self.links.opens(token):
            return Caller("participant")
        if self.caregiver_links.opens(token):
            return Caller("caregiver")
        name = self.experimenters.name_of(token)
        found = super().caller(token) if name is None else Caller("experimenter", name)
        return None if found == Caller("participant") else found

    def refusal(self, token: str) -> Refusal:
        """Returns the reason why a token is rejected. For an ended link, it is in the participant's language."""
        if not token:
            return ENTER_CODE
        language = self.links.language_of_expired(token) or self.caregiver_links.language_of_expired(token)
        return super().refusal(token) if language is None else replace(LINK_ENDED, language=language)
