"""The phases of the headset check, before calibration."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self

from avrgym.questionnaires.questionnaire import Item, translate_items
from avrgym.texts.interface_texts import ParticipantText
from avrgym.vr.headset_check import is_headset_ready, make_result_message
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.headset_measurement import HeadsetMeasurement
from avrgym.vr.session.phases.base_phases import VrPhase, select_arm_text_key
from avrgym.vr.session.plan import HeadsetCheckPlan
from avrgym.vr.session.questions import QuestionSequence
from avrgym.vr.session.session_state import SessionState

YES_ANSWER = 1
MAX_SHOWN_FAULTS = 2
"""Maximum number of faults that the participant sees. Events, database and terminal contain all faults."""
HAPTICS_ITEM = Item(
    "haptics",
    "Do you feel a buzz in your hands, every second?",
    points=2,
    low="yes",
    high="no",
    labels=("yes", "no"),
)
SOUND_ITEM = Item(
    "sound", "Do you hear a chime, every second?", points=2, low="yes", high="no", labels=("yes", "no")
)
TEST_SIGNAL_INTERVAL_S = 1.0
TEST_SIGNAL_DURATION_S = 0.5


class HeadsetCheckPhase(VrPhase):
    """Base class of the phases of the headset check. The experimenter can skip the check."""

    has_motion = True

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state)
        self._measurement = measurement

    def on_tracking(self, tracking: messages.TrackingFrameMessage) -> None:
        """Add a tracking frame. The first usable frame determines the participant's position.

        When the position is known, the client renders the scene with the same workload as in a trial.
        """
        self.state.locate_participant(tracking)

    @property
    def _durations(self) -> HeadsetCheckPlan:
        assert self.state.plan.headset_check is not None
        return self.state.plan.headset_check

    def skip(self) -> phases.Calibration | phases.LoadingCalibration:
        self.state.headset_checked = True
        self.state.event_sink.report(events.HeadsetCheckSkipped(self.state.now_s))
        return self._calibrate_again()

    def _ask_senses(self) -> HapticAndAudioTest | HeadsetCheckResult:
        """Returns the phase with questions about haptics and sound; without such feedback in the plan, the phase with
        the result."""
        plan = self.state.plan
        asked = [HAPTICS_ITEM] * (plan.haptics and self._measurement.has_controller) + [
            SOUND_ITEM
        ] * plan.sounds
        if asked:
            return HapticAndAudioTest(self.state, self._measurement, asked)
        return HeadsetCheckResult(self.state, self._measurement, {})


class HeadsetCheckStart(HeadsetCheckPhase):
    """The participant prepares for the check and starts it with the trigger. This also tests the trigger."""

    name = "headset"
    message = ParticipantText("headset_check")
    awaits_confirmation = True
    has_motion = False

    def __init__(self, state: SessionState) -> None:
        super().__init__(state, HeadsetMeasurement())

    def on_ready(self) -> JitterMeasurement | Self:
        if not self.state.trial_worlds.is_scene_shown:
            return self._refuse("loading")
        return JitterMeasurement(self.state, self._measurement)


class HeadsetMeasurementPhase(HeadsetCheckPhase, ABC):
    """Base class of the phases of the headset check that measure for a limited time."""

    name = "headset_check"
    is_at_rest = arms_stretched = False

    def on_tracking(self, tracking: messages.TrackingFrameMessage) -> None:
        super().on_tracking(tracking)
        self._measurement.add_tracking(tracking, is_at_rest=self.is_at_rest, stretching=self.arms_stretched)

    def on_latency(self, latency: messages.Latency) -> None:
        taken = self.state.record_latency(latency)
        if taken is not None:
            self._measurement.add_latency(taken)

    def on_frame_intervals(self, drawn: messages.FrameIntervals) -> None:
        self._measurement.add_frame_intervals(drawn)

    @abstractmethod
    def on_timeout(self) -> HandRangeMeasurement | DroppedFrameMeasurement | EmergencyStopTest:
        """Continue with the next measurement."""


class JitterMeasurement(HeadsetMeasurementPhase):
    """Measures the jitter of head and hands while the participant rests."""

    message = ParticipantText("headset_at_rest")
    is_at_rest = True

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state, measurement)
        self.time_limit_s = self._durations.rest_duration_s

    def on_timeout(self) -> HandRangeMeasurement | DroppedFrameMeasurement:
        """Continue with the next measurement. Without a headset or without arms, the measurement with stretched arms
        is omitted."""
        with_mouse = "mouse" in self.state.tracking.hand_modalities
        stretches = self.state.participant_input.profile.tracked_arms and not with_mouse
        return (HandRangeMeasurement if stretches else DroppedFrameMeasurement)(self.state, self._measurement)


class HandRangeMeasurement(HeadsetMeasurementPhase):
    """Measures the range of hand tracking while the participant stretches the arms."""

    arms_stretched = True

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state, measurement)
        self.message = ParticipantText(select_arm_text_key("headset_stretched", state))
        self.time_limit_s = self._durations.stretch_duration_s

    def on_timeout(self) -> DroppedFrameMeasurement:
        return DroppedFrameMeasurement(self.state, self._measurement)


class DroppedFrameMeasurement(HeadsetMeasurementPhase):
    """Measures the share of dropped frames while the participant moves."""

    message = ParticipantText("headset_moving")

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state, measurement)
        self.time_limit_s = self._durations.motion_duration_s

    def on_timeout(self) -> EmergencyStopTest:
        return EmergencyStopTest(self.state, self._measurement)


class EmergencyStopTest(HeadsetCheckPhase):
    """The participant tests the emergency stop within a time limit."""

    name = "headset_stop"
    message = ParticipantText("headset_stop")
    can_be_stopped = True

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state, measurement)
        self.time_limit_s = self._durations.test_stop_limit_s
        self._asked_s = state.now_s

    def stop(
        self, by: events.Initiator, method: messages.StopMethod | None = None
    ) -> HapticAndAudioTest | HeadsetCheckResult | Self:
        """Store the participant's test stop and continue with the next phase.

        A stop by the experimenter is accepted only if the participant's input profile contains it.
        """
        after_s = self.state.now_s - self._asked_s
        if by == "participant":
            self._measurement.add_test_stop(method or "page", after_s)
        elif "experimenter" in self.state.participant_input.profile.stop_inputs:
            self._measurement.add_test_stop("experimenter", after_s)
        else:
            return self._report(
                "the participant must test the stop; to continue without it, skip the headset check"
            )
        return self._ask_senses()

    def on_timeout(self) -> HapticAndAudioTest | HeadsetCheckResult:
        self._measurement.add_test_stop("none")
        return self._ask_senses()


class HapticAndAudioTest(HeadsetCheckPhase):
    """The participant answers whether haptics and sound work."""

    name = "headset_check"
    message = ParticipantText("questionnaire")

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement, asked: list[Item]) -> None:
        super().__init__(state, measurement)
        self._asked, self._answers = asked, dict[str, bool]()
        self._questions = QuestionSequence(translate_items(asked, state.plan.texts))
        self._next_s, self._ends_s = state.now_s + TEST_SIGNAL_INTERVAL_S, 0.0

    @property
    def question(self) -> messages.Question:
        return self._questions.make_current_question()

    def poll(self) -> Self:
        """Repeat haptics or sound until the participant answers."""
        now_s, buzzes = (
            self.state.now_s,
            len(self._answers) < len(self._asked) and self._is_current(HAPTICS_ITEM),
        )
        if now_s >= self._next_s:
            self._next_s, self._ends_s = now_s + TEST_SIGNAL_INTERVAL_S, now_s + TEST_SIGNAL_DURATION_S
            self.state.send(messages.HapticAndAudioFeedback(buzzes, buzzes, 0 if buzzes else 1))
        elif 0.0 < self._ends_s <= now_s:
            self._ends_s = 0.0
            self.state.send(
                messages.HapticAndAudioFeedback(left_touched=False, right_touched=False, events=0)
            )
        return self

    def answer(self, answer: messages.Answer) -> HeadsetCheckResult | Self:
        try:
            given = self._questions.store_answer(answer)
        except ValueError as error:
            self.state.send(self.question)
            self._refuse("not_an_answer")
            return self._report(str(error))
        self._answers[given.item] = given.value == YES_ANSWER
        if self._questions.are_all_answered:
            return HeadsetCheckResult(self.state, self._measurement, self._answers)
        self.state.send(self.question)
        return self

    def _is_current(self, item: Item) -> bool:
        return self._asked[len(self._answers)] is item


class HeadsetCheckResult(HeadsetCheckPhase):
    """Shows the result of the headset check. For each fault, the text contains a remedy."""

    name = "headset"
    awaits_confirmation = True
    has_motion = False

    def __init__(
        self, state: SessionState, measurement: HeadsetMeasurement, answers: dict[str, bool]
    ) -> None:
        super().__init__(state, measurement)
        self._check = measurement.compute_result(
            haptics=answers.get(HAPTICS_ITEM.id),
            sound=answers.get(SOUND_ITEM.id),
            used_arms=state.participant_input.profile.tracked_arms,
        )
        self.message = make_result_message(self._check, MAX_SHOWN_FAULTS)

    def on_enter(self) -> None:
        self.state.headset_check_result = self._check
        self.state.event_sink.report(events.HeadsetChecked(self.state.now_s, self._check))

    def on_ready(self) -> HeadsetCheckStart | phases.Calibration | phases.LoadingCalibration:
        if not is_headset_ready(self._check):
            return HeadsetCheckStart(self.state)
        self.state.headset_checked = True
        return self._calibrate_again()
