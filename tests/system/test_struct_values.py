"""Errors about plain values contain field, value and allowed values."""

from typing import Any

import pytest

from avrgym.commands.preferences import Preferences
from avrgym.recording.input_profile import InputProfile
from avrgym.system.struct_values import convert_to_struct


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        (InputProfile, {"stops": ["palm", ""]}, "stops contains ''; allowed: buttons, experimenter, gaze"),
        (InputProfile, {"dwell_s": "long"}, "dwell_s is 'long'; allowed: a number"),
        (
            InputProfile,
            {"presentation": {"contrast": "low"}},
            "presentation.contrast is 'low'; allowed: high,",
        ),
        (InputProfile, {"presentation": {"text_deg": 9}}, "text_deg is 9; allowed: 1 to 3"),
        (InputProfile, {"select_key": 33 * "a"}, "allowed: a text of at most 32 characters"),
        (InputProfile, {"hand": 1}, "unknown name 'hand'; allowed: method, dwell_s"),
        (Preferences, {"speed": 9}, "speed is 9; allowed: 0.25 to 1.25"),
        (
            Preferences,
            {"sources": ["key", "voice"]},
            "shake, button, dwell, key, switch, caregiver, experimenter",
        ),
        (Preferences, {"commands": 5}, "commands is 5; allowed: a list"),
        (Preferences, {"thresholds": {"swings": 1}}, "thresholds.swings is 1; allowed: 2 to 6"),
    ],
)
def test_errors_name_the_field_and_the_allowed_values(kind: Any, values: Any, words: str) -> None:
    with pytest.raises(ValueError, match="allowed") as raised:
        convert_to_struct(values, kind)
    assert words in str(raised.value)


def test_texts_become_numbers_only_on_request() -> None:
    assert convert_to_struct({"speed": "0.5"}, Preferences, strict=False) == Preferences(speed=0.5)
    with pytest.raises(ValueError, match=r"speed is '0\.5'; allowed: 0\.25 to 1\.25"):
        convert_to_struct({"speed": "0.5"}, Preferences)
