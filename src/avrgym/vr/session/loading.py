"""How a session waits for a world to be made and shown, and has the next one made meanwhile."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from avrgym.simulation.room import NoRoomError
from avrgym.vr.protocol import messages

if TYPE_CHECKING:
    from avrgym.vr.session.session import Session


def load(session: "Session", then: Callable[[float], None], now_s: float) -> None:
    """Have the current trial's world made and shown, then go on with ``then``."""
    session.then = then
    session.scenery.prepare(session.trial, session.person)
    session.enter("loading", "One moment: the scene is being prepared.", now_s)


def prepare_next(session: "Session") -> None:
    """Have the next trial's world made, and its scene fetched, while the participant moves and answers."""
    upcoming = session.trial + 1
    if upcoming == len(session.plan.trials):
        return
    session.scenery.prepare(upcoming, session.person)
    url = session.scenery.upcoming(upcoming, session.person)
    if url is not None:
        session.send(messages.Upcoming(url=url))


def watch(session: "Session", now_s: float) -> None:
    """Put up the world that is waited for; go on when the client shows it."""
    then = session.then
    if session.phase != "loading" or then is None:
        return
    if not session.scenery.is_fresh(session.trial, session.person) and not _change_world(session, now_s):
        return
    session.tell_scene()
    if session.scenery.is_shown:
        session.then = None
        then(now_s)


def _change_world(session: "Session", now_s: float) -> bool:
    """Whether the prepared world stands now."""
    if not session.scenery.ready:
        return False
    try:
        session.scenery.change()
    except NoRoomError as error:
        session.problem(f"the robot has no room to begin: {error}")
        text = (
            "The robot needs room to begin. Rest your arms at your sides and press the trigger to try again."
        )
        session.enter("paused", text, now_s)
        return False
    except Exception as error:  # whatever a compiler or a file may raise
        session.problem(f"the scene cannot be made: {error}")
        session.enter("paused", "The scene cannot be made. Press the trigger to try again.", now_s)
        return False
    return True
