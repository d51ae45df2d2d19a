"""The phases of a session: texts, reactions to messages and ticks, and transitions.

Most methods return the next phase. The methods of the base class ``Phase`` return the same phase. A subclass overrides
a method to add a transition. The return annotation lists all possible next phases. The transitions form cycles. The
modules therefore import each other through this package.
"""

from avrgym.vr.protocol.messages import PhaseName
from avrgym.vr.session.phases.breaks import Break, BreakQuestionnaire
from avrgym.vr.session.phases.headset_phases import (
    DroppedFrameMeasurement,
    EmergencyStopTest,
    HandRangeMeasurement,
    HapticAndAudioTest,
    HeadsetCheckResult,
    HeadsetCheckStart,
    JitterMeasurement,
)
from avrgym.vr.session.phases.pause_phases import RecordingFailed, SessionFinished, SessionPaused
from avrgym.vr.session.phases.phase import Phase
from avrgym.vr.session.phases.setup_phases import (
    BodyCheck,
    Calibration,
    ForwardReachMeasurement,
    LoadingBodyCheck,
    LoadingCalibration,
    LoadingTrial,
    PreferenceQuestionnaire,
    ReadyConfirmation,
    SidewaysReachMeasurement,
    StoringTrial,
    WaitingForParticipant,
)
from avrgym.vr.session.phases.trial_phases import (
    AnswerConfirmation,
    Countdown,
    FreeMovementAfterTrial,
    FreeMovementBeforeTrial,
    RobotRetreat,
    RunningTrial,
    TrialQuestionnaire,
)

PhaseAtTrialStart = (
    LoadingTrial
    | Calibration
    | StoringTrial
    | WaitingForParticipant
    | Break
    | BreakQuestionnaire
    | SessionPaused
    | RecordingFailed
    | ReadyConfirmation
    | FreeMovementBeforeTrial
    | SessionFinished
)
"""Phases that may follow when the next trial is due."""
PhaseAtSessionEnd = SessionFinished | RecordingFailed
"""Phases that may follow a request to end the session. If the robot has finished, the trial is completed first."""
PhaseAfterRobotFinished = PhaseAtTrialStart | SessionFinished | TrialQuestionnaire
"""Phases that may follow when the robot has finished, even if the participant has left VR."""
PhaseAfterEnteringVr = HeadsetCheckStart | Calibration | LoadingCalibration | PhaseAtSessionEnd
"""Phases that may follow when the participant enters VR."""
PhaseAfterLeavingVr = WaitingForParticipant | PhaseAtSessionEnd
"""Phases that may follow when the participant leaves VR."""
PhaseAfterLoading = PhaseAtTrialStart | BodyCheck
"""Phases that may follow when the client shows a new world."""

PHASES: tuple[type[Phase], ...] = (
    WaitingForParticipant, HeadsetCheckStart, JitterMeasurement, HandRangeMeasurement, DroppedFrameMeasurement,
    EmergencyStopTest, HapticAndAudioTest, HeadsetCheckResult, Calibration, ForwardReachMeasurement,
    SidewaysReachMeasurement, LoadingTrial,
    LoadingCalibration, LoadingBodyCheck, StoringTrial, BodyCheck, ReadyConfirmation, PreferenceQuestionnaire,
    FreeMovementBeforeTrial, Countdown, RunningTrial, RobotRetreat, FreeMovementAfterTrial, TrialQuestionnaire,
    AnswerConfirmation, Break, BreakQuestionnaire, SessionPaused, RecordingFailed, SessionFinished,
)  # fmt: skip
"""All phases, in the order of a session."""


def list_phase_names_with_flag(flag: str) -> list[PhaseName]:
    """Returns the names of the phases in which the attribute ``flag`` is true."""
    return list(dict.fromkeys(phase.name for phase in PHASES if getattr(phase, flag)))
