"""Input profiles: how a participant selects targets and stops the robot, and how texts are presented.

The input method determines how a target is highlighted and selected. With ``head``, the participant looks at a target
until its ring is full (dwell). With ``one-switch``, the highlight moves by itself, and the switch selects (automatic
scanning). With ``two-switches``, one switch moves the highlight, and the other selects (step scanning). With
``experimenter``, the experimenter selects on the dashboard.
"""

from collections.abc import Mapping
from typing import Annotated

import msgspec
from msgspec import Meta

from avrgym.commands.input_methods import InputMethod, StopInput
from avrgym.models.body_names import PERSON_ARM_SIDES, TRACKED_BODY_PART_LABELS, Side, TrackedBodyPart
from avrgym.recording.presentation import PresentationPreferences
from avrgym.system.struct_values import convert_to_struct

_BOTH: frozenset[Side] = frozenset(PERSON_ARM_SIDES)
POINTING_ARMS: Mapping[InputMethod, frozenset[Side]] = {
    "controllers": _BOTH,
    "hands": _BOTH,
    "left-hand": frozenset({"left"}),
    "right-hand": frozenset({"right"}),
}
"""The arms with which a participant points, by input method. Methods that are not listed need no arm."""
ALLOWED_STOP_INPUTS: Mapping[InputMethod, tuple[StopInput, ...]] = {
    "controllers": ("buttons", "palm", "gaze", "experimenter"),
    "hands": ("palm", "gaze", "experimenter"),
    "left-hand": ("buttons", "palm", "gaze", "experimenter"),
    "right-hand": ("buttons", "palm", "gaze", "experimenter"),
    "head": ("gaze", "experimenter"),
    "one-switch": ("switch", "gaze", "experimenter"),
    "two-switches": ("switch", "gaze", "experimenter"),
    "experimenter": ("gaze", "experimenter"),
}
"""The stop inputs that each input method allows. By default, the first input is used; with ``experimenter``, all
inputs.
"""
SELECTION_TIME_RANGES_S: Mapping[str, tuple[float, float]] = {"dwell_s": (0.5, 3.0), "scan_s": (0.5, 10.0)}
"""Minimum and maximum of the durations in an input profile, in seconds, by field."""
MAX_KEY_NAME_LENGTH = 32
"""Maximum length of the name of a keyboard key, such as ``Enter``."""


class InputProfileError(ValueError):
    """Raised for an invalid input profile. The message contains the allowed values."""


class InputProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A participant's input profile: selection of targets, stop of the robot, and presentation of texts. Default: two
    controllers.

    Raises:
        InputProfileError: for a value out of range, or a profile without a stop input. Also for an input method that
            needs a resting or absent arm.
    """

    method: Annotated[InputMethod, Meta(description="How the participant selects.")] = "controllers"
    dwell_s: Annotated[float, Meta(description="With `head`: time until the ring is full.")] = 1.0
    scan_s: Annotated[float, Meta(description="With `one-switch`: time of the highlight on a target.")] = 1.5
    select_key: Annotated[
        str,
        Meta(
            max_length=MAX_KEY_NAME_LENGTH,
            description="With `two-switches`: the key that selects. Every other key moves the highlight.",
        ),
    ] = "Enter"
    resting_arms: Annotated[
        tuple[Side, ...], Meta(description="Arms that the participant cannot move. They rest.")
    ] = ()
    absent_arms: Annotated[
        tuple[Side, ...], Meta(description="Amputated arms. They rest and are not drawn.")
    ] = ()
    stops: Annotated[
        tuple[StopInput, ...] | None,
        Meta(description="How the participant stops the robot; default: by method."),
    ] = None
    presentation: Annotated[
        PresentationPreferences, Meta(description="How the participant reads and hears texts.")
    ] = PresentationPreferences()

    def __post_init__(self) -> None:
        for name, (low, high) in SELECTION_TIME_RANGES_S.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputProfileError(f"{name} is {value:g}; allowed: {low:g} to {high:g}")
        if not self.select_key.strip():
            raise InputProfileError("select_key is empty; allowed: the name of a key, such as Enter")
        unusable = {*self.resting_arms, *self.absent_arms}
        used = POINTING_ARMS.get(self.method, frozenset())
        if used and used <= unusable:
            raise InputProfileError(
                f"input method {self.method} needs an arm that rests or is absent; allowed: head, one-switch, "
                "two-switches, experimenter, or the other hand"
            )
        if not self.stop_inputs:
            raise InputProfileError(
                f"the profile has no way to stop the robot; allowed for {self.method}: "
                f"{', '.join(ALLOWED_STOP_INPUTS[self.method])}"
            )
        for way in self.stop_inputs:
            if way not in ALLOWED_STOP_INPUTS[self.method]:
                raise InputProfileError(
                    f"input method {self.method} cannot stop by {way}; allowed: "
                    f"{', '.join(ALLOWED_STOP_INPUTS[self.method])}"
                )

    @property
    def stop_inputs(self) -> tuple[StopInput, ...]:
        """The configured stop inputs of the participant. In addition, keys, menu buttons and the experimenter can
        always stop the robot.
        """
        possible = ALLOWED_STOP_INPUTS[self.method]
        default = possible if self.method == "experimenter" else possible[:1]
        return default if self.stops is None else self.stops

    @property
    def tracked_arms(self) -> tuple[Side, ...]:
        """The arms that are tracked during a session. All other arms rest."""
        unusable = {*self.resting_arms, *self.absent_arms}
        return tuple(
            arm
            for arm in PERSON_ARM_SIDES
            if arm in POINTING_ARMS.get(self.method, ()) and arm not in unusable
        )

    def needs_tracking(self, part: TrackedBodyPart) -> bool:
        """Returns whether a body part must be tracked: the head and ``tracked_arms``. Resting and absent arms need no
        tracking."""
        return part == "head" or part in self.tracked_arms

    def describe(self) -> str:
        """Returns a description of the profile in one line, in English."""
        settings = {
            "head": f"dwell {self.dwell_s:g} s",
            "one-switch": f"scan {self.scan_s:g} s",
            "two-switches": f"select with {self.select_key}",
        }
        arms = {
            "resting": self.resting_arms,
            "absent": self.absent_arms,
        }
        named = [f"{word}: {TRACKED_BODY_PART_LABELS[arm]}" for word, which in arms.items() for arm in which]
        stops = "stop by " + ", ".join(self.stop_inputs)
        parts = [self.method, settings.get(self.method, ""), *named, stops, self.presentation.describe()]
        return "; ".join(filter(None, parts))


DEFAULT_INPUT_PROFILE = InputProfile()
"""The default input profile: selection with two controllers."""


def parse_input_profile(values: object) -> InputProfile:
    """Returns the input profile from a table of values. Raises ``InputProfileError`` for invalid values."""
    try:
        return convert_to_struct(values, InputProfile)
    except ValueError as error:
        raise InputProfileError(str(error)) from None
