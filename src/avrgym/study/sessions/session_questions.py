"""Questionnaires before and after a session, on the participant's page or in VR."""

from concurrent.futures import Future

from avrgym.questionnaires.stop_rules import STOP_ACTIONS, StopDecision
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage.state_transitions import StudyError
from avrgym.texts.interface_texts import ParticipantText
from avrgym.vr.protocol.messages import (
    PROTOCOL_VERSION,
    Answer,
    ExperimenterCommand,
    MessageSender,
    OfferedTargets,
    ParticipantReady,
    PhaseDescription,
    PreviousQuestionRequest,
    Problem,
    ReceivedMessage,
    Role,
    TargetSelectionRequest,
    Welcome,
)
from avrgym.vr.session.questions import QuestionSequence

QUESTION_TITLES = {
    "before_session": ParticipantText("questions_before"),
    "after_session": ParticipantText("questions_after"),
}
"""Text above the questions, by moment."""


class SessionQuestions:
    """Shows one item after another until all answers are stored and confirmed.

    The participant can go back. The experimenter can skip the remaining items or end the session. ``decision``: the
    strongest decision of the stop rules so far. The questionnaire continues after a decision.
    """

    def __init__(self, visit: StudyVisit, when: str, send: MessageSender) -> None:
        """Prepare the unanswered items.

        ``when``: moment, ``before_session`` or ``after_session``. ``send``: function that sends a message to all
        clients.
        """
        self.question_moment = when
        self._visit, self._send = visit, send
        self._questions = QuestionSequence(visit.find_unanswered_items(when))
        self.stop_decision: StopDecision | None = None
        self._over = self._ended = False
        self._given: Answer | None = None
        self._stored: Future[None] | None = None

    @property
    def is_done(self) -> bool:
        """Whether all questions are answered or skipped, or the session has ended."""
        return self._stored is None and (self._over or self.is_session_ended)

    @property
    def is_session_ended(self) -> bool:
        """Whether the experimenter, another process or a stop rule has ended the session."""
        by_rule = self._over and self.stop_decision is not None and self.stop_decision.action == "end"
        return self._ended or by_rule or self._visit.is_ended_elsewhere

    def show_first_item(self) -> None:
        """Show the first item."""
        self._send_item(self._send)

    def send_initial_state(self, send: MessageSender, role: Role) -> None:
        """Send the current item to a new client."""
        send(Welcome(PROTOCOL_VERSION, self._visit.session_name, role, haptics=False, sounds=False))
        send(self._visit.language_message)
        self._visit.participant_input.send_initial_state(send, role)
        self._send_item(send)

    def receive(self, message: ReceivedMessage) -> None:
        """Handle answers, commands and selections by the experimenter. Other messages are ignored."""
        if isinstance(message, OfferedTargets | TargetSelectionRequest):
            self._visit.participant_input.relay_selection(message, self._send)
        if self.is_done or self._stored is not None:
            return
        if isinstance(message, Answer):
            self._store_answer(message)
        elif isinstance(message, PreviousQuestionRequest):
            self._go_back()
        elif isinstance(message, ParticipantReady):
            self._over = self._questions.are_all_answered
        elif isinstance(message, ExperimenterCommand) and message.name in ("skip", "end"):
            self._skip_rest(ended=message.name == "end")

    def tick(self) -> None:
        """Continue when the last answer is stored. If the answer was invalid, show its item again."""
        if self._stored is None or not self._stored.done():
            return
        error, given = self._stored.exception(), self._given
        self._stored = self._given = None
        if isinstance(error, StudyError):
            self._over = self._ended = False
            self._repeat_item(str(error))
        elif error is not None:
            raise error
        elif given is not None:
            self._apply_stop_rules(given)
            self._continue(given)

    def _send_item(self, send: MessageSender) -> None:
        """Send the current item, or the request to confirm all answers."""
        name, text = (
            ("confirm", ParticipantText("confirm"))
            if self._questions.are_all_answered
            else ("questionnaire", QUESTION_TITLES[self.question_moment])
        )
        texts = self._visit.texts
        send(
            PhaseDescription(
                name,
                texts.format_for_vr(text),
                0,
                0,
                False,
                None,
                texts.format_for_page(text),
                texts.format_by_select_input(text),
            )
        )
        if not self._questions.are_all_answered:
            send(self._questions.make_current_question())

    def _continue(self, given: Answer) -> None:
        """Show the next item after a stored answer; after the last answer, request a confirmation."""
        self._questions.store_answer(given)
        if self._questions.are_all_answered:
            self._send_item(self._send)
        else:
            self._send(self._questions.make_current_question())

    def _go_back(self) -> None:
        confirming = self._questions.are_all_answered
        if not self._questions.go_back():
            self._explain("no_way_back")
        elif confirming:
            self._send_item(self._send)
        else:
            self._send(self._questions.make_current_question())

    def _apply_stop_rules(self, answer: Answer) -> None:
        """Apply the stop rules to an answer. A decision to end the session replaces a decision to pause it."""
        decision = self._visit.store.design.stop_rule_set.decide(answer.item, answer.value)
        if decision is None:
            return
        if self.stop_decision is None or STOP_ACTIONS.index(decision.action) >= STOP_ACTIONS.index(
            self.stop_decision.action
        ):
            self.stop_decision = decision
        self._visit.record_event("stop rule met", f"then {decision.action}, why {decision.reason}")
        before = f"the session {decision.action}s: " if self.question_moment == "before_session" else ""
        self._send(Problem(before + decision.reason, "experimenter"))

    def _store_answer(self, answer: Answer) -> None:
        """Store an answer; reject an invalid answer."""
        asked = None if self._questions.are_all_answered else self._questions.make_current_question()
        if asked is None:
            self._explain("no_question")
        elif answer.item != asked.item:
            self._repeat_item(f"the answer is to {answer.item!r}; expected: {asked.item}")
        elif answer.value == asked.previous_answer:
            self._continue(answer)
        else:
            self._given = answer
            store = self._visit.record_answer if asked.previous_answer is None else self._visit.change_answer
            self._stored = store(answer, self.question_moment)
            self.tick()

    def _skip_rest(self, *, ended: bool) -> None:
        """Skip the current item and all later items. ``ended``: the experimenter ended the session."""
        self._over, self._ended = True, ended
        if not self._questions.are_all_answered:
            what = f"questions {self.question_moment} left"
            self._stored = self._visit.record_event(what, self._questions.make_current_question().item)
            self.tick()

    def _repeat_item(self, why: str) -> None:
        self._explain("not_an_answer")
        self._send(Problem(why, "experimenter"))
        self._send_item(self._send)

    def _explain(self, key: str) -> None:
        texts, text = self._visit.texts, ParticipantText(key)
        self._send(
            Problem(
                texts.format_for_vr(text),
                "participant",
                texts.format_for_page(text),
                texts.format_by_select_input(text),
            )
        )
