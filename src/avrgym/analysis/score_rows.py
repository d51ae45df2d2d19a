"""The rows of the tables of scores; like those of ``rows`` each says whether it is about simulated participants."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """A scale of an instrument, from the answers of one participant at one time, between ``least`` and ``most``.

    One about a whole session has no trial. ``score`` is missing where answers or weights are that it needs. ``counted``
    as for the answers that it comes from.
    """

    participant: str
    site: str | None = None
    simulated: bool
    counted: bool
    session: int
    moment: str
    position: int | None
    task: str | None
    robot: str | None
    policy: str | None
    attempt: int | None
    questionnaire: str
    instrument: str
    scale: str
    score: float | None
    least: float
    most: float
    answered: int
    items: int


@dataclass(frozen=True, kw_only=True)
class ScoreSummaryRow:
    """Counted scores of one scale: with a policy after trials, or before or after sessions, or their ``change``."""

    simulated: bool
    questionnaire: str
    scale: str
    moment: str
    policy: str | None
    n: int
    mean: float
    least: float
    lower_quartile: float
    median: float
    upper_quartile: float
    most: float
