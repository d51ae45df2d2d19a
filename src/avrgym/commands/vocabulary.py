"""Commands of a participant to the robot: names, meanings, texts and sources."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

CommandName = Literal["ready", "wait", "slower", "faster", "closer", "farther", "other_side", "again", "stop"]
HeadCommandSource = Literal["nod", "shake", "gaze"]
"""Sources of commands that the server detects from tracking."""
ClientCommandSource = Literal["dwell", "switch", "button", "key"]
"""Sources of commands that the participant's client reports."""
OtherPersonCommandSource = Literal["caregiver", "experimenter"]
"""Sources of commands that the pages of caregiver and experimenter report."""
CommandSource = HeadCommandSource | ClientCommandSource | OtherPersonCommandSource
"""Source of a command: head gesture, gaze at or away from the tool, dwell on an icon, switch, button of page or
gamepad, key, or another person."""


@dataclass(frozen=True)
class RobotCommand:
    """A command to the robot: its meaning, and its label by language."""

    meaning: str
    labels: Mapping[str, str]

    def localized_label(self, language: str) -> str:
        """Returns the label in a language such as ``de`` or ``de-AT``; in English if the language has no label."""
        return self.labels.get(language.partition("-")[0], self.labels["en"])


ROBOT_COMMANDS: Mapping[CommandName, RobotCommand] = {
    "ready": RobotCommand(
        "the robot continues from its waiting pose to mouth or arm", {"en": "Ready", "de": "Bereit"}
    ),
    "wait": RobotCommand(
        "the robot backs off to the preferred distance and waits", {"en": "Wait", "de": "Warten"}
    ),
    "slower": RobotCommand("the robot moves more slowly", {"en": "Slower", "de": "Langsamer"}),
    "faster": RobotCommand("the robot moves faster, within its limits", {"en": "Faster", "de": "Schneller"}),
    "closer": RobotCommand("the robot waits at a smaller distance", {"en": "Closer", "de": "Näher"}),
    "farther": RobotCommand(
        "the robot backs off, and waits at a larger distance", {"en": "Farther", "de": "Weiter weg"}
    ),
    "other_side": RobotCommand(
        "the robot backs off and waits on the other side", {"en": "Other side", "de": "Andere Seite"}
    ),
    "again": RobotCommand(
        "the robot approaches once more, also after its withdrawal", {"en": "Again", "de": "Noch einmal"}
    ),
    "stop": RobotCommand("the robot stops immediately, and the attempt ends", {"en": "Stop", "de": "Stopp"}),
}
"""All commands by name, in the order of buttons and keys."""
COMMAND_NAMES: tuple[CommandName, ...] = get_args(CommandName)
COMMAND_INDEX: Mapping[str, int] = {name: index for index, name in enumerate(COMMAND_NAMES)}
HEAD_COMMAND_SOURCES: tuple[HeadCommandSource, ...] = get_args(HeadCommandSource)
CLIENT_COMMAND_SOURCES: tuple[ClientCommandSource, ...] = get_args(ClientCommandSource)
OTHER_PERSON_COMMAND_SOURCES: tuple[OtherPersonCommandSource, ...] = get_args(OtherPersonCommandSource)
COMMAND_SOURCES: tuple[CommandSource, ...] = (
    *HEAD_COMMAND_SOURCES,
    *CLIENT_COMMAND_SOURCES,
    *OTHER_PERSON_COMMAND_SOURCES,
)

ALLOWED_COMMANDS_BY_SOURCE: Mapping[str, tuple[CommandName, ...]] = {
    "nod": ("ready",),
    "shake": ("wait",),
    "gaze": ("ready", "wait"),
}
"""Allowed commands by source. Sources that are not listed can give every command."""


def find_allowed_commands(source: CommandSource) -> tuple[CommandName, ...]:
    """Returns the names of the commands that a source can give."""
    return ALLOWED_COMMANDS_BY_SOURCE.get(source, COMMAND_NAMES)
