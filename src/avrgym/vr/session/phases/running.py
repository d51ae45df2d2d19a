"""The phases of a trial: from free movement to the questionnaire."""

from __future__ import annotations

from typing import Self

from avrgym.commands.vocabulary import CommandName, Source
from avrgym.safety.withdrawal import WITHDRAWAL
from avrgym.tasks.control_loop import ControlStep
from avrgym.texts.interface_texts import Text
from avrgym.vr.live_world.drivers import Driver, OperatorDriver
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.interruptions import Interruption
from avrgym.vr.session.phases.kinds import QuestionsPhase, RobotFinishedPhase, StoppablePhase
from avrgym.vr.session.phases.preparing import trial_text
from avrgym.vr.session.questions import Questions
from avrgym.vr.session.state import SessionState


class FreeMovementBefore(StoppablePhase):
    """The participant moves freely before the robot starts."""

    name = "free_before"

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.message = trial_text("free_before", state)
        self.seconds = state.plan.free_movement_s

    def on_timeout(self) -> Countdown:
        return Countdown(self.state)


class Countdown(StoppablePhase):
    """The robot is about to start. The countdown waits while the participant is untracked."""

    name = "countdown"
    message = Text("countdown")

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.seconds = state.plan.countdown_s

    def on_timeout(self) -> Trial | Self:
        if self.state.tracking.lost:
            return self
        self.state.worlds.mark_used()
        return Trial(self.state)


class Trial(StoppablePhase):
    """The robot moves."""

    name = "trial"
    message = Text("helping")

    @property
    def driver(self) -> Driver:
        return self.state.driver

    def drive(self, wish: messages.Drive) -> None:
        if not isinstance(self.driver, OperatorDriver):
            self._report("in this trial no operator drives the robot")
        else:
            self.driver.take_command(wish, self.state.now_s)

    def command_robot(self, command: CommandName, source: Source) -> None:
        self.state.take_command(command, source)

    def on_tracking(self, tracking: messages.Tracking) -> None:
        super().on_tracking(tracking)
        if self.state.head_commands is not None:
            for command, source in self.state.head_commands.gestures(tracking):
                self.state.take_command(command, source)

    def finish_step(self, step: ControlStep) -> Retreat | Self:
        attempt = self.state.storage.attempt
        assert attempt is not None
        idle = bool(self.state.tracking.lost) or (not step.withdrawing and self.driver.idle)
        driver = WITHDRAWAL if step.withdrawing else self.state.current.policy
        attempt.record_step(step, driver, idle, self.state.now_s)
        attempt.record_pacing(self.state.world, step, self.state.now_s)
        if self.state.head_commands is not None:
            for command, source in self.state.head_commands.gaze(self.state.world):
                self.state.take_command(command, source)
        if attempt.steps < self.state.plan.trial_steps:
            return self
        attempt.robot_finished(self.state.now_s)
        return Retreat(self.state)


class Retreat(RobotFinishedPhase):
    """The robot moves its tool away from the person. The trial's results are already complete."""

    name = "retreat"
    message = Text("retreat")
    moves = can_be_stopped = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        state.world.retreat()

    def wait(self) -> FreeMovementAfter | Self:
        return self if self.state.world.retreating else self._hold()

    def stop(self, by: events.Initiator, method: messages.StopMethod | None = None) -> FreeMovementAfter:
        self.state.record_event("retreat_stopped", by)
        self.state.sink.report(events.Stopped(self.state.now_s, by, method))
        return self._hold()

    def pause(self) -> FreeMovementAfter:
        super().pause()
        return self._hold()

    def interrupt(self, interruption: Interruption) -> FreeMovementAfter:
        super().interrupt(interruption)
        return self._hold()

    def _hold(self) -> FreeMovementAfter:
        self.state.world.hold()
        return FreeMovementAfter(self.state)


class FreeMovementAfter(RobotFinishedPhase):
    """The participant moves freely after the robot has finished. Meanwhile, the world of the next trial is built."""

    name = "free_after"
    message = Text("free_after")
    moves = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.seconds = state.plan.free_movement_s

    def on_enter(self) -> None:
        upcoming = self.state.trial + 1
        if upcoming == len(self.state.plan.trials):
            return
        self.state.worlds.prepare(upcoming, self.state.person)
        url = self.state.worlds.upcoming(upcoming, self.state.person)
        if url is not None:
            self.state.send(messages.Upcoming(url=url))

    def on_timeout(self) -> phases.AfterRobot:
        return self._ask()


class Questionnaire(QuestionsPhase, RobotFinishedPhase):
    """The participant rates the trial, one item after another."""

    name = "questionnaire"
    message = Text("questionnaire")

    def __init__(self, state: SessionState, questions: Questions) -> None:
        super().__init__(state)
        self._questions = questions

    def answer(self, answer: messages.Answer) -> Confirm | Self:
        """Store the answer to the current question. After the last question the participant confirms all answers."""
        storage, now_s = self.state.storage, self.state.now_s
        assert storage.questionnaire_attempt is not None
        earlier = self._questions.earlier
        given = self._take(answer)
        if given is None:
            return self
        if given.value != earlier:
            try:
                storage.record_answer(given, now_s)
            except OSError as error:
                self._questions.go_back()
                self.state.send(self.question)
                return self._report(f"the answer cannot be stored: {error}")
            happened = events.Answered if earlier is None else events.AnswerChanged
            whose = storage.questionnaire_attempt.trial, storage.questionnaire_attempt.attempt
            self.state.sink.report(happened(now_s, *whose, given))
            self._apply_stop_rules(given)
        if self._questions.done:
            return Confirm(self.state, self._questions)
        self.state.send(self.question)
        return self

    @property
    def _unanswered(self) -> list[str]:
        return self._questions.unanswered

    def _ask(self) -> Self:
        return self


class Confirm(RobotFinishedPhase):
    """The participant has answered every question, and confirms the answers or goes back to change them."""

    name = "confirm"
    message = Text("confirm")
    awaits_ready = True

    def __init__(self, state: SessionState, questions: Questions) -> None:
        super().__init__(state)
        self._questions = questions

    def on_ready(self) -> phases.TrialStart | phases.Finished:
        return self._complete_trial()

    def go_back(self) -> Questionnaire:
        self._questions.go_back()
        return Questionnaire(self.state, self._questions)

    @property
    def _unanswered(self) -> list[str]:
        return []

    def _ask(self) -> phases.AfterRobot:
        return self._complete_trial()
