"""Events of a session. Each event is a record of plain values.

A session reports each event to its observer, for example a database, before it continues. ``time_s`` is the time since
the session's start. Trials and attempts are numbered from 1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from avrgym.commands.preferences import Preferences
from avrgym.commands.vocabulary import CommandName, CommandSource
from avrgym.models.body_names import TrackedBodyPart
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Sex
from avrgym.recording.configuration import HeadsetCheck
from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE, InputProfile
from avrgym.recording.schema import Answer, AttemptEnd
from avrgym.vr.protocol.messages import PhaseName, StopMethod, Visibility

Initiator = Literal["participant", "experimenter", "caregiver"]


@dataclass(frozen=True)
class SessionEvent:
    """Base of all events. ``time_s``: time of the event since the session's start."""

    time_s: float


@dataclass(frozen=True)
class PhaseEntered(SessionEvent):
    """The session entered a phase; ``trial`` is the running or next trial."""

    phase: PhaseName
    trial: int


@dataclass(frozen=True)
class HeadsetChecked(SessionEvent):
    """The headset check has ended. The event contains its measurements."""

    check: HeadsetCheck


@dataclass(frozen=True)
class HeadsetCheckSkipped(SessionEvent):
    """The experimenter skipped the headset check."""


@dataclass(frozen=True)
class Calibrated(SessionEvent):
    """The participant's position and orientation are known. ``measured``: whether the torso height was measured too."""

    torso_height_m: float
    measured: bool


@dataclass(frozen=True)
class ReachMeasured(SessionEvent):
    """The length of the participant's arms was measured. ``arm_scale``: this length divided by the mean for their torso
    height."""

    arm_scale: float


@dataclass(frozen=True)
class SeatFollowed(SessionEvent):
    """The participant has slid on the seat, and the virtual seat follows. The event contains the distance."""

    way_m: float


@dataclass(frozen=True)
class TorsoHeightCorrected(SessionEvent):
    """The experimenter corrected the participant's torso height to this value."""

    torso_height_m: float


@dataclass(frozen=True)
class BodyChosen(SessionEvent):
    """The participant or the experimenter chose the participant's body."""

    sex: Sex
    skin_tone: str


@dataclass(frozen=True)
class InputChanged(SessionEvent):
    """The experimenter changed how the participant selects and stops."""

    profile: InputProfile


@dataclass(frozen=True)
class FurnitureMeasured(SessionEvent):
    """The experimenter measured the participant's own seat or bed with a controller."""

    furniture: RealFurniture


@dataclass(frozen=True)
class PreferencesChanged(SessionEvent):
    """The participant changed their preferences for the robot to these values."""

    preferences: Preferences


@dataclass(frozen=True)
class TrialBegun(SessionEvent):
    """An attempt at a trial has started and is recorded."""

    trial: int
    attempt: int
    recording: Path
    input_profile: InputProfile = DEFAULT_INPUT_PROFILE


@dataclass(frozen=True)
class TrialEnded(SessionEvent):
    """An attempt has ended. ``complete``: whether its recording is closed and complete."""

    trial: int
    attempt: int
    recording: Path
    result: AttemptEnd
    complete: bool
    steps: int
    reward: float
    success: bool


@dataclass(frozen=True)
class TrialSkipped(SessionEvent):
    """The experimenter skipped the trial with this number."""

    trial: int


@dataclass(frozen=True)
class Answered(SessionEvent):
    """The participant answered one item about this attempt."""

    trial: int
    attempt: int
    answer: Answer


@dataclass(frozen=True)
class AnswerChanged(Answered):
    """The participant went back to an item and changed the answer."""


@dataclass(frozen=True)
class QuestionsLeft(SessionEvent):
    """The experimenter continued without the answers to these items. The trial is complete."""

    trial: int
    attempt: int
    items: tuple[str, ...]


@dataclass(frozen=True)
class Stopped(SessionEvent):
    """The robot was stopped. ``way`` is the participant's stop method, ``by`` the role that stopped the robot."""

    by: Initiator
    way: StopMethod | None = None


@dataclass(frozen=True)
class RobotCommanded(SessionEvent):
    """The participant gave the robot a command."""

    name: CommandName
    source: CommandSource


@dataclass(frozen=True)
class CommandIgnored(SessionEvent):
    """A command to the robot was ignored. ``reason`` explains why."""

    name: CommandName
    source: CommandSource
    reason: str


@dataclass(frozen=True)
class Paused(SessionEvent):
    """The experimenter paused the session: no trial starts."""


@dataclass(frozen=True)
class StopRuleMet(SessionEvent):
    """An answer met a stop rule. ``then`` is ``pause`` or ``end``: the effect on the session. ``why`` is the reason as
    text."""

    then: str
    why: str


@dataclass(frozen=True)
class BreakRequested(SessionEvent):
    """The participant or the experimenter requested a break before the next trial."""

    by: Initiator


@dataclass(frozen=True)
class BreakBegun(SessionEvent):
    """A break between two trials has begun."""


@dataclass(frozen=True)
class BreakEnded(SessionEvent):
    """The participant ended the break."""


@dataclass(frozen=True)
class AnsweredAfterBreak(SessionEvent):
    """The participant answered an item after a break."""

    answer: Answer


@dataclass(frozen=True)
class HeadsetUsed(SessionEvent):
    """The participant was in VR for ``seconds`` since the previous event of this class."""

    seconds: float


@dataclass(frozen=True)
class Continued(SessionEvent):
    """The experimenter continued the session: trials may start."""


@dataclass(frozen=True)
class TrackingLost(SessionEvent):
    """A part of the body that the task needs is no longer tracked. The simulated part does not move."""

    part: TrackedBodyPart


@dataclass(frozen=True)
class TrackingFound(SessionEvent):
    """A part of the body that the task needs is tracked again, or is no longer needed."""

    part: TrackedBodyPart


@dataclass(frozen=True)
class TrackingTimedOut(SessionEvent):
    """A part of the body that the task needs was untracked for too long. The attempt ends."""

    part: TrackedBodyPart


@dataclass(frozen=True)
class VisibilityLost(SessionEvent):
    """The participant no longer sees the scene and cannot act in it."""

    visibility: Visibility


@dataclass(frozen=True)
class VisibilityFound(SessionEvent):
    """The participant sees the scene again."""


@dataclass(frozen=True)
class TimeLost(SessionEvent):
    """The process was suspended for ``seconds`` during an attempt."""

    seconds: float


@dataclass(frozen=True)
class ControllerFailed(SessionEvent):
    """The robot stops, because its controller returns no action; see ``policies.controllers.ControllerError``."""

    reason: str


@dataclass(frozen=True)
class ConnectionLost(SessionEvent):
    """The connection of the participant's client is lost."""


@dataclass(frozen=True)
class ConnectionFound(SessionEvent):
    """The participant's client has connected, for the first time or again."""


@dataclass(frozen=True)
class StreamLost(SessionEvent):
    """The stream of another device is lost; the session continues without it."""

    stream: str


@dataclass(frozen=True)
class StreamFound(SessionEvent):
    """The stream of another device is available, or available again."""

    stream: str


EventObserver = Callable[[SessionEvent], None]


class EventSink:
    """Reports every event to an observer. ``failure``: the latest error that prevented the storage of an event."""

    def __init__(self, observe: EventObserver, stored: Callable[[], bool]) -> None:
        """``observe`` receives each event; ``stored`` returns whether all events are stored. Both may raise an
        error."""
        self.storage_error: Exception | None = None
        self._observe, self._stored = observe, stored

    def report(self, event: SessionEvent) -> None:
        """Report an event to the observer. If the observer raises an error, the error is stored in ``failure``."""
        try:
            self._observe(event)
        except Exception as error:  # any error of a database
            self.storage_error = error

    def has_stored_all_events(self) -> bool:
        """Returns whether all events are stored. If the observer raises an error, the error is stored in
        ``failure``."""
        try:
            return self._stored()
        except Exception as error:  # any error of a database
            self.storage_error = error
            return False

    def pop_storage_error(self) -> Exception | None:
        """Returns ``failure``, and sets it to ``None``."""
        failure, self.storage_error = self.storage_error, None
        return failure

    def clear_storage_errors(self) -> None:
        """Clear ``failure``. All errors of the observer until now are discarded."""
        self.has_stored_all_events()
        self.storage_error = None
