"""The tokens of a study: those of the roles, and those of experimenters with names."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

from avrgym.study.people.experimenters import Experimenters
from avrgym.vr.server.access import Caller, Tokens


@dataclass(frozen=True)
class StudyTokens(Tokens):
    """Tokens of the roles, of which that of ``experimenter`` names nobody, and of experimenters with their own."""

    experimenters: Experimenters

    @classmethod
    def of_study(cls, path: Path, experimenters: Experimenters) -> Self:
        """Those in a file, with those of experimenters; ``ValueError`` for a file that holds none."""
        return cls(**asdict(Tokens.kept(path)), experimenters=experimenters)

    def caller(self, token: str) -> Caller | None:
        """Whose token this is."""
        name = self.experimenters.name_of(token)
        return super().caller(token) if name is None else Caller("experimenter", name)
