"""The row of the table of models; like those of ``rows`` it says whether it is about simulated participants."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """An effect in a model of a ``quantity``: how ``group_a`` differs from ``group_b``, all else being equal.

    Effects of one ``family`` are corrected together. ``estimate`` with its 95 % interval is in log odds for an
    ``ordinal`` or ``logistic`` model, where ``odds_ratio`` stands beside it, and in the quantity's own unit for a
    ``mixed`` one. ``df`` are the degrees of freedom of Student's t. ``without_one`` counts the models that could be
    fitted without one participant, with the least and greatest of their estimates and p. ``role`` is what the effect
    is for its question; ``p_primary`` of primary results is p corrected over all of them, ``mark`` stars it.
    ``planned`` is ``confirmatory`` where the study's frozen plan names the effect, else ``exploratory``. ``note`` says
    what was left out, why there is no estimate, or that a mixed model is singular.
    """

    simulated: bool
    family: str
    quantity: str
    model: str
    effect: str
    group_a: str
    group_b: str
    participants: int
    values: int
    estimate: float | None = None
    error: float | None = None
    df: float | None = None
    low: float | None = None
    high: float | None = None
    odds_ratio: float | None = None
    odds_ratio_low: float | None = None
    odds_ratio_high: float | None = None
    p: float | None = None
    p_holm: float | None = None
    p_primary: float | None = None
    mark: str = ""
    without_one: int = 0
    without_one_least: float | None = None
    without_one_most: float | None = None
    without_one_p_least: float | None = None
    without_one_p_most: float | None = None
    role: str = ""
    planned: str = ""
    note: str = ""
