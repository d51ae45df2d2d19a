"""The rows of the tables by site, which a study of several sites has."""

from dataclasses import dataclass

from avrgym.analysis.rows import Outcome


@dataclass(frozen=True, kw_only=True)
class SiteOutcomeRow(Outcome):
    """A condition's counted trials at one site."""

    site: str


@dataclass(frozen=True, kw_only=True)
class SiteEffectRow:
    """An effect at one site, each participant one value; see ``TestedRow``. It is described, not tested."""

    simulated: bool
    site: str
    family: str
    quantity: str
    group_a: str
    group_b: str
    n: int
    zeros: int
    median_a: float | None
    median_b: float | None
    effect: float | None
    effect_low: float | None
    effect_high: float | None
