"""What an experimenter may ask of a session."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import CommandName, PhaseName
from avrgym.vr.session import loading, participant, seating, transitions

if TYPE_CHECKING:
    from avrgym.vr.session.session import Session

IN_TRIALS: tuple[PhaseName, ...] = (
    "check",
    "free_before",
    "countdown",
    "trial",
    "free_after",
    "questionnaire",
    "paused",
)
"""Where the participant is in place, so that a trial can begin."""
RUNNING: tuple[PhaseName, ...] = ("free_before", "countdown", "trial")


def pause(session: "Session", now_s: float) -> None:
    """Let no trial begin before ``go_on``; one whose robot moves or is about to ends, and will be repeated."""
    if session.paused or _over(session):
        return
    session.paused = True
    session.tell(transitions.Paused(now_s))
    if session.phase in RUNNING:
        session.abandon("paused", now_s)
        session.begin_trial(now_s)


def go_on(session: "Session", now_s: float) -> None:
    """Let trials begin again."""
    if not session.paused:
        session.problem("the session is not paused", "experimenter")
        return
    session.paused = False
    session.tell(transitions.Continued(now_s))
    if session.phase == "paused":
        session.begin_trial(now_s)


def repeat(session: "Session", now_s: float) -> None:
    """Begin a new attempt at the current trial."""
    if _in_trials(session):
        session.abandon("repeated", now_s)
        session.begin_trial(now_s)


def skip(session: "Session", now_s: float) -> None:
    """Go on without the current trial."""
    if _in_trials(session):
        session.abandon("skipped", now_s)
        session.tell(transitions.TrialSkipped(now_s, session.trial + 1))
        session.next_trial(now_s)


def end(session: "Session", now_s: float) -> None:
    """End the session."""
    if not _over(session):
        session.abandon("ended", now_s)
        session.finish("The session has ended. Thank you! You may take off the headset.", now_s)


def recalibrate(session: "Session", now_s: float) -> None:
    """Measure the participant again."""
    if _in_trials(session):
        session.abandon("interrupted", now_s)
        session.height_known = False
        seating.calibrate_again(session, now_s)


def correct_torso_height(session: "Session", message: messages.CorrectTorsoHeight, now_s: float) -> None:
    """Give the participant a body of this torso height; a running trial is interrupted."""
    if _over(session):
        return
    try:
        seating.give_torso_height(session, message.torso_height_m)
    except ValueError as error:
        session.problem(str(error), "experimenter")
        return
    session.tell(transitions.TorsoHeightCorrected(now_s, message.torso_height_m))
    if session.phase in IN_TRIALS:
        session.abandon("interrupted", now_s)
        loading.load(session, lambda now_s: seating.enter_check(session, now_s), now_s)


COMMANDS: Mapping[CommandName, Callable[["Session", float], None]] = {
    "stop": lambda session, now_s: participant.stop(session, "experimenter", now_s),
    "pause": pause,
    "continue": go_on,
    "repeat": repeat,
    "skip": skip,
    "end": end,
    "recalibrate": recalibrate,
}

HANDLERS: Mapping[type, Callable[["Session", Any, float], None]] = {
    messages.Command: lambda session, command, now_s: COMMANDS[command.name](session, now_s),
    messages.CorrectTorsoHeight: correct_torso_height,
    messages.ChooseTheirBody: lambda session, choice, now_s: seating.choose_body(
        session, choice, now_s, "experimenter"
    ),
}


def _in_trials(session: "Session") -> bool:
    """Whether the participant is in place; if not, the experimenter is told."""
    if session.phase not in IN_TRIALS:
        words = f"this is possible in the phases {', '.join(IN_TRIALS)}, not in {session.phase}"
        session.problem(words, "experimenter")
    return session.phase in IN_TRIALS


def _over(session: "Session") -> bool:
    if session.phase == "finished":
        session.problem("the session is finished", "experimenter")
    return session.phase == "finished"
