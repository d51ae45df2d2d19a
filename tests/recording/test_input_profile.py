"""Laws of input profiles: each has a way to stop that its participant can use; impossible ones are refused."""

from itertools import product
from typing import Any, cast

import msgspec
import pytest

from avrgym.commands.input_methods import INPUT_METHODS, STOP_INPUTS
from avrgym.models.body_names import PERSON_ARM_SIDES
from avrgym.recording.input_profile import (
    ALLOWED_STOP_INPUTS,
    POINTING_ARMS,
    SELECTION_TIME_RANGES_S,
    InputProfile,
    InputProfileError,
    parse_input_profile,
)


@pytest.mark.parametrize("method", INPUT_METHODS)
def test_each_method_has_a_stop_without_hands_where_it_needs_none(method: Any) -> None:
    profile = InputProfile(method)
    assert profile.stop_inputs
    assert set(profile.stop_inputs) <= set(STOP_INPUTS)
    assert msgspec.convert(msgspec.to_builtins(profile), InputProfile) == profile
    assert profile.needs_tracking("head")
    if method not in POINTING_ARMS:
        nobody = InputProfile(method, resting_arms=PERSON_ARM_SIDES)
        assert nobody.tracked_arms == ()
        assert not {"buttons", "palm"} & set(ALLOWED_STOP_INPUTS[method])


@pytest.mark.parametrize("method", INPUT_METHODS)
def test_a_profile_without_a_possible_stop_is_refused(method: Any) -> None:
    with pytest.raises(InputProfileError, match="no way to stop the robot; allowed for"):
        InputProfile(method, stops=())
    for way in set(STOP_INPUTS) - set(ALLOWED_STOP_INPUTS[method]):
        with pytest.raises(InputProfileError, match=f"{method} cannot stop by {way}; allowed: "):
            InputProfile(method, stops=(way,))


def test_a_method_needs_one_of_its_arms() -> None:
    for (method, arms), kind in product(POINTING_ARMS.items(), ("resting_arms", "absent_arms")):
        with pytest.raises(InputProfileError, match="needs an arm"):
            InputProfile(method, **cast(Any, {kind: tuple(sorted(arms))}))
    one = InputProfile("controllers", absent_arms=("left",))
    assert one.tracked_arms == ("right",)
    assert [part for part in ("head", "left", "right") if one.needs_tracking(part)] == ["head", "right"]


@pytest.mark.parametrize("name", SELECTION_TIME_RANGES_S)
def test_durations_are_within_their_ranges(name: str) -> None:
    low, high = SELECTION_TIME_RANGES_S[name]
    for value in (low, high):
        assert getattr(parse_input_profile({name: value}), name) == value
    for value in (0.99 * low, 1.01 * high, float("nan")):
        with pytest.raises(InputProfileError, match=f"{name} is .*; allowed: "):
            parse_input_profile({name: value})


@pytest.mark.parametrize(
    "values",
    [{"method": "telepathy"}, {"colour": "red"}, {"select_key": " "}, {"resting_arms": ["tail"]}, [], None],
)
def test_tables_that_are_no_profiles_are_refused(values: Any) -> None:
    with pytest.raises(InputProfileError):
        parse_input_profile(values)
