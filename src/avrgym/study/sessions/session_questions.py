"""What a design asks before or after a session: on the participant's page, or in VR if they are there already."""

from concurrent.futures import Future

from avrgym.recording.stop_rules import THEN, Verdict
from avrgym.study.sessions.live import StudyVisit
from avrgym.study.storage.states import StudyError
from avrgym.vr.protocol.messages import PROTOCOL, Answer, Command, Phase, Problem, Role, Send, Welcome
from avrgym.vr.protocol.received import Received
from avrgym.vr.session.questions import Questions

WORDS = {
    "before_session": "Before the session, please answer a few questions.",
    "after_session": "Please answer a few last questions.",
}


class SessionQuestions:
    """Asks one item after another, each when the answer before it is stored.

    The experimenter may skip what is left, or end the session. ``verdict`` is what the study's stop rules say to the
    answers so far; what is asked is asked to its end.
    """

    def __init__(self, visit: StudyVisit, when: str, send: Send) -> None:
        """Ask the items of a moment; ``send`` takes every message for the clients."""
        self.when = when
        self._visit, self._send = visit, send
        self._questions = Questions(visit.items(when))
        self.verdict: Verdict | None = None
        self._skipped = self._ended = False
        self._given: Answer | None = None
        self._stored: Future[None] | None = None

    @property
    def done(self) -> bool:
        """Whether there is nothing more to ask."""
        return self._stored is None and (self._questions.done or self._skipped or self.ended)

    @property
    def ended(self) -> bool:
        """Whether no trials follow, because the session was ended here or elsewhere, or by a stop rule."""
        by_rule = (
            self.verdict is not None
            and self.verdict.then == "end"
            and (self._questions.done or self._skipped)
        )
        return self._ended or by_rule or self._visit.called_off

    def begin(self) -> None:
        """Ask the first item."""
        self._send(self._phase)
        self._send(self._questions.question())

    def greet(self, send: Send, role: Role) -> None:
        """Tell a client that has just connected what is asked."""
        send(Welcome(PROTOCOL, self._visit.identifier, role, haptics=False, sounds=False))
        send(self._phase)
        if not self._questions.done:
            send(self._questions.question())

    def receive(self, message: Received) -> None:
        """Take an answer of the participant or a command of the experimenter; nothing else counts now."""
        if self.done or self._stored is not None:
            return
        if isinstance(message, Answer):
            self._take(message)
        elif isinstance(message, Command) and message.name in ("skip", "end"):
            self._leave(ended=message.name == "end")

    def tick(self) -> None:
        """Go on when what was given is stored; what cannot be is asked again."""
        if self._stored is None or not self._stored.done():
            return
        error, given = self._stored.exception(), self._given
        self._stored = self._given = None
        if isinstance(error, StudyError):
            self._skipped = self._ended = False
            self._ask_again(str(error))
        elif error is not None:
            raise error
        elif given is not None:
            self._questions.take(given)
            self._heed(given)
            if not self._questions.done:
                self._send(self._questions.question())

    def _heed(self, answer: Answer) -> None:
        """Keep and tell what the stop rules say to an answer; an end is stronger than a pause."""
        verdict = self._visit.store.design.rules.verdict(answer)
        if verdict is None:
            return
        if self.verdict is None or THEN.index(verdict.then) >= THEN.index(self.verdict.then):
            self.verdict = verdict
        self._visit.tell("stop rule met", f"then {verdict.then}, why {verdict.why}")
        before = f"the session {verdict.then}s: " if self.when == "before_session" else ""
        self._send(Problem(before + verdict.why, "experimenter"))

    @property
    def _phase(self) -> Phase:
        return Phase("questionnaire", WORDS[self.when], 0, 0, practice=False, seconds=None)

    def _take(self, answer: Answer) -> None:
        """Store an answer; what is none is refused."""
        asked = self._questions.question().item
        if answer.item != asked:
            self._ask_again(f"{answer.item!r} is not asked now; {asked} is")
            return
        self._given = answer
        self._stored = self._visit.record(answer, self.when)
        self.tick()

    def _leave(self, *, ended: bool) -> None:
        """Leave what is asked now, and whatever would follow, unanswered."""
        self._skipped, self._ended = True, ended
        self._stored = self._visit.tell(f"questions {self.when} left", self._questions.question().item)
        self.tick()

    def _ask_again(self, why: str) -> None:
        self._send(Problem(message=why))
        self._send(self._questions.question())
