"""Validated questionnaires: laws of all, and published examples."""

from itertools import combinations

import pytest

from avrgym.questionnaires.instrument import Instrument, ScoreScale, check_weights
from avrgym.questionnaires.nasa_tlx import WORKLOAD_FACTORS
from avrgym.questionnaires.registry import INSTRUMENTS

SCALES = [(each, scale) for each in INSTRUMENTS.values() for scale in each.scales]
WEIGHTS = {"mental": 3, "physical": 0, "temporal": 5, "performance": 1, "effort": 3, "frustration": 3}
NASA_TLX, SSQ, CSQ_VR, IPQ, SUS, JIAN_TRUST = (
    INSTRUMENTS[name] for name in ("nasa-tlx", "ssq", "csq-vr", "ipq", "sus", "jian-trust")
)
every_instrument = pytest.mark.parametrize("instrument", INSTRUMENTS.values(), ids=list(INSTRUMENTS))
every_scale = pytest.mark.parametrize(
    ("instrument", "scale"), SCALES, ids=[f"{each.name} {scale.name}" for each, scale in SCALES]
)


def answers(instrument: Instrument, value: int, **others: int) -> dict[str, int]:
    return {item.id: value for item in instrument.items} | others


# Laws


@every_scale
def test_a_score_lies_between_ends_that_answers_reach(instrument: Instrument, scale: ScoreScale) -> None:
    name, backwards = scale.name, scale.reversed_item_ids
    most = instrument.response_scale.option_count
    lowest = answers(instrument, 1) | dict.fromkeys(backwards, most)
    highest = answers(instrument, most) | dict.fromkeys(backwards, 1)
    found = [instrument.compute_scores(given)[name] for given in (lowest, highest)]
    assert found == list(instrument.compute_score_range(name))


@every_scale
def test_each_item_moves_its_scale_and_a_reversed_one_the_other_way(
    instrument: Instrument, scale: ScoreScale
) -> None:
    name, own, backwards = scale.name, scale.item_ids, scale.reversed_item_ids
    lower = instrument.compute_scores(answers(instrument, 1))[name]
    assert lower is not None
    for item in instrument.items:
        higher = instrument.compute_scores(answers(instrument, 1, **{item.id: 2}))[name]
        assert higher is not None
        direction = (higher > lower) - (higher < lower)
        assert direction == (0 if item.id not in own else -1 if item.id in backwards else 1)


@every_instrument
def test_a_missing_answer_leaves_no_score_or_counts_as_the_centre(instrument: Instrument) -> None:
    for item in instrument.items:
        rest = {key: value for key, value in answers(instrument, 1).items() if key != item.id}
        for scale, score in instrument.compute_scores(rest).items():
            if item.id in instrument.list_item_ids(scale) and instrument.missing_answer_rule == "no score":
                assert score is None
            elif instrument.weighting is None or scale != instrument.weighting.scale_name:
                assert score is not None
    assert set(instrument.compute_scores({}).values()) == {None}


@every_instrument
def test_what_no_item_allows_is_refused(instrument: Instrument) -> None:
    first, points = instrument.items[0].id, instrument.response_scale.option_count
    with pytest.raises(ValueError, match=f"has no item 'other'; allowed: {first}"):
        instrument.compute_scores({"other": 1})
    for value in (0, points + 1):
        with pytest.raises(ValueError, match=f"allowed: integers from 1 to {points}"):
            instrument.compute_scores({first: value})


@every_instrument
def test_a_record_says_where_it_comes_from_and_every_item_is_scored(instrument: Instrument) -> None:
    assert "(" in instrument.citation
    assert instrument.licence
    items = [item.id for item in instrument.items]
    assert len(set(items)) == len(items)
    assert {item for scale in instrument.scales for item in scale.item_ids} == set(items)
    assert all(bool(item.text) != bool(instrument.texts_source) for item in instrument.items)
    for item in instrument.items:
        assert len(item.option_labels) in (0, instrument.response_scale.option_count)
        if item.text:
            assert item.low_label
            assert item.high_label


# Published examples


def test_sus_as_in_brookes_example() -> None:
    """Brooke (1996), the filled-in form: contributions of 22 in all, a score of 55."""
    given = dict(zip([item.id for item in SUS.items], (5, 4, 2, 1, 2, 3, 2, 4, 5, 2), strict=True))
    assert SUS.compute_scores(given) == {"usability": 55.0}
    assert SUS.compute_scores({key: value for key, value in given.items() if key != "sus_1"}) == {
        "usability": 50.0
    }


def test_ssq_reaches_the_highest_scores_that_were_published() -> None:
    """Bimberg, Weissker and Kulik (2020), doi:10.1109/VRW50115.2020.00098."""
    assert SSQ.compute_scores(answers(SSQ, 4)) == {
        "nausea": 200.34,
        "oculomotor": 159.18,
        "disorientation": 292.32,
        "total": 235.62,
    }


def test_ssq_weighs_symptoms_as_kennedy_and_others_do() -> None:
    """Kennedy et al. (1993), table 5: a symptom counts in one or two factors, the total is of all three."""
    nausea = SSQ.compute_scores(answers(SSQ, 1, ssq_nausea=3))
    assert nausea == {"nausea": 19.08, "oculomotor": 0, "disorientation": 27.84, "total": 14.96}
    burping = SSQ.compute_scores(answers(SSQ, 1, ssq_burping=2))
    assert burping == {"nausea": 9.54, "oculomotor": 0, "disorientation": 0, "total": 3.74}


def test_csq_vr_goes_from_6_to_42() -> None:
    """Kourtesis et al. (2023): pairs of items from 2 to 14, all six from 6 to 42."""
    assert CSQ_VR.compute_score_range("total") == (6, 42)
    assert {CSQ_VR.compute_score_range(scale) for scale in ("nausea", "vestibular", "oculomotor")} == {
        (2, 14)
    }


def test_ipq_and_trust_turn_the_items_that_their_authors_turn() -> None:
    """igroup.org: SP2, INV3 and REAL1; Jian et al. (2000): the first five statements are about distrust."""
    assert IPQ.compute_scores(answers(IPQ, 1)) == {
        "general": 0.0,
        "spatial": pytest.approx(6 / 5),
        "involvement": 1.5,
        "realism": 1.5,
    }
    distrust = {f"trust_{number}": 7 if number <= 5 else 1 for number in range(1, 13)}
    assert JIAN_TRUST.compute_scores(distrust) == {"trust": 1.0}


# NASA-TLX


def test_raw_workload_is_the_mean_and_weighted_workload_divides_by_fifteen() -> None:
    """NASA Ames (1986), section 2.4: each rating times its weight, summed and divided by 15."""
    ratings = {
        "mental": 30,
        "physical": 15,
        "temporal": 60,
        "performance": 40,
        "effort": 30,
        "frustration": 40,
    }
    given = {f"tlx_{factor}": 1 + rating // 5 for factor, rating in ratings.items()}
    scores = NASA_TLX.compute_scores(given, WEIGHTS)
    assert scores["raw"] == pytest.approx(215 / 6)
    assert scores["weighted"] == pytest.approx((90 + 0 + 300 + 40 + 90 + 120) / 15)
    assert {factor: scores[factor] for factor in WORKLOAD_FACTORS} == ratings
    assert NASA_TLX.compute_scores(given)["weighted"] is None


def test_equal_ratings_give_themselves_whatever_the_weights() -> None:
    scores = NASA_TLX.compute_scores(answers(NASA_TLX, 8), WEIGHTS)
    assert scores["weighted"] == scores["raw"] == 35


def test_weights_count_how_often_a_factor_was_chosen_and_always_add_up() -> None:
    weights = INSTRUMENTS["nasa-tlx-weights"]
    pairs = list(combinations(WORKLOAD_FACTORS, 2))
    assert [item.id for item in weights.items] == [f"tlx_{a}_or_{b}" for a, b in pairs]
    assert NASA_TLX.weighting is not None
    for seed in range(20):
        given = {item.id: 1 + (seed * 7 + place * place) % 2 for place, item in enumerate(weights.items)}
        chosen = [pair[value - 1] for pair, value in zip(pairs, given.values(), strict=True)]
        scores = weights.compute_scores(given)
        assert scores == {factor: chosen.count(factor) for factor in WORKLOAD_FACTORS}
        check_weights(NASA_TLX.weighting, {name: round(value or 0) for name, value in scores.items()})


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"mental": 4}, "the sum of the weights is 16; allowed: 15"),
        ({"mental": 6, "temporal": 2}, "allowed: integers from 0 to 5"),
        ({"luck": 0}, "allowed: one weight for each of mental, physical"),
    ],
)
def test_other_weights_are_refused(changed: dict[str, int], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        NASA_TLX.compute_scores(answers(NASA_TLX, 1), WEIGHTS | changed)
