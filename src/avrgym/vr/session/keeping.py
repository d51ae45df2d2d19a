"""How a session keeps its attempts: recorded, and told to its observer. What is not kept is no trial."""

from typing import TYPE_CHECKING, Any

from avrgym.recording.files import RecordingError
from avrgym.vr.session import transitions
from avrgym.vr.session.attempt import Attempt, configuration

if TYPE_CHECKING:
    from avrgym.vr.session.session import Session


def new_attempt(session: "Session", now_s: float) -> Attempt:
    """Open the recording of the next attempt at the current trial; ``OSError`` when none can be opened."""
    first = session.current.earlier_attempts + 1
    return Attempt(
        session.folder,
        session.trial + 1,
        lambda number: _configuration(session, number),
        now_s,
        first_number=first,
    )


def _configuration(session: "Session", attempt: int) -> dict[str, Any]:
    assert session.registration is not None
    place = session.registration.xr_from_world()
    return configuration(session.plan, session.trial, attempt, session.world, place, session.identifier)


def watch(session: "Session", now_s: float) -> None:
    """Tell of a disk that pauses; go no further with a trial that recording or observer cannot keep."""
    kept = session.is_kept()
    at_stake = session.attempt is not None or session.completing is not None
    failure, session.observer_failure = session.observer_failure, None
    if failure is not None and (at_stake or not session.failing):
        pause(session, failure, now_s)
    elif kept and session.completing is not None:
        _go_on(session, session.completing, now_s)
    if session.attempt is None:
        return
    stall = session.attempt.stall()
    if stall is not None:
        session.record_event("recording_stalled", str(stall), now_s)
        session.problem(f"the recording is slow: {stall}")
    if session.attempt.failure is not None:
        pause(session, session.attempt.failure, now_s)


def _go_on(session: "Session", completed: int, now_s: float) -> None:
    """Leave a trial whose completion is kept now; somebody who waits for that goes on."""
    session.completing = None
    if session.phase == "finished":
        return
    session.trial = max(session.trial, completed + 1)
    if session.trial == len(session.plan.trials) or (session.phase == "loading" and session.then is None):
        session.trial -= 1
        session.next_trial(now_s)


def pause(session: "Session", error: Exception, now_s: float) -> None:
    """Hold the robot and let the participant try again, because a trial that is not kept is none."""
    session.world.hold()
    end_attempt(session, "failed", now_s)
    session.problem(f"the trial cannot be recorded: {error}")
    text = "The recording failed: the robot holds still. Press the trigger to try again."
    session.enter("paused", text, now_s)
    session.completing, session.failing = None, True
    forget_failures(session)


def forget_failures(session: "Session") -> None:
    """Whoever could not keep a pause either is asked again with the trial."""
    session.is_kept()
    session.observer_failure = None


def break_off(
    session: "Session", result: transitions.Result, happened: transitions.Transition, why: str, now_s: float
) -> None:
    """Hold the robot and end the attempt; the participant's trigger repeats the trial."""
    session.abandon(result, now_s)
    session.tell(happened)
    text = f"{why}: the robot holds still. Press the trigger to repeat the trial."
    session.enter("paused", text, now_s)
    session.scenery.prepare(session.trial, session.person)


def end_attempt(session: "Session", result: transitions.Result, now_s: float) -> RecordingError | None:
    """End the recording of a running trial; what keeps it from being complete, if anything does."""
    attempt, session.attempt = session.attempt, None
    if attempt is None:
        return None
    attempt.record_frames(session.presence.take_arrived(), None, stale=False)
    failure = attempt.close(result, now_s)
    sums = attempt.steps, attempt.reward, attempt.success
    whose = attempt.trial, attempt.number, attempt.path
    kept = "failed" if result == "completed" and failure is not None else result
    session.tell(transitions.TrialEnded(now_s, *whose, kept, failure is None, *sums))
    return failure
