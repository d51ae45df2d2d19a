"""Conditions and preferences that make no sense are refused, and each command has texts in both languages."""

from pathlib import Path

import msgspec
import pytest

from avrgym.commands.preferences import (
    ConditionRules,
    GestureThresholds,
    Preferences,
    apply_preferences,
    change_preferences,
    describe_preferences,
)
from avrgym.commands.vocabulary import COMMAND_NAMES, COMMAND_SOURCES, ROBOT_COMMANDS, find_allowed_commands
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text

ALL = {"policy": "revised", "commands": COMMAND_NAMES, "sources": COMMAND_SOURCES}
PACED = """
[conditions.paced]
policy = "revised"
commands = ["ready", "wait", "stop"]
sources = ["key", "nod"]
"""


@pytest.mark.parametrize(
    ("changes", "own", "message"),
    [
        ({"commands": ("ready", "wait")}, None, "the commands do not contain stop"),
        ({"sources": ()}, None, "commands but no source"),
        ({"commands": (), "sources": ("key",)}, None, "sources but no commands"),
        ({"sources": ("shake",)}, None, "waits for the command ready, but no source gives it"),
        ({"commands": ("wait", "stop")}, None, "waits for the command ready"),
        ({}, Preferences(commands=("ready", "wait")), "the commands do not contain stop"),
        ({"sources": ("key",)}, Preferences(sources=("nod",)), "allowed in this condition: key"),
        ({}, Preferences(sources=()), "commands but no source"),
        ({}, Preferences(sources=("shake",)), "no source gives it"),
    ],
)
def test_contradictions_are_refused(changes: dict, own: Preferences | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        apply_preferences(ConditionRules(**(ALL | changes), preferences=True), own)


@pytest.mark.parametrize(
    ("field", "value"),
    [("force_share", 0.6), ("speed", 2.0), ("distance_m", 0.0), ("side", "behind"), ("bite_timing", "never"),
     ("commands", ["jump"]), ("sources", ["telepathy"]), ("force", 1)],
)  # fmt: skip
def test_impossible_preferences_are_refused(field: str, value: object) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({field: value}, Preferences)


def test_texts_change_preferences_and_thresholds() -> None:
    changed = change_preferences(Preferences(side="left"), ["speed=0.5", "sources=nod, key", "swing_deg=4"])
    changed = change_preferences(changed, ["gaze_s=2"])
    assert changed == Preferences(
        side="left",
        speed=0.5,
        sources=("nod", "key"),
        thresholds=GestureThresholds(swing_deg=4.0, gaze_s=2.0),
    )
    for change, message in (
        ("swings=1", "thresholds.swings is '1'; allowed: 2 to 6"),
        ("thresholds=1", "unknown preference 'thresholds'; allowed: speed, .*, gaze_s"),
    ):
        with pytest.raises(ValueError, match=message):
            change_preferences(changed, [change])


def test_preferences_apply_only_where_the_condition_says_so() -> None:
    own = Preferences(speed=0.5, sources=("key",))
    for preferences, speed in ((True, 0.5), (False, 1.0)):
        applied = apply_preferences(ConditionRules(**ALL, preferences=preferences), own)
        assert applied.preferences.speed == speed
    assert not ConditionRules(policy="revised").uses_pacing_layer


def test_rules_name_the_reason_of_a_refusal() -> None:
    applied = apply_preferences(
        ConditionRules(policy="revised", commands=("ready", "stop"), sources=("key", "nod")), None
    )
    assert (
        applied.find_rejection_reason("ready", "key") == applied.find_rejection_reason("ready", "nod") == ""
    )
    assert "not a source" in applied.find_rejection_reason("ready", "switch")
    assert "not a command of this trial" in applied.find_rejection_reason("faster", "key")
    assert "nod cannot give stop" in applied.find_rejection_reason("stop", "nod")


def test_every_command_has_texts_and_every_source_commands() -> None:
    assert tuple(ROBOT_COMMANDS) == COMMAND_NAMES
    for command in ROBOT_COMMANDS.values():
        assert command.meaning
        assert command.localized_label("de-AT") == command.labels["de"]
        assert command.localized_label("fr") == command.labels["en"]
    assert all(find_allowed_commands(source) for source in COMMAND_SOURCES)


def test_preferences_are_shown_in_words() -> None:
    own = Preferences(speed=0.5, distance_m=0.2, side="left", commands=("ready", "stop"))
    assert describe_preferences(own) == (
        "The robot moves at 50% of its usual speed. It waits 20 cm away from you, on your left. It continues when you "
        "tell it that you are ready. It pulls back when it presses on you with 50% of the standard's force limit. Your "
        "commands: Ready, Stop."
    )
    assert "links von Ihnen" in describe_preferences(own, "de")


def test_a_design_names_conditions_with_their_policy() -> None:
    text = read_default_design_text().replace(
        'policies = ["original", "revised"]', 'policies = ["revised", "paced"]'
    )
    design = parse_design(text + PACED)
    assert design.find_condition_policy("paced") == "revised"
    assert design.list_fixed_field_values()["conditions"]["paced"]["sources"] == ["key", "nod"]
    assert "conditions" not in parse_design(read_default_design_text()).list_fixed_field_values()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"stop"]', '"wait"]', "twice"),
        (', "stop"]', "]", "the commands do not contain stop"),
        ('"nod"]', '"telepathy"]', "telepathy"),
        ("[conditions.paced]", "[conditions.other]", "unknown name 'other'"),
        ("sources =", "inputs =", "unknown name 'inputs'"),
        ('policy = "revised"', 'policy = "paced"', "is a condition"),
    ],
)
def test_wrong_conditions_name_their_line(old: str, new: str, message: str, tmp_path: Path) -> None:
    text = read_default_design_text().replace(
        'policies = ["original", "revised"]', 'policies = ["revised", "paced"]'
    )
    with pytest.raises(DesignError, match=rf"study.toml:\d+: .*{message}"):
        parse_design(text + PACED.replace(old, new), folder=tmp_path)
