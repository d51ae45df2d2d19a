"""NASA Task Load Index: six ratings of workload, and pairwise comparisons for their weights."""

from itertools import combinations
from types import MappingProxyType

from avrgym.questionnaires.instrument import (
    Instrument,
    InstrumentItem,
    ResponseScale,
    ScoreScale,
    ScoreWeighting,
)

CITATION = (
    "Hart and Staveland (1988), Development of NASA-TLX (Task Load Index), doi:10.1016/S0166-4115(08)62386-9; "
    "NASA Ames (1986), NASA Task Load Index v. 1.0, Paper and Pencil Package; "
    "Hart (2006), NASA-TLX; 20 years later, doi:10.1177/154193120605000909, for the raw score"
)
LICENCE = "a work of the United States government, in the public domain"
RATING_LABELS = tuple(str(value) for value in range(0, 101, 5))
WORKLOAD_FACTORS = {
    "mental": "Mental demand",
    "physical": "Physical demand",
    "temporal": "Temporal demand",
    "performance": "Performance",
    "effort": "Effort",
    "frustration": "Frustration",
}
FACTOR_PAIRS = tuple(combinations(WORKLOAD_FACTORS, 2))
"""All pairs of workload factors. Participants choose one factor of each pair."""


def _rating(factor: str, text: str, low: str = "very low", high: str = "very high") -> InstrumentItem:
    return InstrumentItem(f"tlx_{factor}", text, low, high, RATING_LABELS)


def _pair(first: str, second: str) -> InstrumentItem:
    words = WORKLOAD_FACTORS[first], WORKLOAD_FACTORS[second]
    text = "Which of the two contributed more to the workload of the task?"
    return InstrumentItem(_pair_id(first, second), text, *words, words)


def _pair_id(first: str, second: str) -> str:
    return f"tlx_{first}_or_{second}"


def _weight(factor: str) -> ScoreScale:
    """Returns the scale of a factor's weight: the number of pairs with this factor as the participant's choice.

    Pairs in which the factor is first are reversed items.
    """
    own = [pair for pair in FACTOR_PAIRS if factor in pair]
    as_first = [_pair_id(*pair) for pair in own if pair[0] == factor]
    return ScoreScale(
        factor, tuple(_pair_id(*pair) for pair in own), "sum", reversed_item_ids=tuple(as_first)
    )


NASA_TLX = Instrument(
    name="nasa-tlx",
    title="NASA Task Load Index",
    citation=CITATION,
    licence=LICENCE,
    response_scale=ResponseScale(option_count=21, lowest_value=0, step=5),
    items=(
        _rating("mental", "How mentally demanding was the task?"),
        _rating("physical", "How physically demanding was the task?"),
        _rating("temporal", "How hurried or rushed was the pace of the task?"),
        _rating(
            "performance",
            "How successful were you in accomplishing what you were asked to do?",
            "perfect",
            "failure",
        ),
        _rating("effort", "How hard did you have to work to accomplish your level of performance?"),
        _rating("frustration", "How insecure, discouraged, irritated, stressed, and annoyed were you?"),
    ),
    scales=(
        ScoreScale("raw", tuple(f"tlx_{factor}" for factor in WORKLOAD_FACTORS)),
        *(ScoreScale(factor, (f"tlx_{factor}",)) for factor in WORKLOAD_FACTORS),
    ),
    weighting=ScoreWeighting(
        scale_name="weighted",
        weights_instrument_name="nasa-tlx-weights",
        item_id_by_weight_name=MappingProxyType({factor: f"tlx_{factor}" for factor in WORKLOAD_FACTORS}),
        max_weight=5,
        weight_sum=15,
    ),
)

NASA_TLX_WEIGHTS = Instrument(
    name="nasa-tlx-weights",
    title="NASA Task Load Index, sources of workload",
    citation=CITATION,
    licence=LICENCE,
    response_scale=ResponseScale(option_count=2, lowest_value=0),
    items=tuple(_pair(*pair) for pair in FACTOR_PAIRS),
    scales=tuple(_weight(factor) for factor in WORKLOAD_FACTORS),
)
