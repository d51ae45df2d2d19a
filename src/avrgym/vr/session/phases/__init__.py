"""The phases of a session: what each says, what it does with messages and ticks, and which phases may follow it.

Each method returns the phase that follows. Those of ``Phase`` itself stay in the phase; what leads elsewhere overrides
them and says in its annotation where to. So whatever the annotations do not name, no message and no tick leads to.
Phases follow each other in circles: their modules find each other here.
"""

from avrgym.vr.protocol.messages import PhaseName
from avrgym.vr.session.phases.checking import (
    CheckAtRest,
    CheckBegins,
    CheckMoving,
    CheckResult,
    CheckSenses,
    CheckStop,
    CheckStretched,
)
from avrgym.vr.session.phases.halted import Finished, Paused, RecordingFailed
from avrgym.vr.session.phases.phase import Phase
from avrgym.vr.session.phases.preparing import (
    AskReady,
    Calibration,
    Check,
    LoadCalibration,
    LoadCheck,
    LoadTrial,
    ReachAhead,
    ReachAside,
    Storing,
    Waiting,
)
from avrgym.vr.session.phases.running import (
    Confirm,
    Countdown,
    FreeAfter,
    FreeBefore,
    Questionnaire,
    Retreat,
    Trial,
)

Begins = LoadTrial | Calibration | Storing | Waiting | Paused | RecordingFailed | AskReady | FreeBefore
"""What may follow when a trial shall begin."""
Ended = Finished | RecordingFailed
"""What may follow when nothing begins any more, and when an answered trial is completed before."""
Asks = Begins | Finished | Questionnaire
"""What may follow when the robot has helped, wherever the participant is."""
Enters = CheckBegins | Calibration | LoadCalibration | Ended
"""What may follow when the participant enters VR."""
Gone = Waiting | Ended
"""What may follow when the participant leaves."""
Anew = Calibration | LoadCalibration | Ended
"""What may follow when they are measured again."""
Loaded = Begins | Check
"""What may follow when a world is shown."""

PHASES: tuple[type[Phase], ...] = (
    Waiting, CheckBegins, CheckAtRest, CheckStretched, CheckMoving, CheckStop, CheckSenses, CheckResult, Calibration,
    ReachAhead, ReachAside, LoadTrial, LoadCalibration, LoadCheck, Storing, Check, AskReady, FreeBefore, Countdown,
    Trial, Retreat, FreeAfter, Questionnaire, Confirm, Paused, RecordingFailed, Finished,
)  # fmt: skip
"""All phases, in the order of a session."""


def where(flag: str) -> list[PhaseName]:
    """The names of the phases whose attribute of this name is true."""
    return list(dict.fromkeys(phase.name for phase in PHASES if getattr(phase, flag)))
