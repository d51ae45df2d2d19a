"""What a design asks before or after a session: on the participant's page, or in VR if they are there already."""

from avrgym.study.live import StudyVisit
from avrgym.study.states import StudyError
from avrgym.vr.asking import Asking
from avrgym.vr.loop import Received
from avrgym.vr.messages import PROTOCOL, Answer, Command, Phase, Problem, Role, Welcome
from avrgym.vr.session import Send

WORDS = {
    "before_session": "Before the session, please answer a few questions.",
    "after_session": "Please answer a few last questions.",
}


class SessionQuestions:
    """Asks one item after another; each answer is stored at once.

    The experimenter may skip what is left, or end the session.
    """

    def __init__(self, visit: StudyVisit, when: str, send: Send) -> None:
        """Ask the items of a moment; ``send`` takes every message for the clients."""
        self.when = when
        self._visit, self._send = visit, send
        self._asking = Asking(visit.items(when))
        self._skipped = self._ended = False

    @property
    def done(self) -> bool:
        """Whether there is nothing more to ask."""
        return self._asking.done or self._skipped or self.ended

    @property
    def ended(self) -> bool:
        """Whether no trials follow, because the session was ended here or elsewhere."""
        return self._ended or self._visit.called_off

    def begin(self) -> None:
        """Ask the first item."""
        self._send(self._phase)
        self._send(self._asking.question())

    def greet(self, send: Send, role: Role) -> None:
        """Tell a client that has just connected what is asked."""
        send(Welcome(PROTOCOL, self._visit.identifier, role, haptics=False, sounds=False))
        send(self._phase)
        if not self._asking.done:
            send(self._asking.question())

    def receive(self, message: Received) -> None:
        """Take an answer of the participant or a command of the experimenter; nothing else counts now."""
        if self.done:
            return
        try:
            if isinstance(message, Answer):
                self._take(message)
            elif isinstance(message, Command) and message.name in ("skip", "end"):
                self._leave(ended=message.name == "end")
        except StudyError as error:
            self._send(Problem(message=str(error)))
            self._send(self._asking.question())

    @property
    def _phase(self) -> Phase:
        return Phase("questionnaire", WORDS[self.when], 0, 0, practice=False, seconds=None)

    def _take(self, answer: Answer) -> None:
        """Store an answer and ask the next item; what is none is refused."""
        asked = self._asking.question().item
        if answer.item != asked:
            raise StudyError(f"{answer.item!r} is not asked now; {asked} is")
        self._visit.record(answer.item, answer.value, answer.response_time_s, self.when)
        self._asking.take(answer)
        if not self._asking.done:
            self._send(self._asking.question())

    def _leave(self, *, ended: bool) -> None:
        """Leave what is asked now, and whatever would follow, unanswered."""
        self._skipped, self._ended = True, ended
        self._visit.tell(f"questions {self.when} left", self._asking.question().item)
