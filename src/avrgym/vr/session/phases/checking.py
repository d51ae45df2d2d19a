"""The phases of the headset check, before calibration."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self

from avrgym.questionnaires.questionnaire import Item, translate
from avrgym.texts.interface_texts import Text
from avrgym.vr.headset_check import is_ready, result_message
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.headset_measuring import HeadsetMeasurement
from avrgym.vr.session.phases.kinds import VrPhase, text_for_arms
from avrgym.vr.session.plan import HeadsetCheckPlan
from avrgym.vr.session.questions import Questions
from avrgym.vr.session.state import SessionState

YES_ANSWER = 1
MAX_FAULTS_SHOWN = 2
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
SIGNAL_INTERVAL_S = 1.0
SIGNAL_DURATION_S = 0.5


class HeadsetCheckPhase(VrPhase):
    """Base class of the phases of the headset check. The experimenter can skip the check."""

    moves = True

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state)
        self._measurement = measurement

    def on_tracking(self, tracking: messages.Tracking) -> None:
        """Add a tracking frame. The first usable frame determines the participant's position.

        The client then renders the scene with the same effort as in a trial.
        """
        self.state.locate_participant(tracking)

    @property
    def _durations(self) -> HeadsetCheckPlan:
        assert self.state.plan.headset_check is not None
        return self.state.plan.headset_check

    def skip(self) -> phases.Calibration | phases.LoadCalibration:
        self.state.headset_checked = True
        self.state.sink.report(events.HeadsetCheckSkipped(self.state.now_s))
        return self._calibrate_again()

    def _ask_senses(self) -> CheckFeedback | CheckResult:
        """Returns the phase that asks about haptics and sound, if the plan has them; otherwise the result."""
        plan = self.state.plan
        asked = [HAPTICS_ITEM] * (plan.haptics and self._measurement.has_controller) + [
            SOUND_ITEM
        ] * plan.sounds
        if asked:
            return CheckFeedback(self.state, self._measurement, asked)
        return CheckResult(self.state, self._measurement, {})


class CheckStart(HeadsetCheckPhase):
    """The participant prepares for the check and starts it with the trigger. This also tests the trigger."""

    name = "headset"
    message = Text("headset_check")
    awaits_ready = True
    moves = False

    def __init__(self, state: SessionState) -> None:
        super().__init__(state, HeadsetMeasurement())

    def on_ready(self) -> CheckAtRest | Self:
        if not self.state.worlds.is_shown:
            return self._refuse("loading")
        return CheckAtRest(self.state, self._measurement)


class TimedMeasurement(HeadsetCheckPhase, ABC):
    """Base class of phases that measure for a limited time."""

    name = "headset_check"
    at_rest = stretching = False

    def on_tracking(self, tracking: messages.Tracking) -> None:
        super().on_tracking(tracking)
        self._measurement.add_tracking(tracking, at_rest=self.at_rest, stretching=self.stretching)

    def on_latency(self, latency: messages.Latency) -> None:
        taken = self.state.take_latency(latency)
        if taken is not None:
            self._measurement.add_latency(taken)

    def on_frames(self, drawn: messages.HeadsetFrames) -> None:
        self._measurement.add_frames(drawn)

    @abstractmethod
    def on_timeout(self) -> CheckStretched | CheckMoving | CheckStop:
        """Continue with the next measurement."""


class CheckAtRest(TimedMeasurement):
    """Measures the jitter of tracking."""

    message = Text("headset_at_rest")
    at_rest = True

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state, measurement)
        self.seconds = self._durations.at_rest_s

    def on_timeout(self) -> CheckStretched | CheckMoving:
        """Continue with the next measurement. Without a headset or without arms, the measurement with stretched arms
        is omitted."""
        with_mouse = "mouse" in self.state.tracking.modalities
        stretches = self.state.input.profile.used_arms and not with_mouse
        return (CheckStretched if stretches else CheckMoving)(self.state, self._measurement)


class CheckStretched(TimedMeasurement):
    """Measures the range of hand tracking."""

    stretching = True

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state, measurement)
        self.message = Text(text_for_arms("headset_stretched", state))
        self.seconds = self._durations.stretched_s

    def on_timeout(self) -> CheckMoving:
        return CheckMoving(self.state, self._measurement)


class CheckMoving(TimedMeasurement):
    """Measures dropped frames during motion."""

    message = Text("headset_moving")

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state, measurement)
        self.seconds = self._durations.moving_s

    def on_timeout(self) -> CheckStop:
        return CheckStop(self.state, self._measurement)


class CheckStop(HeadsetCheckPhase):
    """The participant tests the emergency stop."""

    name = "headset_stop"
    message = Text("headset_stop")
    can_be_stopped = True

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement) -> None:
        super().__init__(state, measurement)
        self.seconds = self._durations.test_stop_limit_s
        self._asked_s = state.now_s

    def stop(
        self, by: events.Initiator, method: messages.StopMethod | None = None
    ) -> CheckFeedback | CheckResult | Self:
        """Store the participant's test stop and continue.

        A stop by the experimenter is accepted only if the participant's input profile contains it.
        """
        after_s = self.state.now_s - self._asked_s
        if by == "participant":
            self._measurement.add_stop(method or "page", after_s)
        elif "experimenter" in self.state.input.profile.stop_ways:
            self._measurement.add_stop("experimenter", after_s)
        else:
            return self._report(
                "the participant must test the stop; to continue without it, skip the headset check"
            )
        return self._ask_senses()

    def on_timeout(self) -> CheckFeedback | CheckResult:
        self._measurement.add_stop("none")
        return self._ask_senses()


class CheckFeedback(HeadsetCheckPhase):
    """The participant answers whether haptics and sound work."""

    name = "headset_check"
    message = Text("questionnaire")

    def __init__(self, state: SessionState, measurement: HeadsetMeasurement, asked: list[Item]) -> None:
        super().__init__(state, measurement)
        self._asked, self._answers = asked, dict[str, bool]()
        self._questions = Questions(translate(asked, state.plan.texts))
        self._next_s, self._ends_s = state.now_s + SIGNAL_INTERVAL_S, 0.0

    @property
    def question(self) -> messages.Question:
        return self._questions.question()

    def wait(self) -> Self:
        """Repeat haptics or sound until the answer."""
        now_s, buzzes = (
            self.state.now_s,
            len(self._answers) < len(self._asked) and self._is_current(HAPTICS_ITEM),
        )
        if now_s >= self._next_s:
            self._next_s, self._ends_s = now_s + SIGNAL_INTERVAL_S, now_s + SIGNAL_DURATION_S
            self.state.send(messages.Feedback(buzzes, buzzes, 0 if buzzes else 1))
        elif 0.0 < self._ends_s <= now_s:
            self._ends_s = 0.0
            self.state.send(messages.Feedback(left_touched=False, right_touched=False, events=0))
        return self

    def answer(self, answer: messages.Answer) -> CheckResult | Self:
        try:
            given = self._questions.take(answer)
        except ValueError as error:
            self.state.send(self.question)
            self._refuse("not_an_answer")
            return self._report(str(error))
        self._answers[given.item] = given.value == YES_ANSWER
        if self._questions.done:
            return CheckResult(self.state, self._measurement, self._answers)
        self.state.send(self.question)
        return self

    def _is_current(self, item: Item) -> bool:
        return self._asked[len(self._answers)] is item


class CheckResult(HeadsetCheckPhase):
    """Shows whether the headset passed the check. If not, shows what to do."""

    name = "headset"
    awaits_ready = True
    moves = False

    def __init__(
        self, state: SessionState, measurement: HeadsetMeasurement, answers: dict[str, bool]
    ) -> None:
        super().__init__(state, measurement)
        self._check = measurement.result(
            haptics=answers.get(HAPTICS_ITEM.id),
            sound=answers.get(SOUND_ITEM.id),
            used_arms=state.input.profile.used_arms,
        )
        self.message = result_message(self._check, MAX_FAULTS_SHOWN)

    def on_enter(self) -> None:
        self.state.headset = self._check
        self.state.sink.report(events.HeadsetChecked(self.state.now_s, self._check))

    def on_ready(self) -> CheckStart | phases.Calibration | phases.LoadCalibration:
        if not is_ready(self._check):
            return CheckStart(self.state)
        self.state.headset_checked = True
        return self._calibrate_again()
