"""How a participant takes place: their body is chosen, their torso measured, and seat or bed put under them."""

from dataclasses import replace
from typing import TYPE_CHECKING

from avrgym.models import human
from avrgym.models.human import PROPORTIONS, SKIN_TONES, Person
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import PhaseName
from avrgym.vr.session import loading, transitions
from avrgym.vr.tracking.calibration import measure_torso_height
from avrgym.vr.tracking.presence import Presence

if TYPE_CHECKING:
    from avrgym.vr.session.session import Session

BODY_CHOSEN_IN: tuple[PhaseName, ...] = ("waiting", "calibration", "check", "paused")
"""Where no trial runs that another body would interrupt."""


def calibrate_again(session: "Session", now_s: float) -> None:
    """Let the participant be seated anew, in the current trial's seat or bed."""
    session.presence = Presence()
    session.calibrated_for = None
    if session.world.environment == session.current.environment:
        enter_calibration(session, now_s)
    else:
        loading.load(session, lambda now_s: enter_calibration(session, now_s), now_s)


def enter_calibration(session: "Session", now_s: float) -> None:
    """Ask the participant to rest and press the trigger."""
    session.presence.forget_place()
    how = "Sit upright, look" if session.world.stage.posture is human.SEATED else "Lie back, look"
    text = f"{how} straight ahead and rest your arms. Then press the trigger."
    session.enter("calibration", text, now_s)


def take_tracking(session: "Session", tracking: messages.Tracking, now_s: float) -> None:
    """Take a tracking frame; the first one of somebody who is to be measured says where they are."""
    frame = session.presence.take(tracking, now_s)
    if frame.usable and session.phase == "calibration" and session.registration is None:
        assert tracking.head is not None
        session.presence.place(tracking.head, session.person, session.world.stage.posture)
        session.tell_scene()


def calibrate(session: "Session", now_s: float) -> None:
    """Seat the participant: height, place and direction from the last half second of tracking."""
    measured, posture = not session.height_known, session.world.stage.posture
    try:
        head = session.presence.steady_head(now_s)
        if measured:
            height_m = measure_torso_height(session.person.sex, posture, head, session.plan.furniture)
            give_torso_height(session, height_m)
    except ValueError as error:
        session.problem(str(error))
        return
    session.calibrated_for = posture
    session.presence.place(head, session.person, posture)
    session.tell(transitions.Calibrated(now_s, session.person.torso_height_m, measured))
    loading.load(session, lambda now_s: enter_check(session, now_s), now_s)


def enter_check(session: "Session", now_s: float) -> None:
    """Let the participant look whether body and seat fit."""
    text = "Look down: do body and seat fit you? Trigger: go on. Menu button: measure again."
    session.enter("check", text, now_s)


def give_torso_height(session: "Session", torso_height_m: float) -> None:
    """Change the body's size, in its place.

    Raises:
        ValueError: for a height that no adult has, naming what is allowed.
    """
    session.person = replace(session.person, torso_height_m=torso_height_m)
    session.height_known = True
    session.presence.place_again(session.person)


def choose_body(
    session: "Session", choice: messages.ChooseBody, now_s: float, by: messages.Role = "participant"
) -> None:
    """Give the participant a body of this sex and tone of skin; of another sex it is measured anew.

    The height of the headset says how tall a torso is only above the hips, which sit higher on men.
    """
    if session.phase not in BODY_CHOSEN_IN:
        session.problem(
            f"the body is chosen in the phases {', '.join(BODY_CHOSEN_IN)}, not in {session.phase}", by
        )
        return
    try:
        chosen = Person(choice.sex, PROPORTIONS[choice.sex].torso_height, skin_tone=choice.skin_tone)
    except ValueError as error:
        session.problem(str(error), by)
        return
    if chosen.sex == session.person.sex:
        chosen = replace(chosen, torso_height_m=session.person.torso_height_m)
    else:
        session.height_known = False
    session.person = chosen
    session.tell(transitions.BodyChosen(now_s, chosen.sex, chosen.skin_tone))
    session.send(body_message(chosen))
    _show_body(session, now_s)


def _show_body(session: "Session", now_s: float) -> None:
    """Let a body that was just chosen be seen, or measured."""
    if session.phase == "calibration":
        session.presence.place_again(session.person)
        session.tell_scene()
    elif session.phase != "waiting" and not session.height_known:
        calibrate_again(session, now_s)
    elif session.phase != "waiting":
        loading.load(session, lambda now_s: enter_check(session, now_s), now_s)


def body_message(person: Person) -> messages.Body:
    """What a client is told of the participant's body."""
    return messages.Body(person.sex, person.skin_tone, list(SKIN_TONES), list(SKIN_TONES.values()))
