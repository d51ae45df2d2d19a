"""What a phase of a session is, and what it does with messages and ticks that lead nowhere."""

from __future__ import annotations

from typing import ClassVar, Self

from avrgym.tasks.control_loop import ControlStep
from avrgym.texts.interface_texts import ENGLISH, Text
from avrgym.vr.live_world.drivers import Driver
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import PhaseName, StopWay
from avrgym.vr.session import events
from avrgym.vr.session.interruptions import Interruption
from avrgym.vr.session.state import SessionState


class Phase:
    """A phase, or a kind of phases. ``says`` is what the participant reads; it lasts ``seconds`` where they are given.

    ``moves``: the participant or the robot moves. ``can_be_stopped``: the robot moves or is about to, and an emergency
    stop holds it. ``helped``: the robot has helped, and the trial counts. ``in_place``: the participant is in place, so
    that a trial can begin. ``awaits_ready``: a trigger goes on. ``can_recalibrate``: the participant may be measured
    again. ``can_choose_body``: no trial runs that another body would interrupt.
    """

    name: ClassVar[PhaseName]
    says: Text
    seconds: float | None = None
    moves: ClassVar[bool] = False
    can_be_stopped: ClassVar[bool] = False
    helped: ClassVar[bool] = False
    in_place: ClassVar[bool] = False
    awaits_ready: ClassVar[bool] = False
    can_recalibrate: ClassVar[bool] = False
    can_choose_body: ClassVar[bool] = False

    def __init__(self, state: SessionState) -> None:
        self.state = state

    def entered(self) -> None:
        """Do what is done once, when all have been told of the phase."""

    @property
    def question(self) -> messages.Question | None:
        """What is asked now."""
        return None

    # What the participant's client tells -------------------------------------------------------------------------

    def take_tracking(self, tracking: messages.Tracking) -> None:
        """Take a tracking frame."""
        self.state.tracking.take(tracking, self.state.now_s)

    def take_latency(self, latency: messages.Latency) -> None:
        """Take how late the pictures of the last second were."""
        self.state.take_latency(latency)

    def take_frames(self, drawn: messages.HeadsetFrames) -> None:
        """Take when the frames of the last second were drawn."""

    def enter_vr(self) -> Phase:
        """They entered VR, or play without a headset."""
        return self

    def leave_vr(self) -> Phase:
        """They left VR."""
        return self

    def disconnect(self) -> Phase:
        """Their connection is gone."""
        self.state.sink.tell(events.ConnectionLost(self.state.now_s))
        return self

    def reset_origin(self) -> Phase:
        """Where they were is no longer known."""
        return self

    def ready(self) -> Phase:
        """They pressed the trigger to go on."""
        return self._refuse("nothing_to_begin")

    def recalibrate(self) -> Phase:
        """They saw that body or seat do not fit."""
        return self._refuse("measured_between_trials")

    def answer(self, answer: messages.Answer) -> Phase:
        """They answered a question."""
        return self._refuse("no_question")

    def go_back(self) -> Phase:
        """They want to change an earlier answer."""
        return self._refuse("no_way_back")

    # What participant or experimenter ask ------------------------------------------------------------------------

    def stop(self, by: events.Who, way: StopWay | None = None) -> Phase:
        """The emergency stop: hold the robot immediately; the trial that runs may be repeated.

        ``way`` is how the participant stopped it.
        """
        return self._refuse("holds_already", by)

    def choose_body(self, choice: messages.ChooseBody, by: events.Who) -> Phase:
        """Give the participant a body of this sex and tone of skin."""
        return self._refuse("body_between_trials", by)

    # What the experimenter asks ----------------------------------------------------------------------------------

    def pause(self) -> Phase:
        """Let no trial begin before ``go_on``; one whose robot moves or is about to ends, and will be repeated."""
        if not self.state.on_hold:
            self.state.on_hold = True
            self.state.sink.tell(events.Paused(self.state.now_s))
        return self

    def go_on(self) -> Phase:
        """Let trials begin again."""
        if not self.state.on_hold:
            return self._report("the session is not paused")
        self.state.on_hold, self.state.pause_reason = False, ""
        self.state.sink.tell(events.Continued(self.state.now_s))
        return self

    def repeat(self) -> Phase:
        """Begin a new attempt at the current trial."""
        return self._refuse_out_of_place()

    def skip(self) -> Phase:
        """Go on without the current trial."""
        return self._refuse_out_of_place()

    def measure_again(self) -> Phase:
        """Measure the participant again."""
        return self._refuse_out_of_place()

    def correct_torso_height(self, torso_height_m: float) -> Phase:
        """Give the participant a body of this torso height; a running trial is interrupted."""
        self.state.correct_torso_height(torso_height_m)
        return self

    def drive(self, wish: messages.Drive) -> None:
        """Move the robot's hand; where no robot drives, none does."""

    def end(self) -> Phase:
        """End the session."""
        return self._report("the session is finished")

    # What happens in a tick, in this order -----------------------------------------------------------------------

    def call_off(self) -> Phase:
        """Somebody elsewhere has ended the session."""
        return self

    def interrupt(self, interruption: Interruption) -> Phase:
        """The participant cannot act, or time was lost. Where the robot has finished, its attempt goes on."""
        self.state.record_event(interruption.name, interruption.why)
        self.state.sink.tell(interruption.event)
        return self._report(interruption.why)

    @property
    def driver(self) -> Driver | None:
        """Who drives the robot."""
        return None

    def finish_step(self, step: ControlStep) -> Phase:
        """The robot has finished a control step."""
        return self

    def fail(self, error: Exception) -> Phase:
        """What happened cannot be stored."""
        self.state.report(f"the session cannot be stored: {error}")
        return self

    def trial_stored(self) -> Phase:
        """A trial's completion is stored, after somebody waited for that or did something else."""
        return self

    def wait(self) -> Phase:
        """Look whether what is waited for is there."""
        return self

    def time_over(self) -> Phase:
        """The phase's ``seconds`` are over."""
        return self

    # -------------------------------------------------------------------------------------------------------------

    def _refuse(self, key: str, by: events.Who = "participant") -> Self:
        """Tell who asked why this is not done: the key of a text."""
        if by == "participant":
            self.state.explain(Text(key))
        else:
            self.state.report(ENGLISH.render(Text(key)))
        return self

    def _report(self, why: str) -> Self:
        """Tell the experimenter why this is not done."""
        self.state.report(why)
        return self

    def _refuse_out_of_place(self) -> Self:
        return self._report("this is possible once the participant is in place, with the scene shown")
