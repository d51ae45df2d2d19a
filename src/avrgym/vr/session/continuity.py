"""Whether a trial goes on unbroken: its participant is tracked, and no time is lost. Otherwise its attempt ends."""

from typing import TYPE_CHECKING

from avrgym.vr.session import keeping, participant, transitions

if TYPE_CHECKING:
    from avrgym.vr.session.session import Session

UNTRACKED_S = 1.0
"""After so long without a usable frame the robot holds and the attempt ends."""
LOST_TIME_S = 0.5
"""So long between two ticks, which are 10 ms apart, no attempt goes on."""


def watch(session: "Session", stood_still_s: float, now_s: float) -> None:
    """End an attempt in which time was lost or nobody is tracked; ``stood_still_s`` is the time since the last tick."""
    if session.attempt is None:
        return
    if stood_still_s > LOST_TIME_S:
        why = f"the computer stood still for {stood_still_s:.1f} s"
        session.record_event("time_lost", why, now_s)
        _interrupt(session, transitions.TimeLost(now_s, stood_still_s), why, now_s)
    elif session.phase in participant.STOPPABLE and not is_tracked(session, now_s):
        why = f"tracking was lost for {UNTRACKED_S:g} s"
        session.record_event("tracking_timed_out", why, now_s)
        _interrupt(session, transitions.TrackingTimedOut(now_s), why, now_s)


def is_tracked(session: "Session", now_s: float) -> bool:
    """Whether the participant has been tracked within the last second."""
    age_s = session.presence.age_s(now_s)
    return age_s is not None and age_s <= UNTRACKED_S


def _interrupt(session: "Session", happened: transitions.Transition, why: str, now_s: float) -> None:
    """Where the robot has finished, what it gave is kept."""
    if session.phase not in participant.STOPPABLE:
        session.tell(happened)
        return
    session.problem(f"{why}: the attempt is interrupted, and the trial is repeated")
    keeping.break_off(session, "interrupted", happened, why.capitalize(), now_s)
