"""Validated questionnaires: items, response scales and scoring.

To add a questionnaire, define an ``Instrument`` in a module of this package, and add it to ``registry``.
"""

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Literal, NamedTuple

SCORE_DECIMALS = 9
"""Number of decimals of a score. Rounding makes scores equal that differ only by floating-point errors."""


class ResponseScale(NamedTuple):
    """Response scale of an item: equally spaced integer values.

    ``option_count``: number of options. ``lowest_value``: lowest value. ``step``: difference between neighbouring
    values.
    """

    option_count: int
    lowest_value: int
    step: int = 1

    @property
    def highest_value(self) -> int:
        """The highest value of the scale: the value of its last option."""
        return self.compute_option_value(self.option_count)

    @property
    def middle_value(self) -> float:
        """The mean of the lowest and the highest value."""
        return (self.lowest_value + self.highest_value) / 2

    @property
    def values(self) -> range:
        """The values of all options, in ascending order."""
        return range(self.lowest_value, self.highest_value + self.step, self.step)

    def compute_option_value(self, value: int) -> int:
        """Returns the value of a stored answer on this scale. ``value``: number of the option, from 1."""
        return self.lowest_value + (value - 1) * self.step


class InstrumentItem(NamedTuple):
    """An item of a validated questionnaire.

    ``text``: empty if the licence forbids distribution; the study's folder must then contain the text. ``low_label``
    and ``high_label``: labels of the lowest and the highest value. ``option_labels``: labels of all options; empty if
    the screen shows numbers.
    """

    id: str
    text: str = ""
    low_label: str = ""
    high_label: str = ""
    option_labels: tuple[str, ...] = ()


class ScoreScale(NamedTuple):
    """A scale and the computation of its score: ``score_factor`` times the mean or sum (``aggregation``) of item
    values.

    ``reversed_item_ids``: ids of reversed items. ``item_value_offset``: number that is added to each item value after
    reversal. ``item_ids``: item ids; an item that is listed twice has twice the weight.
    """

    name: str
    item_ids: tuple[str, ...]
    aggregation: Literal["mean", "sum"] = "mean"
    score_factor: float = 1.0
    reversed_item_ids: tuple[str, ...] = ()
    item_value_offset: int = 0


class ScoreWeighting(NamedTuple):
    """A weighted score: the weighted mean of item values.

    ``scale_name``: name of the weighted score. ``weights_instrument_name``: name of the questionnaire that measures the
    weights; its scores are the weights. ``item_id_by_weight_name``: item id that each weight multiplies, by name of
    the weight. Weights are integers from 0 to ``max_weight``. ``weight_sum``: sum of all weights.
    """

    scale_name: str
    weights_instrument_name: str
    item_id_by_weight_name: Mapping[str, str]
    max_weight: int
    weight_sum: int


class Instrument(NamedTuple):
    """A validated questionnaire.

    ``citation``: publication. ``response_scale``: response scale of all items. ``missing_answer_rule``: rule for
    missing answers. With ``"no score"``, the score is ``None``; with ``"centre"``, the middle of the response scale
    replaces the answer. ``texts_source``: source of the item texts if AVR Gym does not contain them.
    """

    name: str
    title: str
    citation: str
    licence: str
    response_scale: ResponseScale
    items: tuple[InstrumentItem, ...]
    scales: tuple[ScoreScale, ...]
    missing_answer_rule: Literal["no score", "centre"] = "no score"
    weighting: ScoreWeighting | None = None
    texts_source: str = ""

    @property
    def scale_names(self) -> list[str]:
        """The names of all scales, including the weighted score."""
        return [scale.name for scale in self.scales] + ([self.weighting.scale_name] if self.weighting else [])

    def list_item_ids(self, scale: str) -> tuple[str, ...]:
        """Returns the item ids of a scale, without duplicates."""
        if self.weighting is not None and scale == self.weighting.scale_name:
            return tuple(self.weighting.item_id_by_weight_name.values())
        return tuple(dict.fromkeys(self._scale(scale).item_ids))

    def compute_score_range(self, scale: str) -> tuple[float, float]:
        """Returns the lowest and the highest possible score of a scale."""
        response = self.response_scale
        if self.weighting is not None and scale == self.weighting.scale_name:
            return float(response.lowest_value), float(response.highest_value)
        found = self._scale(scale)
        ends = (
            _combine(found, [end] * len(found.item_ids))
            for end in (response.lowest_value, response.highest_value)
        )
        return next(ends), next(ends)

    def compute_scores(
        self, answers: Mapping[str, int], weights: Mapping[str, int] | None = None
    ) -> dict[str, float | None]:
        """Returns the score of each scale, by scale name; ``None`` if required answers are missing.

        Args:
            answers: option number (from 1) of each answer, by item id.
            weights: the weights, with the keys of ``ScoreWeighting.items``. Without weights, the weighted score is
                ``None``.

        Raises:
            ValueError: for an unknown item, or for an invalid answer or weight.
        """
        counts = {item: self._count(item, value) for item, value in answers.items()}
        scores = {scale.name: self._score(scale, counts) for scale in self.scales}
        if self.weighting is not None:
            scores[self.weighting.scale_name] = _weighted(self.weighting, counts, weights)
        return scores

    def _scale(self, name: str) -> ScoreScale:
        return next(scale for scale in self.scales if scale.name == name)

    def _count(self, item: str, value: int) -> float:
        if item not in (own := [each.id for each in self.items]):
            raise ValueError(f"{self.name} has no item {item!r}; allowed: {', '.join(own)}")
        if not 1 <= value <= self.response_scale.option_count:
            raise ValueError(
                f"{value} is not an answer to {item}; allowed: integers from 1 to {self.response_scale.option_count}"
            )
        return self.response_scale.compute_option_value(value)

    def _score(self, scale: ScoreScale, counts: Mapping[str, float]) -> float | None:
        ends = self.response_scale.lowest_value + self.response_scale.highest_value
        if self.missing_answer_rule == "centre" and counts:
            counts = {item: self.response_scale.middle_value for item in scale.item_ids} | dict(counts)
        if not all(item in counts for item in scale.item_ids):
            return None
        return _combine(
            scale,
            [
                ends - counts[item] if item in scale.reversed_item_ids else counts[item]
                for item in scale.item_ids
            ],
        )


def check_weights(weighting: ScoreWeighting, weights: Mapping[str, int]) -> None:
    """Raises ``ValueError`` if a weight is missing, unknown or out of range, or if the sum of weights is wrong."""
    names = ", ".join(weighting.item_id_by_weight_name)
    if set(weights) != set(weighting.item_id_by_weight_name):
        given = ", ".join(weights) or "no item"
        raise ValueError(f"the weights contain {given}; allowed: one weight for each of {names}")
    if not all(0 <= weight <= weighting.max_weight for weight in weights.values()):
        raise ValueError(f"a weight is out of range; allowed: integers from 0 to {weighting.max_weight}")
    total = sum(weights.values())
    if total != weighting.weight_sum:
        raise ValueError(f"the sum of the weights is {total}; allowed: {weighting.weight_sum}")


def _combine(scale: ScoreScale, counts: Sequence[float]) -> float:
    moved = [count + scale.item_value_offset for count in counts]
    return round(
        scale.score_factor * (fmean(moved) if scale.aggregation == "mean" else sum(moved)), SCORE_DECIMALS
    )


def _weighted(
    weighting: ScoreWeighting, counts: Mapping[str, float], weights: Mapping[str, int] | None
) -> float | None:
    if weights is None:
        return None
    check_weights(weighting, weights)
    if not all(item in counts for item in weighting.item_id_by_weight_name.values()):
        return None
    total = sum(weights[name] * counts[item] for name, item in weighting.item_id_by_weight_name.items())
    return round(total / weighting.weight_sum, SCORE_DECIMALS)
