"""What a participant and their client may tell a session."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from avrgym.recording import records
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import PhaseName
from avrgym.vr.session import keeping, seating, transitions

if TYPE_CHECKING:
    from avrgym.vr.session.attempt import Attempt
    from avrgym.vr.session.session import Session

STOPPABLE: tuple[PhaseName, ...] = ("free_before", "countdown", "trial")
"""Where a stop ends the trial; later its robot is at rest, and what it gave is kept."""


def entered(session: "Session", _message: messages.Entered, now_s: float) -> None:
    """They entered VR, or play without a headset."""
    if session.phase != "finished":
        session.abandon("interrupted", now_s)
        seating.calibrate_again(session, now_s)


def left(session: "Session", _message: messages.Left, now_s: float) -> None:
    """They left VR."""
    if session.phase != "finished":
        session.abandon("interrupted", now_s)
        session.enter("waiting", "You left VR. Choose Enter VR to go on.", now_s)


def disconnected(session: "Session", _message: Any, now_s: float) -> None:
    """Their connection is gone."""
    session.tell(transitions.ConnectionLost(now_s))
    if session.phase != "finished":
        session.abandon("interrupted", now_s)
        session.enter("waiting", "The connection was lost. Choose Enter VR to go on.", now_s)


def stop(session: "Session", by: transitions.Who, now_s: float) -> None:
    """Hold the robot at once; the trial that runs may be repeated."""
    if session.phase not in STOPPABLE:
        session.problem(f"the robot holds still; it can be stopped in the phases {', '.join(STOPPABLE)}", by)
        return
    keeping.break_off(session, "stopped", transitions.Stopped(now_s, by), "Stopped", now_s)


def recalibrate(session: "Session", _message: messages.Recalibrate, now_s: float) -> None:
    """They saw that body or seat do not fit."""
    if session.phase not in ("check", "paused"):
        session.problem("you can be measured again in the phases check and paused")
        return
    session.height_known = False
    seating.calibrate_again(session, now_s)


def origin_reset(session: "Session", _message: messages.OriginReset, now_s: float) -> None:
    """Where they were is no longer known."""
    if session.phase not in ("waiting", "finished"):
        session.abandon("interrupted", now_s)
        seating.calibrate_again(session, now_s)


def ready(session: "Session", _message: messages.Ready, now_s: float) -> None:
    """They pressed the trigger to go on."""
    if session.phase == "calibration":
        seating.calibrate(session, now_s)
    elif session.phase == "check" or (session.phase == "paused" and not session.paused):
        session.begin_trial(now_s)
    elif session.phase == "paused":
        session.problem("the experimenter has paused the session and will continue it")
    else:
        session.problem("a trigger counts as ready only in the phases calibration, check and paused")


def answer(session: "Session", answer: messages.Answer, now_s: float) -> None:
    """They answered the question that is asked; after the last one the trial is complete."""
    if session.phase != "questionnaire" or session.attempt is None:
        session.problem("an answer counts only while the questionnaire is open")
        return
    try:
        session.asking.take(answer)
    except ValueError as error:
        session.problem(str(error))
        session.send(session.asking.question())
        return
    _keep_answer(session, session.attempt, answer, now_s)
    if session.asking.done:
        session.complete_trial(now_s)
    else:
        session.send(session.asking.question())


def _keep_answer(session: "Session", attempt: "Attempt", answer: messages.Answer, now_s: float) -> None:
    given = answer.item, answer.value, answer.response_time_s
    attempt.record("/answers", records.Answer(*given), now_s)
    session.tell(transitions.Answered(now_s, attempt.trial, attempt.number, *given))


HANDLERS: Mapping[type, Callable[["Session", Any, float], None]] = {
    messages.Tracking: seating.take_tracking,
    messages.ChooseBody: seating.choose_body,
    messages.Entered: entered,
    messages.Left: left,
    messages.Ready: ready,
    messages.SceneLoaded: lambda session, message, now_s: session.scenery.show(message.url),
    messages.Stop: lambda session, _, now_s: stop(session, "participant", now_s),
    messages.Recalibrate: recalibrate,
    messages.OriginReset: origin_reset,
    messages.Answer: answer,
}
