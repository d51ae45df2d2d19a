import pytest

from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, MAX_OPTION_COUNT, validate_answer
from avrgym.vr.protocol.messages import Answer, decode_participant_message, encode_message


def test_the_ids_are_unique_and_the_anchors_are_named():
    assert [item.id for item in LIKERT_ITEMS] == ["L1", "L2", "L3", "L4"]
    assert {(item.points, item.low, item.high) for item in LIKERT_ITEMS} == {
        (7, "strongly disagree", "strongly agree")
    }


@pytest.mark.parametrize("item", LIKERT_ITEMS, ids=lambda item: item.id)
def test_every_point_of_the_scale_is_an_answer(item):
    for value in range(1, item.points + 1):
        validate_answer(LIKERT_ITEMS, item.id, value)


@pytest.mark.parametrize("value", [0, 8, -1, 4.0, True, "4", None])
def test_anything_off_the_scale_is_refused(value):
    with pytest.raises(ValueError, match="is not an answer to L2; allowed: integers from 1 to 7"):
        validate_answer(LIKERT_ITEMS, "L2", value)


def test_an_unknown_item_is_refused():
    with pytest.raises(ValueError, match="no item 'L9'; allowed: L1, L2, L3, L4"):
        validate_answer(LIKERT_ITEMS, "L9", 4)


def test_every_answer_that_a_scale_allows_can_be_sent():
    answer = Answer(item="vas", value=MAX_OPTION_COUNT, response_time_s=1.0)
    assert decode_participant_message(encode_message(answer)) == answer
