"""The phases before a trial: entering VR, calibration, and a check of body and seat."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from statistics import median
from typing import ClassVar, Self

import msgspec

from avrgym.commands.preferences import describe_preferences
from avrgym.models.body_names import PERSON_ARM_SIDES
from avrgym.questionnaires.questionnaire import translate_items
from avrgym.simulation.start_clearance import NoClearanceError
from avrgym.texts.interface_texts import ParticipantActionError, ParticipantText
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.phases.base_phases import (
    BetweenTrialsPhase,
    OngoingPhase,
    QuestionnairePhase,
    VrPhase,
    select_arm_text_key,
)
from avrgym.vr.session.questions import QuestionSequence
from avrgym.vr.session.session_state import SessionState
from avrgym.vr.tracking.calibration import measure_arm_length_m, measure_arm_scale, measure_torso_height
from avrgym.vr.tracking.tracking_frames import compute_body_pose

_PUT_ON = ParticipantText("waiting")
REACH_POSE_DURATION_S, MAX_REACH_FRAMES = 5.0, 60
"""Duration in seconds of each pose with stretched arms, and maximum number of frames: only the last frames are used."""


class WaitingForParticipant(OngoingPhase):
    """The participant is not in VR. The session continues when the participant enters VR."""

    name = "waiting"
    can_choose_body = True

    def __init__(self, state: SessionState, message: ParticipantText = _PUT_ON) -> None:
        super().__init__(state)
        self.message = message

    def choose_body(self, choice: messages.BodyChoice, by: events.Initiator) -> Self:
        self.state.choose_body(choice, by)
        return self


class Calibration(VrPhase):
    """The participant rests in the seat or bed and presses the trigger. The torso height is then measured."""

    name = "calibration"
    awaits_confirmation = can_choose_body = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        seated = state.world.scene_config.posture.is_seated
        self.message = ParticipantText("calibration_seated" if seated else "calibration_lying")
        state.tracking.reset_location()

    def on_tracking(self, tracking: messages.TrackingFrameMessage) -> None:
        self.state.locate_participant(tracking)

    def choose_body(self, choice: messages.BodyChoice, by: events.Initiator) -> Self:
        if self.state.choose_body(choice, by):
            self.state.tracking.update_location(self.state.person)
            self.state.send_changed_scene()
        return self

    def on_ready(self) -> LoadingBodyCheck | ForwardReachMeasurement | Self:
        """Calibrate torso height, position and direction from the last half second of tracking.

        Without a headset, and if the participant uses no arm, the arms are not measured.
        """
        state = self.state
        measured, posture = not state.torso_height_known, state.world.scene_config.posture
        try:
            head = state.tracking.find_steady_headset_pose(state.now_s)
            if measured:
                height_m = measure_torso_height(state.person.sex, posture, head, state.plan.furniture)
                state.set_torso_height(height_m)
        except ParticipantActionError as error:
            state.explain_rejection(error.participant_text)
            return self
        state.calibrated_posture = posture
        state.tracking.determine_registration(head, state.person, posture, state.plan.furniture)
        state.event_sink.report(events.Calibrated(state.now_s, state.person.torso_height_m, measured))
        with_headset = "mouse" not in state.tracking.hand_modalities
        measures_reach = (
            measured
            and state.plan.reach_measurement_enabled
            and with_headset
            and state.participant_input.profile.tracked_arms
        )
        return ForwardReachMeasurement(state) if measures_reach else LoadingBodyCheck(state)


class ReachMeasurement(VrPhase, ABC):
    """The participant stretches the arms to measure their length. The trigger skips the measurement."""

    name = "reach"
    time_limit_s = REACH_POSE_DURATION_S
    awaits_confirmation = True
    pose_text_key: ClassVar[str]

    def __init__(self, state: SessionState, reached_m: Sequence[float] = ()) -> None:
        super().__init__(state)
        self.message = ParticipantText(select_arm_text_key(self.pose_text_key, state))
        self._reached_m, self._seen_m = tuple(reached_m), list[float]()

    def on_tracking(self, tracking: messages.TrackingFrameMessage) -> None:
        """Add a tracking frame. Only the last ``MAX_REACH_FRAMES`` frames are used."""
        state = self.state
        frame = state.tracking.add_frame(tracking, state.now_s)
        if not frame.is_usable or state.tracking.registration is None:
            return
        resting = [arm for arm in PERSON_ARM_SIDES if arm not in state.participant_input.profile.tracked_arms]
        tracking = msgspec.structs.replace(frame.tracking, **dict.fromkeys(resting))
        pose = compute_body_pose(state.tracking.registration, tracking)
        length_m = measure_arm_length_m(state.person, state.world.scene_config.posture, pose)
        if length_m is not None:
            self._seen_m = [*self._seen_m[1 - MAX_REACH_FRAMES :], length_m]

    def on_ready(self) -> LoadingBodyCheck:
        """Skip the measurement. The virtual arms then have mean length."""
        return LoadingBodyCheck(self.state)

    @property
    def _all_m(self) -> tuple[float, ...]:
        """Distances in metres of the wrist from the shoulder, one for each pose until now; empty if the current pose
        was not tracked."""
        return (*self._reached_m, median(self._seen_m)) if self._seen_m else ()


class ForwardReachMeasurement(ReachMeasurement):
    """The participant stretches the arms to the front."""

    pose_text_key = "reach_ahead"

    def on_timeout(self) -> SidewaysReachMeasurement | LoadingBodyCheck:
        if self._all_m:
            return SidewaysReachMeasurement(self.state, self._all_m)
        self.state.explain_rejection(ParticipantText("reach_unseen"))
        return LoadingBodyCheck(self.state)


class SidewaysReachMeasurement(ReachMeasurement):
    """The participant stretches the arms to the sides."""

    pose_text_key = "reach_aside"

    def on_timeout(self) -> LoadingBodyCheck:
        state = self.state
        if not self._all_m:
            state.explain_rejection(ParticipantText("reach_unseen"))
            return LoadingBodyCheck(state)
        try:
            state.set_arm_scale(measure_arm_scale(state.person, self._all_m))
        except ValueError as error:
            state.explain_rejection(ParticipantText("reach_unlikely"))
            state.report_problem(str(error))
        return LoadingBodyCheck(state)


class LoadingPhase(VrPhase, ABC):
    """Base class of phases in which the current trial's world is built and shown."""

    name = "loading"
    message = ParticipantText("loading")

    def on_enter(self) -> None:
        self.state.trial_worlds.prepare_world(self.state.trial_index, self.state.person)

    def poll(self) -> phases.PhaseAfterLoading | Self:
        """Show the prepared world. Continue when the client shows it."""
        state = self.state
        if not state.trial_worlds.is_world_unused(state.trial_index, state.person):
            state.trial_worlds.prepare_world(state.trial_index, state.person)
            if not state.trial_worlds.is_world_ready:
                return self
            try:
                state.trial_worlds.switch_world()
            except NoClearanceError as error:
                state.report_problem(f"the robot has no collision-free start: {error}")
                return phases.SessionPaused(state, ParticipantText("no_room"))
            except Exception as error:  # the compiler and files may raise any exception
                state.report_problem(f"the scene cannot be created: {error}")
                return phases.SessionPaused(state, ParticipantText("scene_failed"))
        state.send_changed_scene()
        return self.on_scene_loaded() if state.trial_worlds.is_scene_shown else self

    @abstractmethod
    def on_scene_loaded(self) -> phases.PhaseAfterLoading:
        """Returns the next phase when the client shows the scene."""


class LoadingTrial(LoadingPhase):
    """The trial starts when its world is shown."""

    def on_scene_loaded(self) -> phases.PhaseAtTrialStart:
        return self._begin_trial()


class LoadingCalibration(LoadingPhase):
    """Calibration starts when the seat or bed is shown."""

    def on_scene_loaded(self) -> Calibration:
        return Calibration(self.state)


class LoadingBodyCheck(LoadingPhase):
    """The check of the body starts when the body is shown."""

    def on_scene_loaded(self) -> BodyCheck:
        return BodyCheck(self.state)


class StoringTrial(VrPhase):
    """The session waits until a completed trial is stored."""

    name = "loading"
    message = ParticipantText("storing")

    def poll(self) -> phases.PhaseAtTrialStart | Self:
        return self if self.state.attempt_storage.unstored_trial_index is not None else self._begin_trial()


class BodyCheck(BetweenTrialsPhase):
    """The participant checks whether the virtual body and seat fit the real body and seat."""

    name = "check"
    message = ParticipantText("check")


class ReadyConfirmation(BetweenTrialsPhase):
    """The trial's scene is shown. The trial starts when the participant is ready."""

    name = "ready"

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.message = make_trial_text("ready", state, with_preferences=True)


class PreferenceQuestionnaire(QuestionnairePhase):
    """The participant changes their preferences for the robot. They apply from the next trial on."""

    name = "questionnaire"
    message = ParticipantText("questionnaire")

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        assert state.current_trial.rules is not None
        self._asked, before = state.preference_questions, state.current_trial.rules.preferences
        self._before = {each.preference_name: each.find_answer(before) for each in self._asked}
        items = translate_items([each.questionnaire_item for each in self._asked], state.plan.texts)
        self._questions = QuestionSequence(items, self._before, review=True)
        self._given: dict[str, int] = {}
        state.ready_trial_index = -1

    def answer(self, answer: messages.Answer) -> phases.PhaseAtTrialStart | Self:
        """Store the answer to the current question. The last answer changes the preferences."""
        given = self._take(answer)
        if given is None:
            return self
        self._given[given.item] = given.value
        if not self._questions.are_all_answered:
            self.state.send(self.question)
            return self
        changes = {
            each.preference_name: each.answer_values[self._given[each.preference_name] - 1]
            for each in self._asked
            if self._given[each.preference_name] != self._before[each.preference_name]
        }
        if changes:
            self.state.change_preferences(changes)
        return self._begin_trial()

    def skip(self) -> phases.PhaseAtTrialStart:
        """Continue with the next trial, without a change of preferences."""
        return self._begin_trial()


def make_trial_text(key: str, state: SessionState, *, with_preferences: bool = False) -> ParticipantText:
    """Returns the text about the next trial: its number and its task.

    ``with_preferences``: whether to add the participant's preferences in this trial, if the trial has commands or
    preferences.
    """
    plan, trial = state.plan, state.current_trial
    goal = plan.find_goal_text(trial)
    if with_preferences and trial.rules is not None:
        goal = f"{goal} {describe_preferences(trial.rules.preferences, plan.texts.language)}"
    number = {"trial": str(state.trial_index + 1), "trials": str(len(plan.trials))}
    which = plan.texts.format_for_vr(
        ParticipantText("practice") if trial.practice else ParticipantText("trial", number)
    )
    return ParticipantText(key, {"trial": which, "goal": goal})
