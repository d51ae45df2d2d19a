"""What a validated questionnaire is: its items, what their answers count as, and the scores that follow from them."""

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Literal, NamedTuple

DIGITS = 9
"""Scores are rounded to so many decimals, so that equal answers give equal scores."""


class Response(NamedTuple):
    """The scale of an item: ``points`` answers, counted ``lowest``, ``lowest + step`` and so on."""

    points: int
    lowest: int
    step: int = 1

    @property
    def highest(self) -> int:
        """What the last answer counts as."""
        return self.counts_as(self.points)

    @property
    def middle(self) -> float:
        """The value halfway between the ends."""
        return (self.lowest + self.highest) / 2

    @property
    def values(self) -> range:
        """The values of all answers, the lowest first."""
        return range(self.lowest, self.highest + self.step, self.step)

    def counts_as(self, value: int) -> int:
        """The value of a stored answer; stored answers are numbered from 1."""
        return self.lowest + (value - 1) * self.step


class InstrumentItem(NamedTuple):
    """An item. What its licence keeps to itself is empty here: the study's folder says it.

    ``low`` and ``high`` are the words at both ends; ``labels`` those of every answer, where they are more than numbers.
    """

    id: str
    text: str = ""
    low: str = ""
    high: str = ""
    labels: tuple[str, ...] = ()


class Scale(NamedTuple):
    """A score: the ``mean`` or ``sum`` of what the answers to its items count as, times ``factor``.

    An item may be listed more than once. Those that are ``reversed`` count from the other end. ``offset`` is then added
    to each item.
    """

    name: str
    items: tuple[str, ...]
    of: Literal["mean", "sum"] = "mean"
    factor: float = 1.0
    reversed: tuple[str, ...] = ()
    offset: int = 0


class Weighting(NamedTuple):
    """A further score: the mean of items, each weighted by what another instrument's scale says, by its name.

    Weights are whole numbers from 0 to ``most``, which add up to ``total``.
    """

    scale: str
    instrument: str
    items: Mapping[str, str]
    most: int
    total: int


class Instrument(NamedTuple):
    """A validated questionnaire.

    ``missing``: with ``"no score"`` a scale of which an answer is missing has none, with ``"centre"`` a missing answer
    counts as the middle of the response. ``texts`` says where the words are that are not here.
    """

    name: str
    title: str
    source: str
    licence: str
    response: Response
    items: tuple[InstrumentItem, ...]
    scales: tuple[Scale, ...]
    missing: Literal["no score", "centre"] = "no score"
    weighting: Weighting | None = None
    texts: str = ""

    @property
    def scale_names(self) -> list[str]:
        """The names of all scores."""
        return [scale.name for scale in self.scales] + ([self.weighting.scale] if self.weighting else [])

    def items_of(self, scale: str) -> tuple[str, ...]:
        """The items of a score, each once."""
        if self.weighting is not None and scale == self.weighting.scale:
            return tuple(self.weighting.items.values())
        return tuple(dict.fromkeys(self._scale(scale).items))

    def range_of(self, scale: str) -> tuple[float, float]:
        """The lowest and the highest score that answers can give."""
        response = self.response
        if self.weighting is not None and scale == self.weighting.scale:
            return float(response.lowest), float(response.highest)
        found = self._scale(scale)
        ends = (_combine(found, [end] * len(found.items)) for end in (response.lowest, response.highest))
        return next(ends), next(ends)

    def score(
        self, answers: Mapping[str, int], weights: Mapping[str, int] | None = None
    ) -> dict[str, float | None]:
        """Every score that answers give, by the scale's name; ``None`` where too many are missing.

        Args:
            answers: by item, numbered from 1 as participants give them.
            weights: of the weighting's items; without them it gives no score.

        Raises:
            ValueError: for an item, an answer or weights that cannot be, naming what is allowed.
        """
        counts = {item: self._count(item, value) for item, value in answers.items()}
        scores = {scale.name: self._score(scale, counts) for scale in self.scales}
        if self.weighting is not None:
            scores[self.weighting.scale] = _weighted(self.weighting, counts, weights)
        return scores

    def _scale(self, name: str) -> Scale:
        return next(scale for scale in self.scales if scale.name == name)

    def _count(self, item: str, value: int) -> float:
        if item not in (own := [each.id for each in self.items]):
            raise ValueError(f"{self.name} has no item {item!r}; allowed: {', '.join(own)}")
        if not 1 <= value <= self.response.points:
            raise ValueError(
                f"{value} does not answer {item}; allowed: whole numbers from 1 to {self.response.points}"
            )
        return self.response.counts_as(value)

    def _score(self, scale: Scale, counts: Mapping[str, float]) -> float | None:
        ends = self.response.lowest + self.response.highest
        if self.missing == "centre" and counts:
            counts = {item: self.response.middle for item in scale.items} | dict(counts)
        if not all(item in counts for item in scale.items):
            return None
        return _combine(
            scale,
            [ends - counts[item] if item in scale.reversed else counts[item] for item in scale.items],
        )


def check_weights(weighting: Weighting, weights: Mapping[str, int]) -> None:
    """Raise ``ValueError``, naming what is allowed, unless these are weights of all items that add up."""
    names = ", ".join(weighting.items)
    if set(weights) != set(weighting.items):
        raise ValueError(f"weights of {', '.join(weights) or 'nothing'}; allowed: {names}, each once")
    if not all(0 <= weight <= weighting.most for weight in weights.values()):
        raise ValueError(f"a weight is beyond its ends; allowed: whole numbers from 0 to {weighting.most}")
    total = sum(weights.values())
    if total != weighting.total:
        raise ValueError(f"the weights add up to {total}; allowed: {weighting.total}")


def _combine(scale: Scale, counts: Sequence[float]) -> float:
    moved = [count + scale.offset for count in counts]
    return round(scale.factor * (fmean(moved) if scale.of == "mean" else sum(moved)), DIGITS)


def _weighted(
    weighting: Weighting, counts: Mapping[str, float], weights: Mapping[str, int] | None
) -> float | None:
    if weights is None:
        return None
    check_weights(weighting, weights)
    if not all(item in counts for item in weighting.items.values()):
        return None
    total = sum(weights[name] * counts[item] for name, item in weighting.items.items())
    return round(total / weighting.total, DIGITS)
