"""The phases of a session: what each says, what it does with messages and ticks, and which phases may follow it.

Each method returns the phase that follows. Those of ``Phase`` itself stay in the phase; what leads elsewhere overrides
them and says in its annotation where to. So whatever the annotations do not name, no message and no tick leads to.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Self

from avrgym.models import human
from avrgym.recording import records
from avrgym.simulation.room import NoRoomError
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import PhaseName
from avrgym.vr.session import events
from avrgym.vr.session.questions import Questions
from avrgym.vr.session.state import SessionState
from avrgym.vr.tracking.calibration import measure_torso_height
from avrgym.vr.tracking.driving import Driver
from avrgym.vr.tracking.tracking_state import TrackingState
from avrgym.vr.tracking.world import ControlStep

UNTRACKED_S = 1.0
"""After so long without a usable frame the robot holds and the attempt ends."""
LOST_TIME_S = 0.5
"""So long between two ticks, which are 10 ms apart, no attempt goes on."""


class Phase:
    """A phase, or a kind of phases. ``text`` is what it says; it lasts ``seconds`` where they are given.

    ``moves``: the participant or the robot moves. ``can_be_stopped``: the robot moves or is about to, and an emergency
    stop ends the trial. ``in_place``: the participant is in place, so that a trial can begin. ``awaits_ready``: a
    trigger goes on. ``can_recalibrate``: the participant may be measured again. ``can_choose_body``: no trial runs
    that another body would interrupt.
    """

    name: ClassVar[PhaseName]
    text: str = ""
    seconds: float | None = None
    moves: ClassVar[bool] = False
    can_be_stopped: ClassVar[bool] = False
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
        return self._refuse(f"a trigger counts as ready only in the phases {_listed(where('awaits_ready'))}")

    def recalibrate(self) -> Phase:
        """They saw that body or seat do not fit."""
        return self._refuse(f"you can be measured again in the phases {_listed(where('can_recalibrate'))}")

    def answer(self, answer: messages.Answer) -> Phase:
        """They answered a question."""
        return self._refuse("an answer counts only while the questionnaire is open")

    # What participant or experimenter ask ------------------------------------------------------------------------

    def stop(self, by: events.Who) -> Phase:
        """The emergency stop: hold the robot at once; the trial that runs may be repeated."""
        phases = ", ".join(where("can_be_stopped"))
        return self._refuse(f"the robot holds still; it can be stopped in the phases {phases}", by)

    def choose_body(self, choice: messages.ChooseBody, by: events.Who) -> Phase:
        """Give the participant a body of this sex and tone of skin."""
        phases = ", ".join(where("can_choose_body"))
        return self._refuse(f"the body is chosen in the phases {phases}, not in {self.name}", by)

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
            return self._refuse("the session is not paused", "experimenter")
        self.state.on_hold = False
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

    def end(self) -> Phase:
        """End the session."""
        return self._refuse("the session is finished", "experimenter")

    # What happens in a tick, in this order -----------------------------------------------------------------------

    def call_off(self) -> Phase:
        """Somebody elsewhere has ended the session."""
        return self

    def check_continuity(self, since_last_tick_s: float) -> Phase:
        """End an attempt in which time was lost or nobody is tracked. Where the robot has finished, it goes on."""
        if since_last_tick_s > LOST_TIME_S:
            self.state.sink.tell(self._lose_time(since_last_tick_s))
        return self

    @property
    def driver(self) -> Driver | None:
        """Who drives the robot."""
        return None

    def finish_step(self, step: ControlStep) -> Phase:
        """The robot has finished a control step."""
        return self

    def fail(self, error: Exception) -> Phase:
        """What happened cannot be stored."""
        self.state.problem(f"the session cannot be stored: {error}")
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

    def _refuse(self, why: str, role: messages.Role = "participant") -> Self:
        self.state.problem(why, role)
        return self

    def _refuse_out_of_place(self) -> Self:
        phases = ", ".join(where("in_place"))
        return self._refuse(f"this is possible in the phases {phases}, not in {self.name}", "experimenter")

    def _lose_time(self, seconds: float) -> events.TimeLost:
        self.state.record_event("time_lost", _stood_still(seconds))
        return events.TimeLost(self.state.now_s, seconds)


class Finished(Phase):
    """The session is over; nothing leads out of here."""

    name = "finished"

    def __init__(self, state: SessionState, text: str) -> None:
        super().__init__(state)
        self.text = f"{text} Thank you! You may take off the headset."

    def entered(self) -> None:
        self.state.drivers.close()

    def pause(self) -> Self:
        """Nothing begins any more; whoever asks is told, unless the session is paused already."""
        return self if self.state.on_hold else self._refuse("the session is finished", "experimenter")

    def correct_torso_height(self, torso_height_m: float) -> Self:
        """Nobody has a body any more."""
        return self._refuse("the session is finished", "experimenter")


class Ongoing(Phase):
    """Any phase but the last."""

    def enter_vr(self) -> Calibration | LoadCalibration:
        self.state.abandon("interrupted")
        return self._calibrate_again()

    def leave_vr(self) -> Waiting:
        self.state.abandon("interrupted")
        return Waiting(self.state, "You left VR. Choose Enter VR to go on.")

    def disconnect(self) -> Waiting:
        super().disconnect()
        self.state.abandon("interrupted")
        return Waiting(self.state, "The connection was lost. Choose Enter VR to go on.")

    def end(self) -> Finished:
        self.state.abandon("ended")
        return self._finish("The session has ended.")

    def call_off(self) -> Finished:
        return self.end()

    def fail(self, error: Exception) -> RecordingFailed:
        self.state.world.hold()
        self.state.end_attempt("failed")
        self.state.problem(f"the trial cannot be recorded: {error}")
        return RecordingFailed(self.state)

    def trial_stored(self) -> Finished | Self:
        return self._finish(ALL_DONE) if self.state.trial == len(self.state.plan.trials) else self

    def _finish(self, text: str) -> Finished:
        self.state.trial = len(self.state.plan.trials)
        return Finished(self.state, text)

    def _calibrate_again(self) -> Calibration | LoadCalibration:
        """Let the participant be seated anew, in the current trial's seat or bed."""
        self.state.tracking, self.state.calibrated_for = TrackingState(), None
        in_place = self.state.world.environment == self.state.current.environment
        return Calibration(self.state) if in_place else LoadCalibration(self.state)

    @property
    def _is_tracked(self) -> bool:
        """Whether the participant has been tracked within the last second."""
        age_s = self.state.tracking.age_s(self.state.now_s)
        return age_s is not None and age_s <= UNTRACKED_S

    def _next_trial(self) -> Begins | Finished:
        """Go on to the next trial, or finish after the last."""
        self.state.trial += 1
        more = self.state.trial < len(self.state.plan.trials)
        return self._begin_trial() if more else self._finish(ALL_DONE)

    def _begin_trial(self) -> Begins:
        """Begin the next attempt, once its world is made, the participant is in place, tracked and nobody pauses."""
        state = self.state
        if state.storage.completing is not None:
            return Storing(state)
        if not state.scenery.is_fresh(state.trial, state.person):
            return LoadTrial(state)
        if state.calibrated_for is not state.world.scene_config.posture:
            return Calibration(state)
        if state.on_hold:
            return Paused(state, "The experimenter has paused the session. The robot holds still.")
        if not self._is_tracked:
            return Paused(state, "Tracking is lost: look around, then press the trigger to go on.")
        try:
            state.begin_attempt()
        except OSError as error:
            return self.fail(error)
        return FreeBefore(state)

    def _complete_trial(self) -> Begins | Finished:
        """End the attempt as completed, unless it cannot be stored, and go on."""
        state = self.state
        recording_failure = state.end_attempt("completed")
        stored = state.sink.all_stored()
        failure = recording_failure or state.sink.failure
        if failure is not None:
            return self.fail(failure)
        if stored:
            return self._next_trial()
        state.storage.completing = state.trial
        return Storing(state)


class Waiting(Ongoing):
    """The participant is not in VR."""

    name = "waiting"
    can_choose_body = True

    def __init__(self, state: SessionState, text: str = "Put on the headset and choose Enter VR.") -> None:
        super().__init__(state)
        self.text = text

    def choose_body(self, choice: messages.ChooseBody, by: events.Who) -> Self:
        self.state.choose_body(choice, by)
        return self


class InVR(Ongoing):
    """The participant is in VR."""

    def reset_origin(self) -> Calibration | LoadCalibration:
        return self.enter_vr()


class Calibration(InVR):
    """The participant rests where they sit or lie, and presses the trigger: their torso height is measured there."""

    name = "calibration"
    awaits_ready = can_choose_body = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        how = "Sit upright, look" if state.world.scene_config.posture is human.SEATED else "Lie back, look"
        self.text = f"{how} straight ahead and rest your arms. Then press the trigger."
        state.tracking.forget_place()

    def take_tracking(self, tracking: messages.Tracking) -> None:
        """The first frame says where they are."""
        frame = self.state.tracking.take(tracking, self.state.now_s)
        if frame.usable and self.state.tracking.registration is None:
            assert tracking.head is not None
            self.state.tracking.place(tracking.head, self.state.person, self.state.world.scene_config.posture)
            self.state.tell_scene()

    def choose_body(self, choice: messages.ChooseBody, by: events.Who) -> Self:
        if self.state.choose_body(choice, by):
            self.state.tracking.place_again(self.state.person)
            self.state.tell_scene()
        return self

    def ready(self) -> LoadCheck | Self:
        """Seat the participant: height, place and direction from the last half second of tracking."""
        state = self.state
        measured, posture = not state.height_known, state.world.scene_config.posture
        try:
            head = state.tracking.steady_head(state.now_s)
            if measured:
                height_m = measure_torso_height(state.person.sex, posture, head, state.plan.furniture)
                state.give_torso_height(height_m)
        except ValueError as error:
            return self._refuse(str(error))
        state.calibrated_for = posture
        state.tracking.place(head, state.person, posture)
        state.sink.tell(events.Calibrated(state.now_s, state.person.torso_height_m, measured))
        return LoadCheck(state)


class Loading(InVR):
    """The current trial's world is made and shown."""

    name = "loading"
    text = "One moment: the scene is being prepared."

    def entered(self) -> None:
        self.state.scenery.prepare(self.state.trial, self.state.person)

    def wait(self) -> Loaded | Paused | Self:
        """Put up the world that is waited for; go on when the client shows it."""
        state = self.state
        if not state.scenery.is_fresh(state.trial, state.person):
            state.scenery.prepare(state.trial, state.person)
            if not state.scenery.ready:
                return self
            try:
                state.scenery.change()
            except NoRoomError as error:
                state.problem(f"the robot has no room to begin: {error}")
                return Paused(state, NO_ROOM)
            except Exception as error:  # whatever a compiler or a file may raise
                state.problem(f"the scene cannot be made: {error}")
                return Paused(state, "The scene cannot be made. Press the trigger to try again.")
        state.tell_scene()
        return self.loaded() if state.scenery.is_shown else self

    def loaded(self) -> Loaded:
        """What follows when the client shows the scene."""
        raise NotImplementedError


class LoadTrial(Loading):
    """The trial begins when its world is shown."""

    def loaded(self) -> Begins:
        return self._begin_trial()


class LoadCalibration(Loading):
    """The participant is measured when the seat or bed is shown."""

    def loaded(self) -> Calibration:
        return Calibration(self.state)


class LoadCheck(Loading):
    """The participant looks at their body when it is shown."""

    def loaded(self) -> Check:
        return Check(self.state)


class Storing(InVR):
    """A completed trial is being stored."""

    name = "loading"
    text = "One moment: the trial is being stored."

    def wait(self) -> Begins | Self:
        return self if self.state.storage.completing is not None else self._begin_trial()


class InPlace(InVR):
    """The participant is in place, so that a trial can begin."""

    in_place = True

    def repeat(self) -> Begins:
        self.state.abandon("repeated")
        return self._begin_trial()

    def skip(self) -> Begins | Finished:
        self.state.abandon("skipped")
        self.state.sink.tell(events.TrialSkipped(self.state.now_s, self.state.trial + 1))
        return self._next_trial()

    def measure_again(self) -> Calibration | LoadCalibration:
        self.state.abandon("interrupted")
        self.state.height_known = False
        return self._calibrate_again()

    def correct_torso_height(self, torso_height_m: float) -> LoadCheck | Self:
        if not self.state.correct_torso_height(torso_height_m):
            return self
        self.state.abandon("interrupted")
        return LoadCheck(self.state)


class Resting(InPlace):
    """No trial runs, and the participant may begin one or change their body."""

    awaits_ready = can_recalibrate = can_choose_body = True

    def recalibrate(self) -> Calibration | LoadCalibration:
        self.state.height_known = False
        return self._calibrate_again()

    def choose_body(self, choice: messages.ChooseBody, by: events.Who) -> Calibration | Loading | Self:
        if not self.state.choose_body(choice, by):
            return self
        return LoadCheck(self.state) if self.state.height_known else self._calibrate_again()

    def ready(self) -> Begins | Self:
        return self._begin_trial()


class Check(Resting):
    """The participant looks whether body and seat fit."""

    name = "check"
    text = "Look down: do body and seat fit you? Trigger: go on. Menu button: measure again."


class Paused(Resting):
    """The robot holds still until the participant presses the trigger, or the experimenter goes on."""

    name = "paused"

    def __init__(self, state: SessionState, text: str) -> None:
        super().__init__(state)
        self.text = text

    def ready(self) -> Begins | Self:
        if self.state.on_hold:
            return self._refuse("the experimenter has paused the session and will continue it")
        return super().ready()

    def go_on(self) -> Begins | Self:
        held = self.state.on_hold
        super().go_on()
        return self._begin_trial() if held else self


class RecordingFailed(Paused):
    """An attempt could not be stored, and can be repeated."""

    def __init__(self, state: SessionState) -> None:
        text = "The recording failed: the robot holds still. Press the trigger to try again."
        super().__init__(state, text)

    def entered(self) -> None:
        self.state.storage.give_up()


class Stoppable(InPlace):
    """A trial runs whose robot moves or is about to."""

    moves = can_be_stopped = True

    def stop(self, by: events.Who) -> Paused:
        return self._break_off("stopped", events.Stopped(self.state.now_s, by), "Stopped")

    def pause(self) -> Begins | Self:
        if self.state.on_hold:
            return self
        super().pause()
        self.state.abandon("paused")
        return self._begin_trial()

    def check_continuity(self, since_last_tick_s: float) -> Paused | Self:
        if since_last_tick_s > LOST_TIME_S:
            return self._interrupt(self._lose_time(since_last_tick_s), _stood_still(since_last_tick_s))
        if self._is_tracked:
            return self
        why = f"tracking was lost for {UNTRACKED_S:g} s"
        self.state.record_event("tracking_timed_out", why)
        return self._interrupt(events.TrackingTimedOut(self.state.now_s), why)

    def _interrupt(self, event: events.SessionEvent, why: str) -> Paused:
        self.state.problem(f"{why}: the attempt is interrupted, and the trial is repeated")
        return self._break_off("interrupted", event, why.capitalize())

    def _break_off(self, result: events.Result, event: events.SessionEvent, why: str) -> Paused:
        """Hold the robot and end the attempt; the participant's trigger repeats the trial."""
        self.state.abandon(result)
        self.state.sink.tell(event)
        self.state.scenery.prepare(self.state.trial, self.state.person)
        return Paused(self.state, f"{why}: the robot holds still. Press the trigger to repeat the trial.")


class FreeBefore(Stoppable):
    """The participant moves freely before the robot does."""

    name = "free_before"

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        plan, trial = state.plan, state.current
        kind = "Practice" if trial.practice else f"Trial {state.trial + 1} of {len(plan.trials)}"
        self.text = (
            f"{kind}: {plan.goal_of(trial)} Move your head and arms as you like; the robot holds still."
        )
        self.seconds = plan.free_movement_s

    def time_over(self) -> Countdown:
        return Countdown(self.state)


class Countdown(Stoppable):
    """The robot is about to start; it waits for a participant whose tracking is lost."""

    name = "countdown"
    text = "The robot starts in"

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.seconds = state.plan.countdown_s

    def time_over(self) -> Trial | Self:
        if self.state.tracking.lost:
            return self
        self.state.scenery.use_up()
        return Trial(self.state)


class Trial(Stoppable):
    """The robot drives."""

    name = "trial"
    text = "The robot is helping you. Press a menu button to stop it."

    @property
    def driver(self) -> Driver:
        return self.state.driver

    def finish_step(self, step: ControlStep) -> FreeAfter | Self:
        attempt = self.state.storage.attempt
        assert attempt is not None
        attempt.record_step(step, self.state.current.policy, self.driver.idle, self.state.now_s)
        if attempt.steps < self.state.plan.trial_steps:
            return self
        self.state.world.hold()
        return FreeAfter(self.state)


class FreeAfter(InPlace):
    """The participant moves freely after the robot has finished; what it gave is kept. The next world is made."""

    name = "free_after"
    text = "The robot has finished and holds still. Move as you like."
    moves = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.seconds = state.plan.free_movement_s

    def entered(self) -> None:
        upcoming = self.state.trial + 1
        if upcoming == len(self.state.plan.trials):
            return
        self.state.scenery.prepare(upcoming, self.state.person)
        url = self.state.scenery.upcoming(upcoming, self.state.person)
        if url is not None:
            self.state.send(messages.Upcoming(url=url))

    def time_over(self) -> Questionnaire | Begins | Finished:
        items = self.state.plan.items_after(self.state.current)
        return Questionnaire(self.state, Questions(items)) if items else self._complete_trial()


class Questionnaire(InPlace):
    """The participant rates the trial, one item after another."""

    name = "questionnaire"
    text = "Point at your answer and press the trigger."

    def __init__(self, state: SessionState, questions: Questions) -> None:
        super().__init__(state)
        self._questions = questions

    @property
    def question(self) -> messages.Question:
        return self._questions.question()

    def answer(self, answer: messages.Answer) -> Begins | Finished | Self:
        """Take the answer to the question that is asked; after the last one the trial is complete."""
        attempt, now_s = self.state.storage.attempt, self.state.now_s
        if attempt is None:
            return self._refuse("an answer counts only while the questionnaire is open")
        try:
            self._questions.take(answer)
        except ValueError as error:
            self.state.problem(str(error))
            self.state.send(self.question)
            return self
        given = answer.item, answer.value, answer.response_time_s
        attempt.record("/answers", records.Answer(*given), now_s)
        self.state.sink.tell(events.Answered(now_s, attempt.trial, attempt.number, *given))
        if self._questions.done:
            return self._complete_trial()
        self.state.send(self.question)
        return self


Begins = LoadTrial | Calibration | Storing | Paused | FreeBefore
"""What may follow when a trial shall begin."""
Loaded = Begins | Check
"""What may follow when a world is shown."""

PHASES: tuple[type[Phase], ...] = (
    Waiting, Calibration, LoadTrial, LoadCalibration, LoadCheck, Storing, Check, FreeBefore, Countdown, Trial,
    FreeAfter, Questionnaire, Paused, RecordingFailed, Finished,
)  # fmt: skip
"""All phases, in the order of a session."""

ALL_DONE = "That was all."
NO_ROOM = "The robot needs room to begin. Rest your arms at your sides and press the trigger to try again."


def where(flag: str) -> list[PhaseName]:
    """The names of the phases whose attribute of this name is true."""
    return list(dict.fromkeys(phase.name for phase in PHASES if getattr(phase, flag)))


def _listed(names: Iterable[str]) -> str:
    """Such as "one, two and three"."""
    *first, last = names
    return f"{', '.join(first)} and {last}"


def _stood_still(seconds: float) -> str:
    return f"the computer stood still for {seconds:.1f} s"
