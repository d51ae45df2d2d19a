"""The phases of a trial: from free movement to the questionnaire."""

from __future__ import annotations

from typing import Self

from avrgym.commands.vocabulary import CommandName, CommandSource
from avrgym.safety.withdrawal import WITHDRAWAL_DRIVER
from avrgym.tasks.control_loop import FirstWorldStep
from avrgym.texts.interface_texts import ParticipantText
from avrgym.vr.live_world.drivers import Driver, OperatorDriver
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.interruptions import Interruption
from avrgym.vr.session.phases.base_phases import QuestionnairePhase, RobotFinishedPhase, StoppablePhase
from avrgym.vr.session.phases.setup_phases import make_trial_text
from avrgym.vr.session.questions import QuestionSequence
from avrgym.vr.session.session_state import SessionState


class FreeMovementBeforeTrial(StoppablePhase):
    """The participant moves freely before the robot starts."""

    name = "free_before"

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.message = make_trial_text("free_before", state)
        self.time_limit_s = state.plan.free_movement_s

    def on_timeout(self) -> Countdown:
        return Countdown(self.state)


class Countdown(StoppablePhase):
    """The robot is about to start. The countdown waits while the participant is untracked."""

    name = "countdown"
    message = ParticipantText("countdown")

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.time_limit_s = state.plan.countdown_s

    def on_timeout(self) -> RunningTrial | Self:
        if self.state.tracking.untracked_needed_parts:
            return self
        self.state.trial_worlds.mark_world_used()
        return RunningTrial(self.state)


class RunningTrial(StoppablePhase):
    """The robot moves. A policy or an operator drives it."""

    name = "trial"
    message = ParticipantText("helping")

    @property
    def driver(self) -> Driver:
        return self.state.driver

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self._refused_roles: set[messages.OperatorRole] = set()

    def apply_velocity_command(self, command: messages.VelocityCommand) -> None:
        if isinstance(self.driver, OperatorDriver):
            self._refuse_driver(self.driver.apply_velocity_command(command, self.state.now_s), command.source)
        else:
            self._refuse_without_operator(command.source, engaged=command.engaged)

    def apply_controller_pose(self, steer: messages.ControllerPoseCommand) -> None:
        if isinstance(self.driver, OperatorDriver):
            self._refuse_driver(self.driver.apply_controller_pose(steer, self.state.now_s), "demonstrator")
        else:
            self._refuse_without_operator("demonstrator", engaged=steer.clutch)

    def on_demonstrator_disconnected(self) -> None:
        if isinstance(self.driver, OperatorDriver) and self.driver.active_operator == "demonstrator":
            self.state.stop_operator(self.driver, "driver_left")
            self._report("the demonstrator left and does not drive the robot any more; it holds its position")

    def _refuse_driver(self, problem: str, role: messages.OperatorRole) -> None:
        if problem:
            receiver = "demonstrator" if role == "demonstrator" else "experimenter"
            self.state.send(messages.Problem(problem, receiver))

    def _refuse_without_operator(self, role: messages.OperatorRole, *, engaged: bool) -> None:
        """Report that a policy drives the robot, once for each series of commands of an operator."""
        if engaged and role not in self._refused_roles:
            self._refuse_driver("in this trial no operator drives the robot", role)
        (self._refused_roles.add if engaged else self._refused_roles.discard)(role)

    def command_robot(self, command: CommandName, source: CommandSource) -> None:
        self.state.handle_command(command, source)

    def on_tracking(self, tracking: messages.TrackingFrameMessage) -> None:
        super().on_tracking(tracking)
        if self.state.head_command_detector is not None:
            for command, source in self.state.head_command_detector.detect_gesture_commands(tracking):
                self.state.handle_command(command, source)

    def on_control_step(self, step: FirstWorldStep) -> RobotRetreat | Self:
        attempt = self.state.attempt_storage.attempt
        assert attempt is not None
        idle = bool(self.state.tracking.untracked_needed_parts) or (
            not step.is_withdrawing and self.driver.is_idle
        )
        driver = WITHDRAWAL_DRIVER if step.is_withdrawing else self.state.current_trial.policy
        if isinstance(self.driver, OperatorDriver):
            driver = self.driver.latest_operator
        attempt.record_step(step, driver, idle, self.state.now_s)
        attempt.record_pacing(self.state.world, step, self.state.now_s)
        if self.state.head_command_detector is not None:
            for command, source in self.state.head_command_detector.detect_gaze_commands(self.state.world):
                self.state.handle_command(command, source)
        if attempt.steps < self.state.plan.trial_steps:
            return self
        attempt.record_robot_finish(self.state.now_s)
        return RobotRetreat(self.state)


class RobotRetreat(RobotFinishedPhase):
    """The robot moves its tool away from the person. The trial's results are already complete."""

    name = "retreat"
    message = ParticipantText("retreat")
    has_motion = can_be_stopped = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        state.world.start_retreat()

    def poll(self) -> FreeMovementAfterTrial | Self:
        return self if self.state.world.is_retreating else self._hold()

    def stop(self, by: events.Initiator, method: messages.StopMethod | None = None) -> FreeMovementAfterTrial:
        self.state.record_event("retreat_stopped", by)
        self.state.event_sink.report(events.Stopped(self.state.now_s, by, method))
        return self._hold()

    def pause(self) -> FreeMovementAfterTrial:
        super().pause()
        return self._hold()

    def interrupt(self, interruption: Interruption) -> FreeMovementAfterTrial:
        super().interrupt(interruption)
        return self._hold()

    def _hold(self) -> FreeMovementAfterTrial:
        self.state.world.stop_robot()
        return FreeMovementAfterTrial(self.state)


class FreeMovementAfterTrial(RobotFinishedPhase):
    """The participant moves freely after the robot has finished. Meanwhile, the world of the next trial is built."""

    name = "free_after"
    message = ParticipantText("free_after")
    has_motion = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.time_limit_s = state.plan.free_movement_s

    def on_enter(self) -> None:
        upcoming = self.state.trial_index + 1
        if upcoming == len(self.state.plan.trials):
            return
        self.state.trial_worlds.prepare_world(upcoming, self.state.person)
        url = self.state.trial_worlds.find_next_scene_url(upcoming, self.state.person)
        if url is not None:
            self.state.send(messages.NextScene(url=url))

    def on_timeout(self) -> phases.PhaseAfterRobotFinished:
        return self._ask()


class TrialQuestionnaire(QuestionnairePhase, RobotFinishedPhase):
    """The participant rates the trial, one item after another."""

    name = "questionnaire"
    message = ParticipantText("questionnaire")

    def __init__(self, state: SessionState, questions: QuestionSequence) -> None:
        super().__init__(state)
        self._questions = questions

    def answer(self, answer: messages.Answer) -> AnswerConfirmation | Self:
        """Store the answer to the current question. After the last question the participant confirms all answers."""
        storage, now_s = self.state.attempt_storage, self.state.now_s
        assert storage.questionnaire_attempt is not None
        earlier = self._questions.previous_answer
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
            whose = storage.questionnaire_attempt.trial_number, storage.questionnaire_attempt.attempt_number
            self.state.event_sink.report(happened(now_s, *whose, given))
            self._apply_stop_rules(given)
        if self._questions.are_all_answered:
            return AnswerConfirmation(self.state, self._questions)
        self.state.send(self.question)
        return self

    @property
    def _unanswered(self) -> list[str]:
        return self._questions.unanswered_item_ids

    def _ask(self) -> Self:
        return self


class AnswerConfirmation(RobotFinishedPhase):
    """The participant has answered every question, and confirms the answers or goes back to change them."""

    name = "confirm"
    message = ParticipantText("confirm")
    awaits_confirmation = True

    def __init__(self, state: SessionState, questions: QuestionSequence) -> None:
        super().__init__(state)
        self._questions = questions

    def on_ready(self) -> phases.PhaseAtTrialStart | phases.SessionFinished:
        return self._complete_trial()

    def go_back(self) -> TrialQuestionnaire:
        self._questions.go_back()
        return TrialQuestionnaire(self.state, self._questions)

    @property
    def _unanswered(self) -> list[str]:
        return []

    def _ask(self) -> phases.PhaseAfterRobotFinished:
        return self._complete_trial()
