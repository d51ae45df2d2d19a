"""The response scale of an item is that of its published questionnaire, in every language."""

import pytest

from avrgym.questionnaires.instrument import Instrument, ScoreScale
from avrgym.questionnaires.questionnaire import Item, Questionnaire, translate_items
from avrgym.questionnaires.registry import INSTRUMENTS
from avrgym.questionnaires.stop_rules import StopRule, StopRuleSet
from avrgym.texts.interface_texts import list_included_languages, read_texts

PUBLISHED = {
    "nasa-tlx": list(range(0, 101, 5)),
    "nasa-tlx-weights": [0, 1],
    "ssq": [0, 1, 2, 3],
    "csq-vr": [1, 2, 3, 4, 5, 6, 7],
    "ipq": [0, 1, 2, 3, 4, 5, 6],
    "sus": [1, 2, 3, 4, 5],
    "rosas": [1, 2, 3, 4, 5, 6, 7, 8, 9],
    "godspeed": [1, 2, 3, 4, 5],
    "jian-trust": [1, 2, 3, 4, 5, 6, 7],
}
"""The answers to each instrument's items as its source prints them (docs/how_to/design_study.md names the sources)."""
SCALES = [(each, scale) for each in INSTRUMENTS.values() for scale in each.scales]


def asked(instrument: Instrument) -> Questionnaire:
    """An instrument as a design asks it."""
    points = instrument.response_scale.option_count
    items = tuple(
        Item(item.id, item.text or "?", points, item.low_label, item.high_label, item.option_labels)
        for item in instrument.items
    )
    return Questionnaire(instrument.name, "after_trial", items, use=instrument.name)


@pytest.mark.parametrize("language", list_included_languages())
@pytest.mark.parametrize("instrument", INSTRUMENTS.values(), ids=list(INSTRUMENTS))
def test_items_are_on_their_instruments_published_scale_in_every_language(
    instrument: Instrument, language: str
) -> None:
    questionnaire = asked(instrument)
    for item in translate_items(questionnaire.items, read_texts(language)):
        scale = questionnaire.find_response_scale(item)
        shown = [scale.compute_option_value(answer) for answer in range(1, item.points + 1)]
        assert shown == PUBLISHED[instrument.name] == list(scale.values)
        assert (scale.lowest_value, scale.highest_value) == (shown[0], shown[-1])
        assert scale.middle_value == (shown[0] + shown[-1]) / 2


@pytest.mark.parametrize(
    ("instrument", "scale"), SCALES, ids=[f"{each.name} {scale.name}" for each, scale in SCALES]
)
def test_scores_follow_from_the_items_as_shown(instrument: Instrument, scale: ScoreScale) -> None:
    """Recompute scores from the columns of ``scales.csv`` alone: of, factor, reversed and offset."""
    shown = PUBLISHED[instrument.name]
    answers = {item.id: 1 + 3 * number % len(shown) for number, item in enumerate(instrument.items)}
    values = [
        scale.item_value_offset + (shown[0] + shown[-1] - value if item in scale.reversed_item_ids else value)
        for item in scale.item_ids
        for value in (shown[answers[item] - 1],)
    ]
    expected = scale.score_factor * sum(values) / (len(values) if scale.aggregation == "mean" else 1)
    assert instrument.compute_scores(answers)[scale.name] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("labels", "values"),
    [
        ((), [1, 2, 3]),
        (("never", "sometimes", "often"), [1, 2, 3]),
        (("0", "1", "2"), [0, 1, 2]),
        (("-10", "0", "10"), [-10, 0, 10]),
        (("0", "1", "5"), [1, 2, 3]),
        (("2", "1", "0"), [1, 2, 3]),
        (("0", "1", "many"), [1, 2, 3]),
    ],
)
def test_own_items_are_on_the_numbers_of_their_labels_or_from_one(
    labels: tuple[str, ...], values: list[int]
) -> None:
    item = Item("own", "How much?", 3, "little", "much", labels)
    assert list(Questionnaire("own", "after_trial", (item,)).find_response_scale(item).values) == values


def test_a_scale_is_named_with_its_words() -> None:
    load, sickness = asked(INSTRUMENTS["nasa-tlx"]), asked(INSTRUMENTS["ssq"])
    assert load.describe_response_scale(load.items[0]) == "from 0 (very low) to 100 (very high) in steps of 5"
    assert (
        sickness.describe_response_scale(sickness.items[0])
        == "0 (none), 1 (slight), 2 (moderate), 3 (severe)"
    )
    item = Item("own", "How much?", 7, "little", "much")
    assert (
        Questionnaire("own", "after_trial", (item,)).describe_response_scale(item)
        == "from 1 (little) to 7 (much)"
    )


def test_a_stop_rule_names_the_answer_on_its_scale() -> None:
    questionnaire = asked(INSTRUMENTS["ipq"])
    rules = StopRuleSet((StopRule("ipq_g1", 4.0, "pause"),), (questionnaire,))
    decision = rules.decide("ipq_g1", 5)
    assert decision is not None
    assert "was answered '4 of 6'; the limit of its stop rule is 4" in decision.reason
    assert rules.decide("ipq_g1", 4) is None
