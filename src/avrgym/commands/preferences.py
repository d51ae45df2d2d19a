"""Commands and sources of a study's condition, and the preferences of a participant.

``study.toml`` and the database store these records. Invalid combinations are rejected.
"""

from collections.abc import Collection, Sequence
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from avrgym.commands.vocabulary import ROBOT_COMMANDS, CommandName, CommandSource, find_allowed_commands
from avrgym.system.struct_values import convert_to_struct

MIN_SPEED_FACTOR, MAX_SPEED_FACTOR, SPEED_FACTOR_STEP = 0.25, 1.25, 0.25
"""Minimum and maximum factor of the policy's speed. The third value is its change by the commands ``slower`` and
``faster``."""
MIN_WAITING_DISTANCE_M, MAX_WAITING_DISTANCE_M, WAITING_DISTANCE_STEP_M = 0.05, 0.40, 0.05
"""Minimum and maximum distance in metres of the tool from the person at the waiting pose. The third value is its change
by the commands ``closer`` and ``farther``."""
DEFAULT_FORCE_LIMIT_FRACTION = 0.5
"""Share of the quasi-static limits of ISO/TS 15066 at which the force guard retracts the arm by default."""

PreferredSide = Literal["any", "left", "right"]
BiteTiming = Literal["on_cue", "after_swallowing", "with_company"]
SpeedFactor = Annotated[float, Meta(ge=MIN_SPEED_FACTOR, le=MAX_SPEED_FACTOR)]
WaitingDistance = Annotated[float, Meta(ge=MIN_WAITING_DISTANCE_M, le=MAX_WAITING_DISTANCE_M)]


class GestureThresholds(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Thresholds of nod, shake and gaze; see ``commands.head_motion``."""

    swing_deg: Annotated[float, Meta(ge=2, le=30)] = 6.0
    """Minimum angle of a swing of the head in degrees, peak to peak."""
    swings: Annotated[int, Meta(ge=2, le=6)] = 3
    """Minimum number of swings of a nod or shake, in alternating directions."""
    gaze_deg: Annotated[float, Meta(ge=5, le=45)] = 20.0
    """Maximum angle in degrees between head direction and tool for gaze at the tool."""
    gaze_s: Annotated[float, Meta(ge=0.5, le=5)] = 1.5
    """Minimum duration in seconds of gaze at the tool, or away from it, that gives a command."""


class Preferences(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """A participant's preferences for the robot. ``None``: the value of the condition applies.

    Attributes:
        speed: factor of the policy's speed.
        distance_m: distance between tool and mouth or arm at the waiting pose.
        side: side of the participant on which the robot waits.
        bite_timing: condition for leaving the waiting pose. ``on_cue``: the command ``ready``. ``after_swallowing``:
            ``pause_s`` has passed. ``with_company``: ``pause_s`` has passed and the head faces the tool.
        pause_s: see ``bite_timing``.
        force_share: share of the force limits of ISO/TS 15066 at which the force guard retracts the arm.
        commands, sources: selected commands and their sources.
        thresholds: thresholds of head gestures and gaze.

    Raises:
        ValueError: for values that are out of range or contradict each other.
    """

    speed: SpeedFactor = 1.0
    distance_m: WaitingDistance = 0.15
    side: PreferredSide = "any"
    bite_timing: BiteTiming = "on_cue"
    pause_s: Annotated[float, Meta(ge=0.5, le=60)] = 4.0
    force_share: float = DEFAULT_FORCE_LIMIT_FRACTION
    commands: tuple[CommandName, ...] | None = None
    sources: tuple[CommandSource, ...] | None = None
    thresholds: GestureThresholds | None = None

    def __post_init__(self) -> None:
        if not 0.05 <= self.force_share <= DEFAULT_FORCE_LIMIT_FRACTION:
            raise ValueError(
                f"force_share is {self.force_share:g}; allowed: 0.05 to {DEFAULT_FORCE_LIMIT_FRACTION:g}, because a "
                f"preference "
                "can only lower the force limits of the guard"
            )
        for name, values in (("commands", self.commands), ("sources", self.sources)):
            if values is not None and len(set(values)) < len(values):
                raise ValueError(f"{name} contains a name twice; allowed: each name once")

    @property
    def continues_without_command(self) -> bool:
        """Whether the robot leaves its waiting pose without the command ``ready``."""
        return self.bite_timing != "on_cue"


DEFAULT_PREFERENCES = Preferences()


def change_preferences(preferences: Preferences, changes: Sequence[str]) -> Preferences:
    """Returns preferences with changes from texts ``name=value``. Items of lists are separated by commas.

    Allowed names are the fields of ``Preferences`` and of ``GestureThresholds``.

    Raises:
        ValueError: for an unknown name, or a value that is not allowed.
    """
    values = msgspec.to_builtins(preferences)
    own = [name for name in Preferences.__struct_fields__ if name != "thresholds"]
    for change in changes:
        name, _, text = (part.strip() for part in change.partition("="))
        if name in GestureThresholds.__struct_fields__:
            values["thresholds"] = {**(values.get("thresholds") or {}), name: text}
        elif name in ("commands", "sources"):
            values[name] = [word.strip() for word in text.split(",") if word.strip()]
        elif name in own:
            values[name] = text
        else:
            allowed = ", ".join((*own, *GestureThresholds.__struct_fields__))
            raise ValueError(f"unknown preference {name!r}; allowed: {allowed}")
    return convert_to_struct(values, Preferences, strict=False)


class ConditionRules(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """Rules of a condition: the policy, and the commands of participants to the robot.

    ``commands``: the allowed commands; without commands the robot is autonomous. ``sources``: the allowed sources of
    commands. ``pacing``: whether the pacing layer executes the commands; otherwise only the controller receives them.
    ``preferences``: whether the participants' preferences replace ``defaults``.
    """

    policy: str
    commands: tuple[CommandName, ...] = ()
    sources: tuple[CommandSource, ...] = ()
    pacing: bool = True
    preferences: bool = False
    defaults: Preferences = DEFAULT_PREFERENCES
    thresholds: GestureThresholds = GestureThresholds()

    @property
    def uses_pacing_layer(self) -> bool:
        """Whether the control loop contains the pacing layer, which executes commands."""
        return bool(self.commands) or self.preferences or self.defaults != DEFAULT_PREFERENCES


class TrialRules(msgspec.Struct, frozen=True, omit_defaults=True, kw_only=True):
    """Rules of one trial: the rules of the condition with the participant's preferences."""

    policy: str
    commands: tuple[CommandName, ...]
    sources: tuple[CommandSource, ...]
    pacing: bool
    preferences: Preferences
    thresholds: GestureThresholds

    def find_rejection_reason(self, command: CommandName, source: CommandSource) -> str:
        """Returns the reason why a command is rejected; empty if it is allowed."""
        if source not in self.sources:
            allowed = ", ".join(self.sources) or "none"
            return f"{source} is not a source of commands in this trial; allowed: {allowed}"
        if command not in self.commands:
            return f"{command} is not a command of this trial; allowed: {', '.join(self.commands)}"
        if command not in find_allowed_commands(source):
            return f"{source} cannot give {command}; allowed: {', '.join(find_allowed_commands(source))}"
        return ""


def apply_preferences(rules: ConditionRules, own: Preferences | None) -> TrialRules:
    """Returns the rules of a trial. The participant's preferences apply if the condition allows it.

    Raises:
        ValueError: if preferences and condition contradict each other.
    """
    preferences = own if rules.preferences and own is not None else rules.defaults
    applied = TrialRules(
        policy=rules.policy,
        commands=_chosen("commands", rules.commands, preferences.commands),
        sources=_chosen("sources", rules.sources, preferences.sources),
        pacing=rules.pacing,
        preferences=preferences,
        thresholds=preferences.thresholds or rules.thresholds,
    )
    fault = find_contradiction(applied)
    if fault:
        raise ValueError(fault)
    return applied


def find_contradiction(rules: TrialRules) -> str:
    """Returns a text about the first contradiction in the rules of a trial; empty without a contradiction."""
    if not rules.commands:
        return (
            "" if not rules.sources else "the condition has sources but no commands; allowed: both or neither"
        )
    if "stop" not in rules.commands:
        return "the commands do not contain stop; add stop"
    if not rules.sources:
        return "the condition has commands but no source; allowed: one source or more"
    given = {command for source in rules.sources for command in find_allowed_commands(source)}
    if (
        rules.pacing
        and not rules.preferences.continues_without_command
        and "ready" not in given & {*rules.commands}
    ):
        return (
            "the robot waits for the command ready, but no source gives it; add a source of ready, or set bite_timing "
            "to after_swallowing or with_company"
        )
    return ""


def _chosen(name: str, allowed: Sequence[Any], wanted: Sequence[Any] | None) -> tuple[Any, ...]:
    """Returns the wanted values in the order of the allowed values; all allowed values if ``wanted`` is ``None``."""
    if wanted is None:
        return tuple(allowed)
    other = [each for each in wanted if each not in allowed]
    if other and allowed:
        raise ValueError(
            f"{name} of the preferences contains {other[0]}; allowed in this condition: {', '.join(allowed)}"
        )
    return tuple(each for each in allowed if each in wanted)


_WORDS: dict[str, dict[str, str]] = {
    "en": {
        "speed": "The robot moves at {speed:.0%} of its usual speed.",
        "distance": "It waits {distance:.0f} cm away from you{side}.",
        "any": "",
        "left": ", on your left",
        "right": ", on your right",
        "on_cue": "It continues when you tell it that you are ready.",
        "after_swallowing": "It continues by itself after {pause:g} seconds.",
        "with_company": "It continues by itself after {pause:g} seconds, when you face it.",
        "force": "It pulls back when it presses on you with {force:.0%} of the standard's force limit.",
        "commands": "Your commands: {commands}.",
    },
    "de": {
        "speed": "Der Roboter bewegt sich mit {speed:.0%} seiner üblichen Geschwindigkeit.",
        "distance": "Er wartet {distance:.0f} cm von Ihnen entfernt{side}.",
        "any": "",
        "left": ", links von Ihnen",
        "right": ", rechts von Ihnen",
        "on_cue": "Er macht weiter, wenn Sie ihm zeigen, dass Sie bereit sind.",
        "after_swallowing": "Er macht nach {pause:g} Sekunden von selbst weiter.",
        "with_company": "Er macht nach {pause:g} Sekunden von selbst weiter, wenn Sie sich ihm zuwenden.",
        "force": "Er weicht zurück, wenn er mit {force:.0%} der Kraftgrenze der Norm auf Sie drückt.",
        "commands": "Ihre Befehle: {commands}.",
    },
}


def describe_preferences(preferences: Preferences, language: str = "en") -> str:
    """Returns the preferences as sentences for the participant, in German or English (for all other languages)."""
    words = _WORDS.get(language.partition("-")[0], _WORDS["en"])
    keys: Collection[str] = ("speed", "distance", preferences.bite_timing, "force")
    if preferences.commands is not None:
        keys = (*keys, "commands")
    labels = [ROBOT_COMMANDS[name].localized_label(language) for name in preferences.commands or ()]
    return " ".join(
        words[key].format(
            speed=preferences.speed,
            distance=100.0 * preferences.distance_m,
            side=words[preferences.side],
            pause=preferences.pause_s,
            force=preferences.force_share,
            commands=", ".join(labels),
        )
        for key in keys
    )
