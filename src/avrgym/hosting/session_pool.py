"""Processes of the running sessions: start, monitoring, replacement after a crash, and end at the deadline."""

import secrets
import statistics
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Literal

from avrgym.hosting.capacity import WARM_UP_DURATION_S
from avrgym.hosting.computers import Computer, LocalComputer, SessionProcess
from avrgym.hosting.host_state import HostState, RunningSession
from avrgym.hosting.session_process import (
    MessageFromHost,
    MessageFromSession,
    MessageToParticipant,
    SessionCommand,
    SessionEnded,
    SessionReport,
    SessionRequest,
)
from avrgym.hosting.settings import HostSettings
from avrgym.hosting.waiting_list import WaitingList, estimate_wait_s
from avrgym.study.sessions.study_visit import has_unfinished_trials
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import ExperimenterCommandName
from avrgym.vr.server.session_links import generate_link_token

PROCESS_CHECK_INTERVAL_S = 0.2
"""Maximum time in seconds between two checks of all processes."""
WORKER_START_TIMEOUT_S = 120.0
MAX_CRASHES = 5
"""After this number of crashes, the process of a session is not replaced. The participant can start a new session."""
SESSION_END_TIMEOUT_S = 60.0
"""Time in seconds after the deadline for the questions after a session. Then the session's process ends."""
SESSION_ID_BYTES = 12
EXPECTED_ANSWER_DURATION_S = 10.0
"""Assumed time in seconds for an answer, used before any session was measured."""
EXPECTED_PREPARATION_TIME_S = 180.0
"""Assumed time in seconds for headset check and calibration, used before any session was measured."""

HostedSessionState = Literal["starting", "running", "ending"]


@dataclass
class HostedSession:
    """A running session.

    ``id``: part of the session's address. ``link_token``: the participant's token; it remains valid after a crash.
    ``report``: the latest report. ``absence_start_time_s``: time at which the participant disconnected.
    ``planned_end_time_s``: deadline of a session that the host or an experimenter ended. ``error``: error before the
    start.
    """

    id: str
    pseudonym: str
    link_token: str
    computer: Computer
    process: SessionProcess
    pipe: Connection
    start_time_s: float
    start_unix_time_s: float = field(default_factory=time.time)
    state: HostedSessionState = "starting"
    report: SessionReport = field(default_factory=lambda: SessionReport(0))
    crashes: int = 0
    process_start_time_s: float = 0.0
    absence_start_time_s: float | None = None
    planned_end_time_s: float | None = None
    error: str = ""

    @property
    def server_address(self) -> tuple[str, int] | None:
        """Address and port of the session's server; ``None`` while its process starts."""
        return (self.report.server_host, self.report.server_port) if self.report.server_port else None


@dataclass(frozen=True)
class WaitingListPlace:
    """A place on the waiting list. ``num_participants_ahead``: number of earlier participants. ``estimated_wait_s``:
    estimated waiting time.
    """

    num_participants_ahead: int
    estimated_wait_s: float


class SessionPool:
    """Context manager: the running sessions and the waiting list of a study. Thread-safe."""

    def __init__(
        self,
        store: StudyStore,
        settings: HostSettings,
        state: HostState,
        max_sessions: int | None = None,
        *,
        computers: Callable[[], Sequence[Computer]] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Create the pool without sessions.

        Args:
            store: the study.
            settings: time limits of sessions.
            state: stores sessions and waiting list.
            max_sessions: a limit of concurrent sessions, in addition to the measured capacity.
            computers: returns the available computers; default: only this computer.
            clock: returns the time in seconds.
        """
        self._store, self._settings, self._clock = store, settings, clock
        self._state, self._max_sessions = state, max_sessions
        this = LocalComputer()
        self._computers = computers or (lambda: [this])
        self._waiting = WaitingList()
        self._sessions: dict[str, HostedSession] = {}
        self._failed: dict[str, str] = {}
        self._durations_s: deque[float] = deque(maxlen=50)
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="sessions", daemon=True)

    def __enter__(self) -> "SessionPool":
        self._restore()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._thread.join()
        for session in self._sessions.values():
            session.pipe.close()  # each process then closes its session
        for session in self._sessions.values():
            session.process.join(SESSION_END_TIMEOUT_S)
            if session.process.is_alive():
                session.process.kill()

    # For the web applications -----------------------------------------------------------------------------------------

    @property
    def sessions(self) -> list[HostedSession]:
        """The running sessions in the order of their start."""
        with self._lock:
            return list(self._sessions.values())

    @property
    def max_concurrent_sessions(self) -> int:
        """Maximum number of concurrent sessions of all computers."""
        measured = sum(each.capacity.max_sessions for each in self._computers())
        return measured if self._max_sessions is None else min(measured, self._max_sessions)

    @property
    def session_cpu_load(self) -> float:
        """Highest estimated load of one session, as a share of one core."""
        return max((each.capacity.session_cpu_load for each in self._computers()), default=0.0)

    @property
    def missed_tick_fraction(self) -> float:
        """Share of missed ticks (0 to 1) of the sessions on the computer with the highest share."""
        return max((each.capacity.missed_tick_fraction for each in self._computers()), default=0.0)

    @property
    def num_waiting_participants(self) -> int:
        """Number of participants on the waiting list."""
        return len(self._waiting)

    def find_session(self, session_id: str) -> HostedSession | None:
        """Returns the session with this id; ``None`` for an unknown id."""
        return self._sessions.get(session_id)

    def find_participant_session(self, pseudonym: str) -> HostedSession | None:
        """Returns the running session of a participant; ``None`` without one."""
        with self._lock:
            return next((each for each in self._sessions.values() if each.pseudonym == pseudonym), None)

    def find_session_error(self, pseudonym: str) -> str:
        """Returns the error of the participant's latest session; empty if it did not fail."""
        return self._failed.get(pseudonym, "")

    def join_waiting_list(self, pseudonym: str) -> WaitingListPlace | None:
        """Add a participant to the waiting list, or confirm that a waiting participant is present.

        Returns the participant's place; ``None`` if a session of the participant is running.

        Raises:
            StudyError: if no trial remains.
        """
        asks_after = bool(self._store.design.list_items_at_moment("after_session"))
        is_complete = not asks_after and not has_unfinished_trials(self._store, pseudonym)
        with self._lock:
            if self.find_participant_session(pseudonym) is not None:
                return None
            if is_complete:
                raise StudyError(f"{pseudonym} has completed all trials; no session remains")
            self._failed.pop(pseudonym, None)
            self._waiting.join(pseudonym, self._clock())
            self._save()
            return self.find_waiting_list_place(pseudonym)

    def find_waiting_list_place(self, pseudonym: str) -> WaitingListPlace | None:
        """Returns the participant's place on the waiting list; ``None`` if the participant does not wait."""
        with self._lock:
            if pseudonym not in self._waiting:
                return None
            position, now_s = self._waiting.count_participants_ahead(pseudonym), self._clock()
            remaining = [self._remaining_s(each, now_s) for each in self._sessions.values()]
            return WaitingListPlace(
                position,
                estimate_wait_s(
                    position,
                    remaining,
                    self.estimated_session_duration_s,
                    max(self.max_concurrent_sessions, 1),
                ),
            )

    def leave_waiting_list(self, pseudonym: str) -> None:
        """Remove a participant from the waiting list."""
        with self._lock:
            self._waiting.leave(pseudonym)
            self._save()

    def send_command(self, session_id: str, name: ExperimenterCommandName) -> None:
        """Send a command to a session. Raises ``StudyError`` if no session with this id is running."""
        self._send(session_id, SessionCommand(name))

    def send_message(self, session_id: str, text: str) -> None:
        """Show a message on a participant's page. Raises ``StudyError`` if no session with this id is running."""
        self._send(session_id, MessageToParticipant(text))

    @property
    def estimated_session_duration_s(self) -> float:
        """Estimated duration of a session: median of the measured sessions; before, computed from the design."""
        if self._durations_s:
            return statistics.median(self._durations_s)
        design = self._store.design
        trial_s = 0.1 * design.trial_steps + 2.0 * design.free_movement_s
        items_s = EXPECTED_ANSWER_DURATION_S * len(design.list_items_at_moment("after_trial"))
        trials = len(design.tasks) * len(design.robot_policy_pairs)
        practice_s = len(design.tasks) * trial_s if design.practice_policy else 0.0
        planned_s = EXPECTED_PREPARATION_TIME_S + practice_s + trials * (trial_s + items_s)
        return min(planned_s, 60.0 * self._settings.session_minutes)

    # The stored state -------------------------------------------------------------------------------------------------

    def _restore(self) -> None:
        """Continue with the waiting list and the sessions of the host's previous process."""
        now_s, now_at_s = self._clock(), time.time()
        allocated = {each.pseudonym for each in self._store.read_participants() if each.state == "allocated"}
        self._waiting.restore([each for each in self._state.waiting_pseudonyms if each in allocated], now_s)
        for each in self._state.sessions:
            age_s = now_at_s - each.began_at_s
            computer = self._choose(self._computers())
            if each.pseudonym in allocated and age_s < 60.0 * self._settings.session_minutes and computer:
                process, pipe = computer.start_session(self._request(each.pseudonym, each.link))
                self._sessions[each.id] = HostedSession(
                    each.id,
                    each.pseudonym,
                    each.link,
                    computer,
                    process,
                    pipe,
                    now_s - age_s,
                    each.began_at_s,
                    crashes=each.crashes,
                    process_start_time_s=now_s,
                )

    def _save(self) -> None:
        """Store the waiting list and the sessions, if they have changed."""
        running = (
            RunningSession(each.id, each.pseudonym, each.link_token, each.start_unix_time_s, each.crashes)
            for each in self._sessions.values()
        )
        self._state.store_sessions(self._waiting.pseudonyms, tuple(running))

    # The thread -------------------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        while not self._closed.is_set():
            with self._lock:
                pipes = [each.pipe for each in self._sessions.values() if not each.pipe.closed]
            if pipes:  # the pipe of an ended process is ready, too
                wait(pipes, PROCESS_CHECK_INTERVAL_S)
                time.sleep(PROCESS_CHECK_INTERVAL_S / 4.0)  # several reports arrive together
            else:
                self._closed.wait(PROCESS_CHECK_INTERVAL_S)
            with self._lock:
                self._step(self._clock())

    def _step(self, now_s: float) -> None:
        for session in list(self._sessions.values()):
            ended = self._receive(session)
            if ended or not session.process.is_alive():
                self._receive(session)
                self._finish(session, now_s, ended=ended or session.state == "ending")
            else:
                self._enforce_times(session, now_s)
        self._waiting.remove_absent(now_s)
        self._admit(now_s)
        with suppress(OSError):  # the disk is full; later changes are stored
            self._save()

    def _receive(self, session: HostedSession) -> bool:
        """Read all messages of a session. Returns whether the session has ended without a crash."""
        with suppress(EOFError, OSError):
            while session.pipe.poll():
                received: MessageFromSession = session.pipe.recv()
                match received:
                    case SessionEnded():
                        return True
                    case SessionReport():
                        session.report = received
                        session.state = "running" if session.state == "starting" else session.state
                        session.computer.capacity.add_session_report(
                            session.id,
                            received.elapsed_s,
                            received.cpu_load,
                            received.missed_ticks,
                            in_trial=received.phase == "trial",
                            idle_cores=received.idle_cores,
                        )
                    case str():
                        session.error = received
        return False

    def _finish(self, session: HostedSession, now_s: float, *, ended: bool) -> None:
        """Remove an ended session. Replace the process of a crashed session."""
        session.pipe.close()
        session.computer.capacity.remove_session(session.id)
        if not ended:
            session.crashes += 1
            computers = self._computers()
            others = [each for each in computers if each is not session.computer]
            computer = self._choose(others or computers)  # the session's computer may have failed
            if session.crashes < MAX_CRASHES and not session.error and computer:
                self._replace_process(session, computer, now_s)
                return
            self._failed[session.pseudonym] = session.error or "the session has failed"
        else:
            self._durations_s.append(now_s - session.start_time_s)
        session.process.join(PROCESS_CHECK_INTERVAL_S)
        del self._sessions[session.id]

    def _enforce_times(self, session: HostedSession, now_s: float) -> None:
        if session.state == "starting":
            if now_s - session.process_start_time_s > WORKER_START_TIMEOUT_S:
                session.process.kill()
            return
        is_present = session.report.is_connected
        session.absence_start_time_s = None if is_present else session.absence_start_time_s or now_s
        absent_s = 0.0 if session.absence_start_time_s is None else now_s - session.absence_start_time_s
        if session.planned_end_time_s is not None:
            if now_s > session.planned_end_time_s + SESSION_END_TIMEOUT_S:
                session.process.kill()
            elif now_s > session.planned_end_time_s:
                session.pipe.close()  # the process then closes the session
        elif now_s - session.start_time_s > 60.0 * self._settings.session_minutes:
            self._end(session, now_s + SESSION_END_TIMEOUT_S)
        elif absent_s > 60.0 * self._settings.absence_minutes:
            self._end(session, now_s)

    def _end(self, session: HostedSession, ends_at_s: float) -> None:
        session.state, session.planned_end_time_s = "ending", ends_at_s
        with suppress(OSError):
            session.pipe.send(SessionCommand("end"))

    def _admit(self, now_s: float) -> None:
        """Start the session of the first waiting participant, if the capacity permits. One session starts at a time."""
        pseudonym = self._waiting.find_next_present()
        limit = self._max_sessions
        if pseudonym is None or (limit is not None and len(self._sessions) >= limit):
            return
        computer = self._choose([each for each in self._computers() if self._admits(each, now_s)])
        if computer is None:
            return
        self._waiting.leave(pseudonym)
        session_id, link = secrets.token_hex(SESSION_ID_BYTES), generate_link_token()
        process, pipe = computer.start_session(self._request(pseudonym, link))
        self._sessions[session_id] = HostedSession(
            session_id, pseudonym, link, computer, process, pipe, now_s, process_start_time_s=now_s
        )

    def _admits(self, computer: Computer, now_s: float) -> bool:
        """Returns whether another session can start on a computer. On each computer, one session starts at a time."""
        own = [each for each in self._sessions.values() if each.computer is computer]
        young = sum(now_s - each.process_start_time_s < WARM_UP_DURATION_S for each in own)
        is_starting = any(each.state == "starting" for each in own)
        return not is_starting and computer.capacity.can_start_session(len(own), young)

    def _choose(self, computers: Sequence[Computer]) -> Computer | None:
        """Returns the computer with the most free places; ``None`` without a computer."""
        used = Counter(id(each.computer) for each in self._sessions.values())
        return max(computers, key=lambda each: each.capacity.max_sessions - used[id(each)], default=None)

    def _replace_process(self, session: HostedSession, computer: Computer, now_s: float) -> None:
        session.state, session.report = "starting", SessionReport(0)
        session.process, session.pipe = computer.start_session(
            self._request(session.pseudonym, session.link_token)
        )
        session.computer, session.process_start_time_s, session.absence_start_time_s = computer, now_s, None

    def _request(self, pseudonym: str, link: str) -> SessionRequest:
        return SessionRequest(self._store.folder, pseudonym, link, self._settings.headset_check)

    def _send(self, session_id: str, command: MessageFromHost) -> None:
        with self._lock:
            session = self.find_session(session_id)
            if session is None or session.state == "starting":
                raise StudyError(
                    f"session {session_id} is not running; reload the page to see the running sessions"
                )
            with suppress(OSError):
                session.pipe.send(command)

    def _remaining_s(self, session: HostedSession, now_s: float) -> float:
        """Returns the estimated remaining time of a session (s), from its progress."""
        elapsed_s, report = now_s - session.start_time_s, session.report
        left = max(report.trials - report.trial + 1, 0) / report.trials if report.trials else 1.0
        by_trials = self.estimated_session_duration_s * left
        deadline_s = 60.0 * self._settings.session_minutes + SESSION_END_TIMEOUT_S - elapsed_s
        return min(by_trials, max(deadline_s, 0.0))
