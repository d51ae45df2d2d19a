"""The phases of a session: texts, reactions to messages and ticks, and transitions.

Most methods return the next phase. Those of the base class ``Phase`` return the same phase. A subclass overrides a
method to add a transition. The return annotation lists all possible next phases. The transitions form cycles.
Therefore the modules import each other through this package.
"""

from avrgym.vr.protocol.messages import PhaseName
from avrgym.vr.session.phases.breaks import Break, BreakQuestionnaire
from avrgym.vr.session.phases.checking import (
    CheckAtRest,
    CheckFeedback,
    CheckMoving,
    CheckResult,
    CheckStart,
    CheckStop,
    CheckStretched,
)
from avrgym.vr.session.phases.halted import Finished, Paused, RecordingFailed
from avrgym.vr.session.phases.phase import Phase
from avrgym.vr.session.phases.preparing import (
    Calibration,
    Check,
    ConfirmReady,
    LoadCalibration,
    LoadCheck,
    LoadTrial,
    PreferenceQuestionnaire,
    ReachForward,
    ReachSideways,
    Storing,
    Waiting,
)
from avrgym.vr.session.phases.running import (
    Confirm,
    Countdown,
    FreeMovementAfter,
    FreeMovementBefore,
    Questionnaire,
    Retreat,
    Trial,
)

TrialStart = (
    LoadTrial
    | Calibration
    | Storing
    | Waiting
    | Break
    | BreakQuestionnaire
    | Paused
    | RecordingFailed
    | ConfirmReady
    | FreeMovementBefore
    | Finished
)
"""Phases that may follow when a trial is to start."""
SessionEnd = Finished | RecordingFailed
"""Phases that may follow a request to end the session. If the robot has finished, the trial is completed first."""
AfterRobot = TrialStart | Finished | Questionnaire
"""Phases that may follow when the robot has finished, even if the participant has left VR."""
AfterEntering = CheckStart | Calibration | LoadCalibration | SessionEnd
"""Phases that may follow when the participant enters VR."""
AfterLeaving = Waiting | SessionEnd
"""Phases that may follow when the participant leaves VR."""
AfterRecalibration = Calibration | LoadCalibration | SessionEnd
"""Phases that may follow a request for a new calibration."""
AfterLoading = TrialStart | Check
"""Phases that may follow when the client shows a new world."""

PHASES: tuple[type[Phase], ...] = (
    Waiting, CheckStart, CheckAtRest, CheckStretched, CheckMoving, CheckStop, CheckFeedback, CheckResult, Calibration,
    ReachForward, ReachSideways, LoadTrial, LoadCalibration, LoadCheck, Storing, Check, ConfirmReady,
    PreferenceQuestionnaire, FreeMovementBefore, Countdown, Trial, Retreat, FreeMovementAfter, Questionnaire, Confirm,
    Break, BreakQuestionnaire, Paused, RecordingFailed, Finished,
)  # fmt: skip
"""All phases, in the order of a session."""


def phases_with(flag: str) -> list[PhaseName]:
    """Returns the names of the phases in which this attribute is true."""
    return list(dict.fromkeys(phase.name for phase in PHASES if getattr(phase, flag)))
