"""A simulated participant in the same process as the session, without browser and network, in simulated time."""

from collections.abc import Callable

from avrgym.vr.emulation.simulated_participant import SimulatedParticipant
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S, Message
from avrgym.vr.session.session import Session

CALIBRATION_STILL_TIME_S = 1.5
"""Time in seconds for which a simulated participant holds still before the press of the trigger."""
ANSWER_DELAY_S = 1.5
"""Time in seconds from the appearance of a question to the answer."""
MAX_START_ATTEMPTS = 4
"""Maximum number of times that a simulated participant tries to start a trial."""
TRACKING_INTERVAL_TICKS = 2
"""Interval in ticks at which a simulated participant sends tracking frames."""
STATE_INTERVAL_TICKS = 2
"""Interval in ticks at which a simulated participant receives a state. Results depend on this interval."""


class InProcessClient:
    """Connects a simulated participant directly to a session, in simulated time."""

    def __init__(self, participant: SimulatedParticipant, log: Callable[[str], None]) -> None:
        self._participant, self._log = participant, log
        self._question: messages.Question | None = None
        self._scene_url, self._problem = "", ""
        self._trial, self._tries = 0, 0
        self._heard_s = 0.0
        self._now_s = 0.0

    def receive(self, message: Message) -> None:
        """Handle a message that the session sends to the participant."""
        self._participant.receive(message)
        if isinstance(message, messages.AvailableRobotCommands):
            self._participant.command_generator.receive(message, self._now_s)
        if isinstance(message, messages.PhaseDescription):
            self._heard_s, self._question = self._now_s, None
            if message.trial != self._trial:
                self._trial, self._tries = message.trial, 0
            self._log(f"{message.name.replace('_', ' ')} (trial {message.trial} of {message.trials})")
        elif isinstance(message, messages.Question):
            self._heard_s, self._question = self._now_s, message
        elif isinstance(message, messages.Scene):
            self._scene_url = message.url
        elif isinstance(message, messages.Problem):
            self._problem = message.message

    def run(self, session: Session) -> None:
        """Take part in the session until it is finished.

        Raises:
            RuntimeError: if a trial does not start. The message contains the latest problem that the session reported.
        """
        session.receive(messages.VrEntered(), self._now_s)
        tick = 0
        while session.phase_name != "finished":
            self._now_s = tick * TICK_S
            trial = session.plan.trials[max(self._trial - 1, 0)]
            self._participant.adopt_posture(trial.environment, session.plan.find_trial_settings(trial))
            if tick % TRACKING_INTERVAL_TICKS == 0:
                frame = self._participant.make_tracking_frame(
                    self._now_s, moving=session.phase_name != "calibration"
                )
                session.receive(frame, self._now_s)
            self._respond(session)
            session.tick(self._now_s)
            session.wait_for_writes()
            tick += 1
        session.close(self._now_s)

    def _respond(self, session: Session) -> None:
        waited_s = self._now_s - self._heard_s
        if (
            session.phase_name in ("headset", "calibration", "check", "ready", "break", "paused")
            and waited_s > CALIBRATION_STILL_TIME_S
        ):
            self._press_trigger(session)
        if session.phase_name == "headset_stop":
            session.receive(messages.Stop(method="button"), self._now_s)
        if session.phase_name == "loading":
            session.receive(messages.SceneLoaded(url=self._scene_url), self._now_s)
        question = self._question
        if question is not None and waited_s > ANSWER_DELAY_S:
            self._question = None
            value = self._participant.rate_item(question.item, question.points, session.attempt_results)
            answer = messages.Answer(item=question.item, value=value, response_time_s=waited_s)
            session.receive(answer, self._now_s)
        if session.phase_name == "trial":
            self._command_robot(session)
        if session.phase_name == "confirm":
            session.receive(messages.ParticipantReady(), self._now_s)

    def _command_robot(self, session: Session) -> None:
        given = self._participant.command_generator.pop_due_command(self._now_s)
        if given is None:
            return
        command, source = given
        match source:
            case "nod" | "shake" | "gaze":
                self._participant.begin_gesture(source, self._now_s)
            case "caregiver" | "experimenter":
                session.receive(messages.OtherPersonRobotCommand(command, source, self._time_ms), self._now_s)
            case _:
                session.receive(messages.RobotCommand(command, source, self._time_ms), self._now_s)

    @property
    def _time_ms(self) -> float:
        return 1000.0 * self._now_s

    def _press_trigger(self, session: Session) -> None:
        self._tries += 1
        if self._tries > MAX_START_ATTEMPTS:
            session.close(self._now_s)
            raise RuntimeError(f"trial {self._trial} does not start: {self._problem}")
        self._heard_s = self._now_s
        session.receive(messages.ParticipantReady(), self._now_s)
