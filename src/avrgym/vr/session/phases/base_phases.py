"""Base classes of phases that share transitions."""

# ``RobotFinishedPhase`` overrides methods with other next phases than its base class.
# pyright: reportIncompatibleMethodOverride=false

from __future__ import annotations

from typing import Self

from avrgym.recording.schema import Answer, AttemptEnd
from avrgym.texts.interface_texts import ParticipantText
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.interruptions import UNTRACKED_TEXT_KEYS, Interruption
from avrgym.vr.session.phases.phase import Phase
from avrgym.vr.session.questions import QuestionSequence
from avrgym.vr.session.session_state import SessionState


def select_arm_text_key(key: str, state: SessionState) -> str:
    """Returns the key of a text about both arms, or about the only arm that the participant uses."""
    return f"{key}_one" if len(state.participant_input.profile.tracked_arms) == 1 else key


class OngoingPhase(Phase):
    """Base class of all phases except the last phase of a session."""

    def enter_vr(self) -> phases.PhaseAfterEnteringVr:
        state = self.state
        state.absence_text = None
        state.abandon_attempt("interrupted")
        if state.plan.headset_check is None or state.headset_checked:
            return self._calibrate_again()
        state.reset_location()
        return phases.HeadsetCheckStart(state)

    def leave_vr(self) -> phases.PhaseAfterLeavingVr:
        return self._wait_for_return(ParticipantText("waiting_left"))

    def disconnect(self) -> phases.PhaseAfterLeavingVr:
        super().disconnect()
        return self._wait_for_return(ParticipantText("waiting_lost"))

    def end_session(self) -> phases.PhaseAtSessionEnd:
        self.state.abandon_attempt("ended")
        return self._finish("ended")

    def cancel_session(self) -> phases.PhaseAtSessionEnd:
        return self.end_session()

    def on_storage_failure(self, error: Exception) -> phases.RecordingFailed:
        self.state.world.stop_robot()
        self.state.end_attempt("failed")
        self.state.report_problem(f"the trial cannot be recorded: {error}")
        return phases.RecordingFailed(self.state)

    def on_trial_stored(self) -> phases.SessionFinished | Self:
        return self._finish("finished") if self.state.trial_index == len(self.state.plan.trials) else self

    def _wait_for_return(self, why: ParticipantText) -> phases.WaitingForParticipant:
        self.state.absence_text = why
        self.state.abandon_attempt("interrupted")
        return phases.WaitingForParticipant(self.state, why)

    def _finish(self, key: str) -> phases.SessionFinished:
        self.state.trial_index = len(self.state.plan.trials)
        return phases.SessionFinished(self.state, ParticipantText(key))

    def _calibrate_again(self) -> phases.Calibration | phases.LoadingCalibration:
        """Calibrate the participant again, in the current trial's seat or bed."""
        self.state.reset_location()
        in_place = self.state.world.environment_id == self.state.current_trial.environment
        return phases.Calibration(self.state) if in_place else phases.LoadingCalibration(self.state)

    def _next_trial(self) -> phases.PhaseAtTrialStart | phases.SessionFinished:
        """Continue with the next trial. After the last trial, finish the session."""
        self.state.trial_index = self.state.next_trial_index
        more = self.state.trial_index < len(self.state.plan.trials)
        return self._begin_trial() if more else self._finish("finished")

    def _begin_trial(self) -> phases.PhaseAtTrialStart:
        """Start the next attempt if all conditions are met. Otherwise return the phase that waits for the missing
        condition.

        The previous trial must be stored, and the world built. No break may be due, and the session may not be paused.
        The participant must be calibrated, ready and tracked, and must see the scene.
        """
        state = self.state
        if state.attempt_storage.unstored_trial_index is not None:
            return phases.StoringTrial(state)
        if state.absence_text is not None:
            return phases.WaitingForParticipant(state, state.absence_text)
        if state.headset_time.is_limit_reached:
            return self._finish("time_over")
        if state.headset_time.is_break_due:
            return phases.Break(state)
        if state.headset_time.are_break_questions_due and state.plan.break_items:
            return phases.BreakQuestionnaire(state)
        if not state.trial_worlds.is_world_unused(state.trial_index, state.person):
            return phases.LoadingTrial(state)
        if state.calibrated_posture != state.world.scene_config.posture:
            return phases.Calibration(state)
        if state.is_paused:
            return phases.SessionPaused(state, ParticipantText("break" if state.pause_reason else "paused"))
        if state.visibility != "visible":
            return phases.SessionPaused(state, ParticipantText("not_visible"))
        if state.ready_trial_index != state.trial_index:
            return phases.ReadyConfirmation(state)
        if state.untracked_part is not None:
            return phases.SessionPaused(state, ParticipantText(UNTRACKED_TEXT_KEYS[state.untracked_part]))
        try:
            state.begin_attempt()
        except OSError as error:
            return self.on_storage_failure(error)
        return phases.FreeMovementBeforeTrial(state)

    def _complete_trial(self) -> phases.PhaseAtTrialStart | phases.SessionFinished:
        """End the attempt as completed and continue. If the attempt cannot be stored, the next phase reports this."""
        state = self.state
        recording_failure = state.end_attempt("completed")
        stored = state.event_sink.has_stored_all_events()
        failure = recording_failure or state.event_sink.storage_error
        if failure is not None:
            return self.on_storage_failure(failure)
        if stored:
            return self._next_trial()
        state.attempt_storage.unstored_trial_index = state.next_trial_index - 1
        return phases.StoringTrial(state)


class VrPhase(OngoingPhase):
    """Base class of phases in which the participant is in VR."""

    def on_origin_reset(self) -> phases.PhaseAfterEnteringVr:
        return self.enter_vr()


class LocatedPhase(VrPhase):
    """Base class of phases with known position and direction of the participant. A trial can start."""

    participant_located = True

    def repeat(self) -> phases.PhaseAtTrialStart:
        self.state.abandon_attempt("repeated")
        return self._begin_trial()

    def skip(self) -> phases.PhaseAtTrialStart | phases.SessionFinished:
        self.state.abandon_attempt("skipped")
        self.state.event_sink.report(events.TrialSkipped(self.state.now_s, self.state.trial_index + 1))
        return self._next_trial()

    def repeat_calibration(self) -> phases.Calibration | phases.LoadingCalibration:
        self.state.abandon_attempt("interrupted")
        self.state.torso_height_known = False
        return self._calibrate_again()

    def correct_torso_height(self, torso_height_m: float) -> phases.LoadingBodyCheck | Self:
        if not self.state.correct_torso_height(torso_height_m):
            return self
        self.state.abandon_attempt("interrupted")
        return phases.LoadingBodyCheck(self.state)


class RobotFinishedPhase(LocatedPhase):
    """Base class of phases after the robot has finished. The trial is valid.

    A participant who leaves and returns answers the open questions.
    """

    robot_finished = True

    def enter_vr(self) -> phases.PhaseAfterRobotFinished:
        self.state.absence_text = None
        self.state.reset_location()
        return self._ask()

    def on_origin_reset(self) -> phases.PhaseAfterRobotFinished:
        return self.enter_vr()

    def leave_vr(self) -> phases.PhaseAfterRobotFinished:
        return self._continue_without_participant(ParticipantText("waiting_left"))

    def disconnect(self) -> phases.PhaseAfterRobotFinished:
        Phase.disconnect(self)
        return self._continue_without_participant(ParticipantText("waiting_lost"))

    def end_session(self) -> phases.PhaseAtSessionEnd:
        failure = self.state.complete_attempt()
        return self._finish("ended") if failure is None else self.on_storage_failure(failure)

    def cancel_session(self) -> phases.PhaseAtSessionEnd:
        return self.end_session()

    def repeat(self) -> phases.PhaseAtTrialStart | Self:
        if self.state.attempt_storage.attempt is None:
            return self._report("the trial is complete and cannot be repeated; only its questions are open")
        return super().repeat()

    def skip(self) -> phases.PhaseAtTrialStart | phases.SessionFinished:
        """Complete the trial without the missing answers, and continue."""
        questionnaire_attempt = self.state.attempt_storage.questionnaire_attempt
        assert questionnaire_attempt is not None
        self.state.world.stop_robot()
        left = tuple(self._unanswered)
        if left:
            event = events.QuestionsLeft(
                self.state.now_s,
                questionnaire_attempt.trial_number,
                questionnaire_attempt.attempt_number,
                left,
            )
            self.state.record_event("questions_left", ", ".join(left))
            self.state.event_sink.report(event)
        return self._complete_trial()

    def repeat_calibration(self) -> Self:
        self.state.torso_height_known, self.state.calibrated_posture = False, None
        return self._report("the calibration starts after the questions")

    def correct_torso_height(self, torso_height_m: float) -> Self:
        self.state.correct_torso_height(torso_height_m)
        return self

    @property
    def _unanswered(self) -> list[str]:
        return [item.id for item in self.state.plan.find_questionnaire_items(self.state.current_trial)]

    def _continue_without_participant(self, why: ParticipantText) -> phases.PhaseAfterRobotFinished:
        """Close the recording. After the return, the participant answers the open questions and is calibrated again."""
        self.state.absence_text = why
        failure = self.state.complete_attempt()
        if failure is not None:
            return self.on_storage_failure(failure)
        self.state.reset_location()
        return self._ask()

    def _ask(self) -> phases.PhaseAfterRobotFinished:
        """Start the questionnaire of the trial. Without a questionnaire, complete the trial."""
        items = self.state.plan.find_questionnaire_items(self.state.current_trial)
        return (
            phases.TrialQuestionnaire(self.state, QuestionSequence(items))
            if items
            else self._complete_trial()
        )


class QuestionnairePhase(LocatedPhase):
    """Base class of phases in which the participant answers questions, one after another."""

    _questions: QuestionSequence

    @property
    def question(self) -> messages.Question:
        return self._questions.make_current_question()

    def go_back(self) -> Self:
        if not self._questions.go_back():
            return self._refuse("no_way_back")
        self.state.send(self.question)
        return self

    def _take(self, answer: messages.Answer) -> Answer | None:
        """Store and return the answer to the current question. For an invalid answer, report a problem and return
        ``None``."""
        try:
            return self._questions.store_answer(answer)
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
    """Base class of phases between trials. The participant may start a trial or change their body."""

    awaits_confirmation = can_recalibrate = can_choose_body = True

    def recalibrate(self) -> phases.Calibration | phases.LoadingCalibration:
        self.state.torso_height_known = False
        return self._calibrate_again()

    def choose_body(
        self, choice: messages.BodyChoice, by: events.Initiator
    ) -> phases.Calibration | phases.LoadingCalibration | phases.LoadingBodyCheck | Self:
        if not self.state.choose_body(choice, by):
            return self
        return (
            phases.LoadingBodyCheck(self.state) if self.state.torso_height_known else self._calibrate_again()
        )

    def on_ready(self) -> phases.PhaseAtTrialStart | Self:
        self.state.ready_trial_index = self.state.trial_index
        return self._begin_trial()

    @property
    def can_change_preferences(self) -> bool:
        return bool(self.state.preference_questions)

    def change_preferences(self) -> phases.PreferenceQuestionnaire | Self:
        return (
            phases.PreferenceQuestionnaire(self.state)
            if self.can_change_preferences
            else self._refuse("no_preferences")
        )

    def request_break(self, by: events.Initiator) -> phases.Break | Self:
        self.state.request_break(by)
        return phases.Break(self.state)


class StoppablePhase(LocatedPhase):
    """Base class of phases in which a trial runs, and the robot moves or is about to move."""

    has_motion = can_be_stopped = True

    def stop(self, by: events.Initiator, method: messages.StopMethod | None = None) -> phases.SessionPaused:
        return self._interrupt_attempt(
            "stopped", events.Stopped(self.state.now_s, by, method), ParticipantText("stopped")
        )

    def pause(self) -> phases.PhaseAtTrialStart | Self:
        if self.state.is_paused:
            return self
        super().pause()
        self.state.abandon_attempt("paused")
        return self._begin_trial()

    def interrupt(self, interruption: Interruption) -> phases.SessionPaused:
        self.state.record_event(interruption.event_name, interruption.reason)
        self.state.report_problem(
            f"{interruption.reason}: the attempt is interrupted, and the trial is repeated"
        )
        return self._interrupt_attempt("interrupted", interruption.event, interruption.participant_text)

    def _interrupt_attempt(
        self, result: AttemptEnd, event: events.SessionEvent, message: ParticipantText
    ) -> phases.SessionPaused:
        """Stop the robot and end the attempt. The participant repeats the trial with the trigger."""
        self.state.abandon_attempt(result)
        self.state.event_sink.report(event)
        self.state.trial_worlds.prepare_world(self.state.trial_index, self.state.person)
        return phases.SessionPaused(self.state, message)
