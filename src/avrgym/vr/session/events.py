"""What happens to a session, one plain record for each event.

A session tells its observer of each before it goes on, so that a database can keep them. ``time_s`` counts from the
session's beginning; trials and attempts count from 1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from avrgym.models.body_names import Part
from avrgym.models.human import Sex
from avrgym.recording.configuration import HeadsetCheck
from avrgym.recording.schema import Answer, AttemptEnd
from avrgym.vr.protocol.messages import PhaseName, StopWay, Visibility

Who = Literal["participant", "experimenter"]


@dataclass(frozen=True)
class SessionEvent:
    """Something that happened at one instant."""

    time_s: float


@dataclass(frozen=True)
class PhaseEntered(SessionEvent):
    """The session entered a phase; ``trial`` is the one that runs or comes next."""

    phase: PhaseName
    trial: int


@dataclass(frozen=True)
class HeadsetChecked(SessionEvent):
    """The headset was checked."""

    check: HeadsetCheck


@dataclass(frozen=True)
class HeadsetCheckSkipped(SessionEvent):
    """The experimenter went on without the headset's check."""


@dataclass(frozen=True)
class Calibrated(SessionEvent):
    """The participant's place is known; ``measured``: so is now their torso height, by measuring it."""

    torso_height_m: float
    measured: bool


@dataclass(frozen=True)
class ReachMeasured(SessionEvent):
    """The participant's arms are so many times as long as those of most people of their torso height."""

    arm_scale: float


@dataclass(frozen=True)
class SeatFollowed(SessionEvent):
    """The participant has slid on their seat, and the virtual one follows by so much."""

    way_m: float


@dataclass(frozen=True)
class TorsoHeightCorrected(SessionEvent):
    """The experimenter gave the participant's torso height."""

    torso_height_m: float


@dataclass(frozen=True)
class BodyChosen(SessionEvent):
    """The participant or the experimenter chose the participant's body."""

    sex: Sex
    skin_tone: str


@dataclass(frozen=True)
class TrialBegun(SessionEvent):
    """An attempt at a trial has begun and is recorded."""

    trial: int
    attempt: int
    recording: Path


@dataclass(frozen=True)
class TrialEnded(SessionEvent):
    """An attempt has ended; ``complete``: its recording is closed and whole."""

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
    """The experimenter went on without the trial."""

    trial: int


@dataclass(frozen=True)
class Answered(SessionEvent):
    """The participant answered one item."""

    trial: int
    attempt: int
    answer: Answer


@dataclass(frozen=True)
class AnswerChanged(Answered):
    """The participant went back to an item and answered it anew."""


@dataclass(frozen=True)
class QuestionsLeft(SessionEvent):
    """The experimenter went on without the answers to these items; the trial counts."""

    trial: int
    attempt: int
    items: tuple[str, ...]


@dataclass(frozen=True)
class Stopped(SessionEvent):
    """Somebody stopped the robot; ``way`` is how the participant did."""

    by: Who
    way: StopWay | None = None


@dataclass(frozen=True)
class Paused(SessionEvent):
    """The experimenter lets no trial begin."""


@dataclass(frozen=True)
class StopRuleMet(SessionEvent):
    """An answer after which the session pauses or ends, as ``then`` says; ``why`` in words."""

    then: str
    why: str


@dataclass(frozen=True)
class Continued(SessionEvent):
    """The experimenter lets trials begin again."""


@dataclass(frozen=True)
class TrackingLost(SessionEvent):
    """A part of the body that the task needs has not been tracked for a while: it holds its last pose."""

    part: Part


@dataclass(frozen=True)
class TrackingFound(SessionEvent):
    """A part of the body that the task needs is tracked again, or is no longer needed."""

    part: Part


@dataclass(frozen=True)
class TrackingTimedOut(SessionEvent):
    """A part of the body that the task needs has not been tracked for so long that the attempt ends."""

    part: Part


@dataclass(frozen=True)
class VisibilityLost(SessionEvent):
    """The participant does not see the scene any more, and cannot act in it."""

    visibility: Visibility


@dataclass(frozen=True)
class VisibilityFound(SessionEvent):
    """The participant sees the scene again."""


@dataclass(frozen=True)
class TimeLost(SessionEvent):
    """The session stood still for so many seconds during an attempt: its process was frozen, or its machine slept."""

    seconds: float


@dataclass(frozen=True)
class ControllerFailed(SessionEvent):
    """The robot holds still because its controller gives no action; see ``policies.controllers.ControllerError``."""

    reason: str


@dataclass(frozen=True)
class ConnectionLost(SessionEvent):
    """The participant's connection is gone."""


@dataclass(frozen=True)
class ConnectionFound(SessionEvent):
    """The participant's client has connected."""


@dataclass(frozen=True)
class StreamLost(SessionEvent):
    """The stream of another device has vanished; the session goes on without it."""

    stream: str


@dataclass(frozen=True)
class StreamFound(SessionEvent):
    """The stream of another device has come, or come back."""

    stream: str


Observer = Callable[[SessionEvent], None]


class EventSink:
    """Tells an observer of every event. ``failure`` is what last kept it from storing one."""

    def __init__(self, observe: Observer, stored: Callable[[], bool]) -> None:
        """``stored``: whether all that the observer was told is stored. Either may raise what keeps it from that."""
        self.failure: Exception | None = None
        self._observe, self._stored = observe, stored

    def tell(self, event: SessionEvent) -> None:
        """Tell the observer; should it fail, ``failure`` says why."""
        try:
            self._observe(event)
        except Exception as error:  # whatever keeps a database from storing it
            self.failure = error

    def all_stored(self) -> bool:
        """Whether all that the observer was told is stored; should it have failed, ``failure`` says why."""
        try:
            return self._stored()
        except Exception as error:  # whatever keeps a database from storing it
            self.failure = error
            return False

    def take_failure(self) -> Exception | None:
        """What kept an event from being stored, once."""
        failure, self.failure = self.failure, None
        return failure

    def forget_failures(self) -> None:
        """Go on as if all had been stored."""
        self.all_stored()
        self.failure = None
