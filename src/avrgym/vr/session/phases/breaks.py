"""Breaks between trials, and the questions after a break."""

from __future__ import annotations

from typing import Self

from avrgym.recording.schema import Answer
from avrgym.texts.interface_texts import ParticipantText
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.phases.base_phases import BetweenTrialsPhase, QuestionnairePhase
from avrgym.vr.session.questions import QuestionSequence
from avrgym.vr.session.session_state import SessionState


class Break(BetweenTrialsPhase):
    """The participant takes a break, with or without the headset. The trigger ends the break."""

    name = "break"
    message = ParticipantText("take_break")

    def on_enter(self) -> None:
        self.state.headset_time.begin_break()
        self.state.event_sink.report(events.BreakBegun(self.state.now_s))

    def on_ready(self) -> phases.PhaseAtTrialStart:
        self.state.headset_time.end_break()
        self.state.event_sink.report(events.BreakEnded(self.state.now_s))
        return self._begin_trial()

    def request_break(self, by: events.Initiator) -> Self:
        return self

    @property
    def can_change_preferences(self) -> bool:
        """Returns false: the participant may change preferences only after the break."""
        return False


class BreakQuestionnaire(QuestionnairePhase):
    """The participant answers the questions after a break. All answers are stored after the last answer."""

    name = "questionnaire"
    message = ParticipantText("questionnaire")

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self._questions = QuestionSequence(state.plan.break_items)
        self._given: dict[str, Answer] = {}

    def answer(self, answer: messages.Answer) -> phases.PhaseAtTrialStart | Self:
        """Store the answer to the current question. The last answer ends the questionnaire."""
        state, given = self.state, self._take(answer)
        if given is None:
            return self
        self._given[given.item] = given
        if not self._questions.are_all_answered:
            state.send(self.question)
            return self
        for each in self._given.values():
            state.event_sink.report(events.AnsweredAfterBreak(state.now_s, each))
            self._apply_stop_rules(each)
        state.headset_time.are_break_questions_due = False
        return self._begin_trial()

    def skip(self) -> phases.PhaseAtTrialStart:
        """Continue with the next trial. The answers are not stored."""
        self.state.headset_time.are_break_questions_due = False
        return self._begin_trial()
