"""Validated questionnaires: items, response scales and scoring.

To add a questionnaire, define an ``Instrument`` in a module of this package, and add it to ``registry``.
"""

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Literal, NamedTuple

SCORE_DECIMALS = 9
"""Number of decimals of a score. Rounding makes scores equal that differ only by floating-point errors."""


class ResponseScale(NamedTuple):
    """Response scale of an item.

    ``points``: number of options. ``lowest``: lowest value. ``step``: difference between neighbouring values.
    """

    points: int
    lowest: int
    step: int = 1

    @property
    def highest(self) -> int:
        """The highest value of the scale."""
        return self.scale_value(self.points)

    @property
    def middle(self) -> float:
        """The mean of the lowest and the highest value."""
        return (self.lowest + self.highest) / 2

    @property
    def values(self) -> range:
        """The values of all options, in ascending order."""
        return range(self.lowest, self.highest + self.step, self.step)

    def scale_value(self, value: int) -> int:
        """Returns the value of a stored answer on this scale. ``value``: number of the option, from 1."""
        return self.lowest + (value - 1) * self.step


class InstrumentItem(NamedTuple):
    """An item of a validated questionnaire.

    ``text``: empty if the licence forbids distribution; the study's folder must then contain the text. ``low`` and
    ``high``: labels of the lowest and the highest value. ``labels``: labels of all options; empty if the screen shows
    numbers.
    """

    id: str
    text: str = ""
    low: str = ""
    high: str = ""
    labels: tuple[str, ...] = ()


class Scale(NamedTuple):
    """A scale and the computation of its score: ``factor`` times the mean or sum (``of``) of item values.

    ``reversed``: ids of reversed items. ``offset``: number that is added to each item value after reversal. ``items``:
    item ids; an item that is listed twice counts twice.
    """

    name: str
    items: tuple[str, ...]
    of: Literal["mean", "sum"] = "mean"
    factor: float = 1.0
    reversed: tuple[str, ...] = ()
    offset: int = 0


class Weighting(NamedTuple):
    """A weighted score: the weighted mean of item values.

    ``scale``: name of the weighted score. ``instrument``: name of the questionnaire that measures the weights; its
    scores are the weights. ``items``: item id that each weight multiplies, by name of the weight. Weights are integers
    from 0 to ``max_weight``. ``total``: sum of all weights.
    """

    scale: str
    instrument: str
    items: Mapping[str, str]
    max_weight: int
    total: int


class Instrument(NamedTuple):
    """A validated questionnaire.

    ``source``: publication. ``response``: response scale of all items. ``missing``: rule for missing answers. With
    ``"no score"``, the score is ``None``; with ``"centre"``, the middle of the response scale replaces the answer.
    ``texts``: source of the item texts if AVR Gym does not contain them.
    """

    name: str
    title: str
    source: str
    licence: str
    response: ResponseScale
    items: tuple[InstrumentItem, ...]
    scales: tuple[Scale, ...]
    missing: Literal["no score", "centre"] = "no score"
    weighting: Weighting | None = None
    texts: str = ""

    @property
    def scale_names(self) -> list[str]:
        """The names of all scales, including the weighted score."""
        return [scale.name for scale in self.scales] + ([self.weighting.scale] if self.weighting else [])

    def items_of(self, scale: str) -> tuple[str, ...]:
        """Returns the item ids of a scale, without duplicates."""
        if self.weighting is not None and scale == self.weighting.scale:
            return tuple(self.weighting.items.values())
        return tuple(dict.fromkeys(self._scale(scale).items))

    def range_of(self, scale: str) -> tuple[float, float]:
        """Returns the lowest and the highest possible score of a scale."""
        response = self.response
        if self.weighting is not None and scale == self.weighting.scale:
            return float(response.lowest), float(response.highest)
        found = self._scale(scale)
        ends = (_combine(found, [end] * len(found.items)) for end in (response.lowest, response.highest))
        return next(ends), next(ends)

    def score(
        self, answers: Mapping[str, int], weights: Mapping[str, int] | None = None
    ) -> dict[str, float | None]:
        """Returns the score of each scale, by scale name; ``None`` if required answers are missing.

        Args:
            answers: option number (from 1) of each answer, by item id.
            weights: the weights, with the keys of ``Weighting.items``. Without weights, the weighted score is ``None``.

        Raises:
            ValueError: for an unknown item, or for an invalid answer or weight.
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
                f"{value} is not an answer to {item}; allowed: integers from 1 to {self.response.points}"
            )
        return self.response.scale_value(value)

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
    """Raises ``ValueError`` if a weight is missing, unknown or out of range, or if the sum of weights is wrong."""
    names = ", ".join(weighting.items)
    if set(weights) != set(weighting.items):
        given = ", ".join(weights) or "no item"
        raise ValueError(f"weights are given for {given}; allowed: one weight for each of {names}")
    if not all(0 <= weight <= weighting.max_weight for weight in weights.values()):
        raise ValueError(f"a weight is out of range; allowed: integers from 0 to {weighting.max_weight}")
    total = sum(weights.values())
    if total != weighting.total:
        raise ValueError(f"the sum of the weights is {total}; allowed: {weighting.total}")


def _combine(scale: Scale, counts: Sequence[float]) -> float:
    moved = [count + scale.offset for count in counts]
    return round(scale.factor * (fmean(moved) if scale.of == "mean" else sum(moved)), SCORE_DECIMALS)


def _weighted(
    weighting: Weighting, counts: Mapping[str, float], weights: Mapping[str, int] | None
) -> float | None:
    if weights is None:
        return None
    check_weights(weighting, weights)
    if not all(item in counts for item in weighting.items.values()):
        return None
    total = sum(weights[name] * counts[item] for name, item in weighting.items.items())
    return round(total / weighting.total, SCORE_DECIMALS)
