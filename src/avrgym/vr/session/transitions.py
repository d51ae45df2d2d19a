"""What happens to a session, one plain record for each transition.

A session tells its observer of each before it goes on, so that a database can keep them. ``time_s`` counts from the
session's beginning; trials and attempts count from 1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from avrgym.models.human import Sex
from avrgym.vr.protocol.messages import PhaseName

Result = Literal["completed", "stopped", "paused", "interrupted", "repeated", "skipped", "ended", "failed"]
"""How an attempt ended. Only ``completed`` counts: its recording is whole and every question is answered."""

Who = Literal["participant", "experimenter"]


@dataclass(frozen=True)
class Transition:
    """Something that happened at one instant."""

    time_s: float


@dataclass(frozen=True)
class PhaseEntered(Transition):
    """The session entered a phase; ``trial`` is the one that runs or comes next."""

    phase: PhaseName
    trial: int


@dataclass(frozen=True)
class Calibrated(Transition):
    """The participant's place is known; ``measured``: so is now their torso height, by measuring it."""

    torso_height_m: float
    measured: bool


@dataclass(frozen=True)
class TorsoHeightCorrected(Transition):
    """The experimenter gave the participant's torso height."""

    torso_height_m: float


@dataclass(frozen=True)
class BodyChosen(Transition):
    """The participant or the experimenter chose the participant's body."""

    sex: Sex
    skin_tone: str


@dataclass(frozen=True)
class TrialBegun(Transition):
    """An attempt at a trial has begun and is recorded."""

    trial: int
    attempt: int
    recording: Path


@dataclass(frozen=True)
class TrialEnded(Transition):
    """An attempt has ended; ``complete``: its recording is closed and whole."""

    trial: int
    attempt: int
    recording: Path
    result: Result
    complete: bool
    steps: int
    reward: float
    success: bool


@dataclass(frozen=True)
class TrialSkipped(Transition):
    """The experimenter went on without the trial."""

    trial: int


@dataclass(frozen=True)
class Answered(Transition):
    """The participant answered one item, ``response_time_s`` after it appeared."""

    trial: int
    attempt: int
    item: str
    value: int
    response_time_s: float


@dataclass(frozen=True)
class Stopped(Transition):
    """Somebody stopped the robot."""

    by: Who


@dataclass(frozen=True)
class Paused(Transition):
    """The experimenter lets no trial begin."""


@dataclass(frozen=True)
class Continued(Transition):
    """The experimenter lets trials begin again."""


@dataclass(frozen=True)
class TrackingLost(Transition):
    """No usable tracking frame has come for a while: the person holds their last pose."""


@dataclass(frozen=True)
class TrackingFound(Transition):
    """Usable tracking frames come again."""


@dataclass(frozen=True)
class TrackingTimedOut(Transition):
    """No usable tracking frame has come for so long that the attempt ends."""


@dataclass(frozen=True)
class TimeLost(Transition):
    """The session stood still for so many seconds during an attempt: its process was frozen, or its machine slept."""

    seconds: float


@dataclass(frozen=True)
class ConnectionLost(Transition):
    """The participant's connection is gone."""


@dataclass(frozen=True)
class ConnectionFound(Transition):
    """The participant's client has connected."""


Observer = Callable[[Transition], None]
