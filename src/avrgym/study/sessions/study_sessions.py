"""Run the sessions of a study's participants, one after another, in a real-time loop."""

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from queue import Empty, SimpleQueue

from avrgym.commands.respondents import CAREGIVER_RESPONDENT
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Person
from avrgym.recording.input_profile import InputProfile
from avrgym.study.people.furniture import read_own_furniture
from avrgym.study.sessions.session_questions import SessionQuestions
from avrgym.study.sessions.stored_session_links import make_session_link
from avrgym.study.sessions.study_visit import StudyVisit, has_unfinished_trials
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.settings import Settings
from avrgym.texts.interface_texts import InterfaceTexts, ParticipantText, read_texts
from avrgym.vr.protocol.messages import (
    PROTOCOL_VERSION,
    Language,
    MessageSender,
    PhaseDescription,
    PhaseName,
    Problem,
    ReceivedMessage,
    Role,
    Welcome,
)
from avrgym.vr.server.session_links import SessionLinks
from avrgym.vr.session.device_streams import DeviceStreams
from avrgym.vr.session.session import Session

MAX_CLIENTS = 64
"""Maximum number of connected clients that receive messages of the next session."""
ACTION_TIMEOUT_S = 60.0
"""Maximum time in seconds for an action of another thread."""

SESSION_END_RETRY_DELAY_S = 5.0
"""Delay in seconds before a failed write of a session's end is repeated."""

LoopAction = Callable[[float], Future[None] | None]
"""Function that runs in the thread of the real-time loop. If it returns a future, the action ends with the future."""


class StudySessions:
    """Runs the sessions of participants, one at a time.

    A session consists of questions, trials in VR, and further questions. The thread of the real-time loop calls
    ``tick``. Other threads may call ``begin_session``, ``withdraw_participant``, ``change_input_profile`` and
    ``renew_session_link``; these methods return when the action has ended.
    """

    def __init__(
        self,
        store: StudyStore,
        send: MessageSender,
        workers: Executor | None = None,
        *,
        first: str | None = None,
        first_link: str | None = None,
        take_over: bool = False,
        furniture: RealFurniture | None = None,
        storing: Executor | None = None,
        streams: DeviceStreams | None = None,
        headset_check: bool = False,
        links: SessionLinks | None = None,
        caregiver_links: SessionLinks | None = None,
    ) -> None:
        """Wait for a participant, or start the session of the participant ``first``.

        Args:
            store: the study.
            send: see ``Session``.
            workers: see ``Session``.
            first: pseudonym of the first participant.
            first_link: the link of the first session; default: a new one.
            take_over: see ``StudyVisit``; for the first session.
            furniture: the real seat and bed at this station; default: the design's.
            storing: see ``StudyVisit``.
            streams: see ``Session``.
            headset_check: see ``plan_session``.
            links: container for the participant's link to each session.
            caregiver_links: container for the caregiver's link, which is valid until the next session starts.

        Raises the errors of ``begin``.
        """
        self._store, self._send, self._workers, self._storing = store, send, workers, storing
        self._streams, self._headset_check = streams, headset_check
        self.participant_links = links or SessionLinks()
        self.caregiver_links = caregiver_links or SessionLinks()
        self.caregiver_session_id: int | None = None
        self._ended: Future[None] | None = None
        self._retry_at_s: float | None = None
        self._visit: StudyVisit | None = None
        self._questions: SessionQuestions | None = None
        self._session: Session | None = None
        self._scenes: list[tuple[str, Person, Settings]] = []
        self._clients: deque[tuple[MessageSender, Role]] = deque(maxlen=MAX_CLIENTS)
        self._actions: SimpleQueue[tuple[LoopAction, Future[None]]] = SimpleQueue()
        self._furniture = furniture or store.design.furniture
        if first is not None:
            self._begin(first, 0.0, link=first_link, take_over=take_over)

    @property
    def furniture(self) -> RealFurniture:
        """The real seat and bed for the next session."""
        return self._furniture

    @property
    def running_participant(self) -> str | None:
        """Pseudonym of the running session's participant; ``None`` without a session."""
        return self._visit.pseudonym if self._visit is not None else None

    def begin_session(self, pseudonym: str, furniture: RealFurniture | None = None) -> None:
        """Start a participant's session. ``furniture``: real seat and bed, for this and later sessions.

        Raises:
            StudyError: if another session is running, or if the participant cannot have a session.
            PolicyError: if a policy of the remaining trials is missing.
        """
        self._request(lambda now_s: self._begin(pseudonym, now_s, furniture))

    def withdraw_participant(self, pseudonym: str, reason: str) -> None:
        """Stop robot and recording of the running session, then store the withdrawal with its reason.

        Raises:
            StudyError: if the participant has no running session here.
        """
        self._request(lambda now_s: self._withdraw(pseudonym, reason, now_s))

    def change_input_profile(self, pseudonym: str, profile: InputProfile) -> None:
        """Change and store the input profile of the participant in the running session.

        Raises:
            StudyError: if the participant has no running session here.
        """
        self._request(lambda now_s: self._change_input(pseudonym, profile, now_s))

    def renew_session_link(self, pseudonym: str) -> None:
        """Create a new link for the running session. The earlier link becomes invalid.

        Raises:
            StudyError: if the participant has no running session here.
        """
        visit = self._visit
        if visit is None or visit.pseudonym != pseudonym:
            raise StudyError(f"no session of {pseudonym} is running at this station; start one first")
        link = make_session_link(
            self._store, visit.stored_session.id
        )  # in the calling thread, because the loop must not wait for the database
        self._request(lambda _: self._renew_link(visit, link))

    # Methods for the real-time loop

    @property
    def scenes(self) -> Sequence[tuple[str, Person, Settings]]:
        """Environment, person and settings of all scenes so far. Browsers cache scenes by index."""
        return self._scenes

    @property
    def is_at_rest(self) -> bool:
        """Whether the simulation does not move; true without a VR session."""
        return self._session is None or self._session.is_at_rest

    def send_initial_state(self, send: MessageSender, role: Role, now_s: float) -> None:
        """Send the current state to a new client, now and at the start of each later session."""
        self._clients.append((send, role))
        self._welcome(send, role, now_s)

    def receive(self, message: ReceivedMessage, now_s: float) -> None:
        """Pass a client's message to the current questions or to the VR session."""
        if self._questions is not None:
            self._questions.receive(message)
        elif self._session is not None:
            self._session.receive(message, now_s)

    def tick(self, now_s: float) -> None:
        """Run pending actions, then advance the session by 10 ms."""
        self._run_pending_actions(now_s)
        if self._ended is not None:
            self._await_end(self._ended, now_s)
        elif self._retry_at_s is not None:
            self._end_again(self._retry_at_s, now_s)
        elif self._questions is not None:
            self._continue_after(self._questions, now_s)
        elif self._session is not None:
            self._session.tick(now_s)
            if self._session.phase_name == "finished" and self._visit is not None:
                self._begin_last_questions(self._visit, now_s)

    def close(self, now_s: float) -> None:
        """End the running session, and reject pending actions."""
        try:
            if self._session is not None:
                self._session.close(now_s)
            self._end_link()
            if self._visit is not None:
                self._visit.close()
                self._visit = None
        finally:
            self._run_pending_actions(now_s)

    def _request(self, action: LoopAction) -> None:
        done: Future[None] = Future()
        self._actions.put((action, done))
        done.result(ACTION_TIMEOUT_S)

    def _run_pending_actions(self, now_s: float) -> None:
        while True:
            try:
                action, done = self._actions.get_nowait()
            except Empty:
                return
            try:
                stored = action(now_s)
            except Exception as error:  # the calling thread raises it
                done.set_exception(error)
            else:
                _forward_result(stored, done)

    def _begin(
        self,
        pseudonym: str,
        now_s: float,
        furniture: RealFurniture | None = None,
        link: str | None = None,
        take_over: bool = False,
    ) -> None:
        if self.running_participant is not None:
            raise StudyError(f"the session of {self.running_participant} is running; end it first")
        visit = StudyVisit(self._store, pseudonym, take_over=take_over, storing=self._storing)
        self._furniture = furniture or self._furniture
        try:
            session = self._in_vr(visit)
            own_link = make_session_link(self._store, visit.stored_session.id, link=link)
            self.participant_links.set_link_token(own_link, visit.language_message)
            self.caregiver_links.set_link_token(
                make_session_link(self._store, visit.stored_session.id, CAREGIVER_RESPONDENT),
                visit.language_message,
            )
            self.caregiver_session_id = visit.stored_session.id
        except BaseException:
            visit.close()
            raise
        self._session, self._visit = session, visit
        self._questions = self._questions_of(visit, "before_session" if self._session else "after_session")
        self._welcome_all(now_s)

    def _renew_link(self, visit: StudyVisit, link: str) -> None:
        if self._visit is not visit or self.participant_links.current_link_token is None:
            raise StudyError(f"no session of {visit.pseudonym} is running at this station; start one first")
        self.participant_links.set_link_token(link, visit.language_message)
        self._forget_participant()

    def _end_link(self) -> None:
        """Invalidate the session's link. Pages with this link cannot join the next session."""
        self.participant_links.expire_link()
        self._forget_participant()

    def _forget_participant(self) -> None:
        watching = [each for each in self._clients if each[1] != "participant"]
        self._clients = deque(watching, maxlen=MAX_CLIENTS)

    def _in_vr(self, visit: StudyVisit) -> Session | None:
        """Returns the session in VR; ``None`` if only questions after the session remain."""
        if visit.find_unanswered_items("after_session") and not has_unfinished_trials(
            self._store, visit.pseudonym
        ):
            return None
        own = read_own_furniture(self._store, visit.pseudonym)
        plan = visit.plan_remaining_trials(own or self._furniture, headset_check=self._headset_check)
        return visit.create_session(plan, self._send, self._workers, self._scenes, self._streams)

    def _questions_of(self, visit: StudyVisit, when: str) -> SessionQuestions | None:
        return SessionQuestions(visit, when, self._send) if visit.find_unanswered_items(when) else None

    def _welcome(self, send: MessageSender, role: Role, now_s: float) -> None:
        if self._questions is not None:
            self._questions.send_initial_state(send, role)
        elif self._session is not None:
            self._session.send_initial_state(send, role, now_s)
        else:
            send(Welcome(PROTOCOL_VERSION, "", role, haptics=False, sounds=False))
            texts = read_texts(self._store.design.languages[0], self._store.folder)
            send(Language(texts.language, texts.direction, dict(texts.page)))
            send(_phase("waiting", "waiting_session", texts))

    def _welcome_all(self, now_s: float) -> None:
        for send, role in self._clients:
            self._welcome(send, role, now_s)

    def _continue_after(self, questions: SessionQuestions, now_s: float) -> None:
        """Start the trials after the first questions, or end the session after the last questions."""
        questions.tick()
        if not questions.is_done:
            return
        self._questions = None
        if questions.question_moment == "before_session" and not questions.is_session_ended:
            if self._session is not None and questions.stop_decision is not None:
                self._session.prevent_trials(questions.stop_decision)
            self._welcome_all(now_s)
        else:
            self._session = None
            self._send_end()
            self._end_visit(now_s)

    def _send_end(self) -> None:
        if self._visit is not None:
            self._send(_phase("finished", "ended", self._visit.texts))

    def _begin_last_questions(self, visit: StudyVisit, now_s: float) -> None:
        """Start the questions after the trials."""
        self._questions = None if visit.is_ended_elsewhere else self._questions_of(visit, "after_session")
        if self._questions is None:
            self._end_visit(now_s)
        else:
            self._questions.show_first_item()

    def _withdraw(self, pseudonym: str, reason: str, now_s: float) -> Future[None]:
        if self._visit is None or self.running_participant != pseudonym:
            raise StudyError(f"no session of {pseudonym} is running at this station; start one first")
        stored = self._visit.withdraw_participant(self._session, now_s, reason)
        self.caregiver_links.expire_link()
        self._questions = None
        self._send_end()
        self._end_visit(now_s)
        return stored

    def _change_input(self, pseudonym: str, profile: InputProfile, now_s: float) -> Future[None]:
        if self._visit is None or self.running_participant != pseudonym:
            raise StudyError(f"no session of {pseudonym} is running at this station; start one first")
        stored = self._visit.change_input_profile(profile, self._session, now_s)
        self._send(self._visit.participant_input.make_profile_message())
        return stored

    def _end_visit(self, now_s: float) -> None:
        """Invalidate the participant's link, then store the end of the session."""
        self._end_link()
        if self._visit is not None:
            self._ended, self._retry_at_s = self._visit.end_session(), None
            self._await_end(self._ended, now_s)

    def _await_end(self, ended: Future[None], now_s: float) -> None:
        if not ended.done():
            return
        self._ended, error = None, ended.exception()
        if error is None:
            self._visit = None
        else:
            self._retry_at_s = now_s + SESSION_END_RETRY_DELAY_S
            self._send(
                Problem(
                    f"the end of the session cannot be stored: {error}; the server tries again every "
                    f"{SESSION_END_RETRY_DELAY_S:g} s",
                    "experimenter",
                )
            )

    def _end_again(self, due_s: float, now_s: float) -> None:
        if now_s >= due_s:
            self._end_visit(now_s)


def _forward_result(stored: Future[None] | None, done: Future[None]) -> None:
    """Complete ``done`` with the result or error of ``stored``; immediately, if ``stored`` is ``None``."""
    if stored is None:
        done.set_result(None)
    else:
        stored.add_done_callback(lambda each: _copy(each, done))


def _copy(stored: Future[None], done: Future[None]) -> None:
    error = stored.exception()
    if error is None:
        done.set_result(None)
    else:
        done.set_exception(error)


def _phase(name: PhaseName, key: str, texts: InterfaceTexts) -> PhaseDescription:
    """Returns the message about a phase that is not part of a trial."""
    text = ParticipantText(key)
    return PhaseDescription(
        name,
        texts.format_for_vr(text),
        0,
        0,
        False,
        None,
        texts.format_for_page(text),
        texts.format_by_select_input(text),
    )
