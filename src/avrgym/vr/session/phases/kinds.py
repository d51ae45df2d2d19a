"""Base classes of phases that share transitions."""

# ``RobotFinishedPhase`` overrides methods with other next phases than its base class.
# pyright: reportIncompatibleMethodOverride=false

from __future__ import annotations

from typing import Self

from avrgym.recording.schema import Answer, AttemptEnd
from avrgym.texts.interface_texts import Text
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.interruptions import UNTRACKED_TEXTS, Interruption
from avrgym.vr.session.phases.phase import Phase
from avrgym.vr.session.questions import Questions
from avrgym.vr.session.state import SessionState


def text_for_arms(key: str, state: SessionState) -> str:
    """Returns the key of a text about both arms, or about the only arm that the participant uses."""
    return f"{key}_one" if len(state.input.profile.used_arms) == 1 else key


class OngoingPhase(Phase):
    """Base class of all phases except the last."""

    def enter_vr(self) -> phases.AfterEntering:
        state = self.state
        state.away = None
        state.abandon("interrupted")
        if state.plan.headset_check is None or state.headset_checked:
            return self._calibrate_again()
        state.reset_location()
        return phases.CheckStart(state)

    def leave_vr(self) -> phases.AfterLeaving:
        return self._wait_for_return(Text("waiting_left"))

    def disconnect(self) -> phases.AfterLeaving:
        super().disconnect()
        return self._wait_for_return(Text("waiting_lost"))

    def end(self) -> phases.SessionEnd:
        self.state.abandon("ended")
        return self._finish("ended")

    def cancel(self) -> phases.SessionEnd:
        return self.end()

    def fail(self, error: Exception) -> phases.RecordingFailed:
        self.state.world.hold()
        self.state.end_attempt("failed")
        self.state.report(f"the trial cannot be recorded: {error}")
        return phases.RecordingFailed(self.state)

    def trial_stored(self) -> phases.Finished | Self:
        return self._finish("finished") if self.state.trial == len(self.state.plan.trials) else self

    def _wait_for_return(self, why: Text) -> phases.Waiting:
        self.state.away = why
        self.state.abandon("interrupted")
        return phases.Waiting(self.state, why)

    def _finish(self, key: str) -> phases.Finished:
        self.state.trial = len(self.state.plan.trials)
        return phases.Finished(self.state, Text(key))

    def _calibrate_again(self) -> phases.Calibration | phases.LoadCalibration:
        """Calibrate the participant again, in the current trial's seat or bed."""
        self.state.reset_location()
        in_place = self.state.world.environment_id == self.state.current.environment
        return phases.Calibration(self.state) if in_place else phases.LoadCalibration(self.state)

    def _next_trial(self) -> phases.TrialStart | phases.Finished:
        """Continue with the next trial, or finish after the last."""
        self.state.trial = self.state.following
        more = self.state.trial < len(self.state.plan.trials)
        return self._begin_trial() if more else self._finish("finished")

    def _begin_trial(self) -> phases.TrialStart:
        """Start the next attempt if all conditions are met. Otherwise returns the phase that waits for the missing one.

        Conditions: the previous trial is stored, no break is due, the world is built, the participant is calibrated,
        ready and tracked and sees the scene, and the session is not paused.
        """
        state = self.state
        if state.storage.completing is not None:
            return phases.Storing(state)
        if state.away is not None:
            return phases.Waiting(state, state.away)
        if state.headset_time.is_over:
            return self._finish("time_over")
        if state.headset_time.break_is_due:
            return phases.Break(state)
        if state.headset_time.questions_due and state.plan.break_items:
            return phases.BreakQuestionnaire(state)
        if not state.worlds.is_unused(state.trial, state.person):
            return phases.LoadTrial(state)
        if state.calibrated_for != state.world.scene_config.posture:
            return phases.Calibration(state)
        if state.on_hold:
            return phases.Paused(state, Text("break" if state.pause_reason else "paused"))
        if state.visibility != "visible":
            return phases.Paused(state, Text("not_visible"))
        if state.ready_for != state.trial:
            return phases.ConfirmReady(state)
        if state.untracked is not None:
            return phases.Paused(state, Text(UNTRACKED_TEXTS[state.untracked]))
        try:
            state.begin_attempt()
        except OSError as error:
            return self.fail(error)
        return phases.FreeMovementBefore(state)

    def _complete_trial(self) -> phases.TrialStart | phases.Finished:
        """End the attempt as completed and continue. If it cannot be stored, the next phase reports this."""
        state = self.state
        recording_failure = state.end_attempt("completed")
        stored = state.sink.has_stored_all()
        failure = recording_failure or state.sink.failure
        if failure is not None:
            return self.fail(failure)
        if stored:
            return self._next_trial()
        state.storage.completing = state.following - 1
        return phases.Storing(state)


class VrPhase(OngoingPhase):
    """The participant is in VR."""

    def on_origin_reset(self) -> phases.AfterEntering:
        return self.enter_vr()


class LocatedPhase(VrPhase):
    """The participant's position and direction are known, so a trial can start."""

    in_place = True

    def repeat(self) -> phases.TrialStart:
        self.state.abandon("repeated")
        return self._begin_trial()

    def skip(self) -> phases.TrialStart | phases.Finished:
        self.state.abandon("skipped")
        self.state.sink.report(events.TrialSkipped(self.state.now_s, self.state.trial + 1))
        return self._next_trial()

    def repeat_calibration(self) -> phases.Calibration | phases.LoadCalibration:
        self.state.abandon("interrupted")
        self.state.height_known = False
        return self._calibrate_again()

    def correct_torso_height(self, torso_height_m: float) -> phases.LoadCheck | Self:
        if not self.state.correct_torso_height(torso_height_m):
            return self
        self.state.abandon("interrupted")
        return phases.LoadCheck(self.state)


class RobotFinishedPhase(LocatedPhase):
    """The robot has finished, so the trial is valid. After an absence, the participant answers the open questions."""

    robot_finished = True

    def enter_vr(self) -> phases.AfterRobot:
        self.state.away = None
        self.state.reset_location()
        return self._ask()

    def on_origin_reset(self) -> phases.AfterRobot:
        return self.enter_vr()

    def leave_vr(self) -> phases.AfterRobot:
        return self._continue_without_participant(Text("waiting_left"))

    def disconnect(self) -> phases.AfterRobot:
        Phase.disconnect(self)
        return self._continue_without_participant(Text("waiting_lost"))

    def end(self) -> phases.SessionEnd:
        failure = self.state.complete_attempt()
        return self._finish("ended") if failure is None else self.fail(failure)

    def cancel(self) -> phases.SessionEnd:
        return self.end()

    def repeat(self) -> phases.TrialStart | Self:
        if self.state.storage.attempt is None:
            return self._report("the trial is complete and cannot be repeated; only its questions are open")
        return super().repeat()

    def skip(self) -> phases.TrialStart | phases.Finished:
        """Complete the trial without the missing answers, and continue."""
        questionnaire_attempt = self.state.storage.questionnaire_attempt
        assert questionnaire_attempt is not None
        self.state.world.hold()
        left = tuple(self._unanswered)
        if left:
            event = events.QuestionsLeft(
                self.state.now_s, questionnaire_attempt.trial, questionnaire_attempt.attempt, left
            )
            self.state.record_event("questions_left", ", ".join(left))
            self.state.sink.report(event)
        return self._complete_trial()

    def repeat_calibration(self) -> Self:
        self.state.height_known, self.state.calibrated_for = False, None
        return self._report("the calibration starts after the questions")

    def correct_torso_height(self, torso_height_m: float) -> Self:
        self.state.correct_torso_height(torso_height_m)
        return self

    @property
    def _unanswered(self) -> list[str]:
        return [item.id for item in self.state.plan.questionnaire_after(self.state.current)]

    def _continue_without_participant(self, why: Text) -> phases.AfterRobot:
        """Close the recording. On return, the participant answers the open questions and is then calibrated again."""
        self.state.away = why
        failure = self.state.complete_attempt()
        if failure is not None:
            return self.fail(failure)
        self.state.reset_location()
        return self._ask()

    def _ask(self) -> phases.AfterRobot:
        """Start the questionnaire of the trial, or continue without one."""
        items = self.state.plan.questionnaire_after(self.state.current)
        return phases.Questionnaire(self.state, Questions(items)) if items else self._complete_trial()


class QuestionsPhase(LocatedPhase):
    """The participant answers questions, one after another."""

    _questions: Questions

    @property
    def question(self) -> messages.Question:
        return self._questions.question()

    def go_back(self) -> Self:
        if not self._questions.go_back():
            return self._refuse("no_way_back")
        self.state.send(self.question)
        return self

    def _take(self, answer: messages.Answer) -> Answer | None:
        """Store and return the answer to the current question. Rejects an invalid answer and returns ``None``."""
        try:
            return self._questions.take(answer)
        except ValueError as error:
            self.state.send(self.question)
            self._refuse("not_an_answer")
            self._report(str(error))
            return None

    def _apply_stop_rules(self, answer: Answer) -> None:
        decision = self.state.plan.stop_rules.decide(answer.item, answer.value)
        if decision is not None:
            self.state.apply_stop_rule(decision)


class BetweenTrialsPhase(LocatedPhase):
    """No trial runs. The participant may start a trial or change their body."""

    awaits_ready = can_recalibrate = can_choose_body = True

    def recalibrate(self) -> phases.Calibration | phases.LoadCalibration:
        self.state.height_known = False
        return self._calibrate_again()

    def choose_body(
        self, choice: messages.ChooseBody, by: events.Initiator
    ) -> phases.Calibration | phases.LoadCalibration | phases.LoadCheck | Self:
        if not self.state.choose_body(choice, by):
            return self
        return phases.LoadCheck(self.state) if self.state.height_known else self._calibrate_again()

    def on_ready(self) -> phases.TrialStart | Self:
        self.state.ready_for = self.state.trial
        return self._begin_trial()

    @property
    def can_prefer(self) -> bool:
        return bool(self.state.preference_questions)

    def change_preferences(self) -> phases.PreferenceQuestionnaire | Self:
        return (
            phases.PreferenceQuestionnaire(self.state) if self.can_prefer else self._refuse("no_preferences")
        )

    def request_break(self, by: events.Initiator) -> phases.Break | Self:
        self.state.request_break(by)
        return phases.Break(self.state)


class StoppablePhase(LocatedPhase):
    """A trial runs, and the robot moves or is about to move."""

    moves = can_be_stopped = True

    def stop(self, by: events.Initiator, method: messages.StopMethod | None = None) -> phases.Paused:
        return self._interrupt_attempt(
            "stopped", events.Stopped(self.state.now_s, by, method), Text("stopped")
        )

    def pause(self) -> phases.TrialStart | Self:
        if self.state.on_hold:
            return self
        super().pause()
        self.state.abandon("paused")
        return self._begin_trial()

    def interrupt(self, interruption: Interruption) -> phases.Paused:
        self.state.record_event(interruption.name, interruption.why)
        self.state.report(f"{interruption.why}: the attempt is interrupted, and the trial is repeated")
        return self._interrupt_attempt("interrupted", interruption.event, interruption.message)

    def _interrupt_attempt(
        self, result: AttemptEnd, event: events.SessionEvent, message: Text
    ) -> phases.Paused:
        """Stop the robot and end the attempt. The participant's trigger repeats the trial."""
        self.state.abandon(result)
        self.state.sink.report(event)
        self.state.worlds.prepare(self.state.trial, self.state.person)
        return phases.Paused(self.state, message)
