"""The base class of phases, with the reactions that do not change the phase."""

from __future__ import annotations

from typing import ClassVar, Self

from avrgym.commands.vocabulary import CommandName, CommandSource
from avrgym.tasks.control_loop import FirstWorldStep
from avrgym.texts.interface_texts import ENGLISH_TEXTS, ParticipantText
from avrgym.vr.live_world.drivers import Driver
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import PhaseName, StopMethod
from avrgym.vr.session import events
from avrgym.vr.session.interruptions import Interruption
from avrgym.vr.session.session_state import SessionState


class Phase:
    """Base class of all phases of a session.

    ``message``: the text for the participant. ``time_limit_s``: maximum duration in seconds; ``None`` is unlimited.

    ``has_motion``: whether the participant or the robot moves in this phase. ``can_be_stopped``: whether an emergency
    stop has an effect in this phase. ``robot_finished``: whether the robot has finished; the trial is then valid.
    ``participant_located``: whether the participant's position and direction are known; a trial can then start.
    ``awaits_confirmation``: whether the trigger starts the next phase. ``can_recalibrate``: whether the participant
    may be calibrated again. ``can_choose_body``: whether the body can be changed.
    """

    name: ClassVar[PhaseName]
    message: ParticipantText
    time_limit_s: float | None = None
    has_motion: ClassVar[bool] = False
    can_be_stopped: ClassVar[bool] = False
    robot_finished: ClassVar[bool] = False
    participant_located: ClassVar[bool] = False
    awaits_confirmation: ClassVar[bool] = False
    can_recalibrate: ClassVar[bool] = False
    can_choose_body: ClassVar[bool] = False

    def __init__(self, state: SessionState) -> None:
        self.state = state

    @property
    def can_change_preferences(self) -> bool:
        """Whether the participant may change their preferences for the robot now."""
        return False

    def on_enter(self) -> None:
        """Start the phase. The session calls this once, after it has sent the phase to the clients."""

    @property
    def question(self) -> messages.Question | None:
        """The current question; ``None`` if the phase has no questions."""
        return None

    # Messages of the participant's client -------------------------------------------------------------------------

    def on_tracking(self, tracking: messages.TrackingFrameMessage) -> None:
        """Add a tracking frame to the tracking of the session."""
        self.state.tracking.add_frame(tracking, self.state.now_s)

    def on_latency(self, latency: messages.Latency) -> None:
        """Record the latencies of the last second, from tracking to display."""
        self.state.record_latency(latency)

    def on_frame_intervals(self, drawn: messages.FrameIntervals) -> None:
        """Store the intervals between the frames of the last second. Only the headset check uses them."""

    def enter_vr(self) -> Phase:
        """Handles the start of VR, or a start without a headset. Returns the next phase."""
        return self

    def leave_vr(self) -> Phase:
        """Handles the end of VR. Returns the next phase."""
        return self

    def disconnect(self) -> Phase:
        """Handle the loss of the participant's connection. Returns the next phase."""
        self.state.event_sink.report(events.ConnectionLost(self.state.now_s))
        return self

    def on_origin_reset(self) -> Phase:
        """Handle a changed origin of tracking. The participant's position and direction are then unknown."""
        return self

    def on_ready(self) -> Phase:
        """Handle a press of the trigger to continue. Returns the next phase."""
        return self._refuse("nothing_to_begin")

    def recalibrate(self) -> Phase:
        """Handle the participant's report that the virtual body or seat does not fit. Returns the next phase."""
        return self._refuse("measured_between_trials")

    def request_break(self, by: events.Initiator) -> Phase:
        """Handle a request for a break. The break follows before the next trial."""
        self.state.request_break(by)
        return self._refuse("break_follows", by)

    def change_preferences(self) -> Phase:
        """Handle a request for the questions about preferences for the robot. Returns the next phase."""
        return self._refuse("no_preferences")

    def answer(self, answer: messages.Answer) -> Phase:
        """Handle an answer of the participant. Returns the next phase."""
        return self._refuse("no_question")

    def go_back(self) -> Phase:
        """Handle a request for the previous question, to change its answer. Returns the next phase."""
        return self._refuse("no_way_back")

    def command_robot(self, command: CommandName, source: CommandSource) -> None:
        """Handle a command of a participant to the robot, except ``stop``."""
        self.state.ignore_command(command, source, "no trial runs")

    # Messages of participant or experimenter ------------------------------------------------------------------------

    def stop(self, by: events.Initiator, method: StopMethod | None = None) -> Phase:
        """Handle an emergency stop. If the robot moves, it stops immediately, and the trial may be repeated.

        ``method`` is the participant's stop method.
        """
        return self._refuse("holds_already", by)

    def choose_body(self, choice: messages.BodyChoice, by: events.Initiator) -> Phase:
        """Handle a request to change the participant's body. Returns the next phase."""
        return self._refuse("body_between_trials", by)

    # Commands of the experimenter ----------------------------------------------------------------------------------

    def pause(self) -> Phase:
        """Prevent trials until ``resume`` is called. A running trial is interrupted and repeated later."""
        if not self.state.is_paused:
            self.state.is_paused = True
            self.state.event_sink.report(events.Paused(self.state.now_s))
        return self

    def resume(self) -> Phase:
        """End the pause of the experimenter or of a stop rule: trials may start again."""
        if not self.state.is_paused:
            return self._report("the session is not paused")
        self.state.is_paused, self.state.pause_reason = False, ""
        self.state.event_sink.report(events.Continued(self.state.now_s))
        return self

    def repeat(self) -> Phase:
        """Handle the experimenter's request for a new attempt at the current trial. Returns the next phase."""
        return self._refuse_out_of_place()

    def skip(self) -> Phase:
        """Handle the experimenter's request to skip the current trial. Returns the next phase."""
        return self._refuse_out_of_place()

    def repeat_calibration(self) -> Phase:
        """Handle the experimenter's request for a new calibration. Returns the next phase."""
        return self._refuse_out_of_place()

    def correct_torso_height(self, torso_height_m: float) -> Phase:
        """Set the torso height of the participant's body in metres. This interrupts a running trial."""
        self.state.correct_torso_height(torso_height_m)
        return self

    def apply_velocity_command(self, command: messages.VelocityCommand) -> None:
        """Move the robot's hand, if the driver is an operator."""

    def apply_controller_pose(self, steer: messages.ControllerPoseCommand) -> None:
        """Move the robot's tool with the demonstrator's controller, if the driver is an operator."""

    def on_demonstrator_disconnected(self) -> None:
        """Handle the loss of the demonstrator's connection: a robot that the demonstrator drives holds its position."""

    def end_session(self) -> Phase:
        """Handle the experimenter's request to end the session. Returns the next phase."""
        return self._report("the session is finished")

    # Called in each tick, in this order -----------------------------------------------------------------------

    def cancel_session(self) -> Phase:
        """Handle the end of the session by another process or a stop rule. Returns the next phase."""
        return self

    def interrupt(self, interruption: Interruption) -> Phase:
        """Handle an interruption: the participant cannot act, or the process was suspended.

        If the robot has finished, the attempt continues.
        """
        self.state.record_event(interruption.event_name, interruption.reason)
        self.state.event_sink.report(interruption.event)
        return self._report(interruption.reason)

    @property
    def driver(self) -> Driver | None:
        """The driver of the robot; ``None`` if the robot does not move in this phase."""
        return None

    def on_control_step(self, step: FirstWorldStep) -> Phase:
        """Handle a finished control step of the robot. Returns the next phase."""
        return self

    def on_storage_failure(self, error: Exception) -> Phase:
        """Handle an event or attempt that cannot be stored. Returns the next phase."""
        self.state.report_problem(f"the session cannot be stored: {error}")
        return self

    def on_trial_stored(self) -> Phase:
        """Called when a completed trial is stored. Returns the next phase."""
        return self

    def poll(self) -> Phase:
        """Returns the next phase if the event for which this phase waits has occurred; otherwise this phase."""
        return self

    def on_timeout(self) -> Phase:
        """Handle the end of the phase's ``time_limit_s``. Returns the next phase."""
        return self

    # -------------------------------------------------------------------------------------------------------------

    def _refuse(self, key: str, by: events.Initiator = "participant") -> Self:
        """Reject a request, and show the text with this ``key`` to the sender ``by``."""
        if by == "participant":
            self.state.explain_rejection(ParticipantText(key))
        else:
            self.state.report_problem(ENGLISH_TEXTS.format_for_vr(ParticipantText(key)))
        return self

    def _report(self, why: str) -> Self:
        """Report to the experimenter why a request is rejected."""
        self.state.report_problem(why)
        return self

    def _refuse_out_of_place(self) -> Self:
        return self._report("this is possible only after calibration, when the scene is shown")
