"""A participant's session in a separate process, with the server of ``avrgym serve``.

The process listens on a free port. Once a second, it reports its state to the host through a pipe. It receives
commands through the same pipe. It ends after the session, or when the host closes the pipe.
"""

import signal
import time
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path

from avrgym.hosting.capacity import IdleCoreMonitor
from avrgym.study.dashboard.study_tokens import StudyTokens
from avrgym.study.people.experimenters import ExperimenterTokens
from avrgym.study.sessions.session_threads import StorageThread
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.storage.database_rows import parse_participant_number
from avrgym.study.storage.identity_file import IDENTITY_FOLDER as PRIVATE
from avrgym.study.storage.remote_recordings import read_object_store_error
from avrgym.study.storage.sessions import record_session_event
from avrgym.study.storage.store import StudyStore
from avrgym.system.locks import lock_number_in_file
from avrgym.vr.protocol.messages import (
    ExperimenterCommand,
    ExperimenterCommandName,
    Message,
    PhaseDescription,
    Problem,
    SessionStatus,
    TickTiming,
)
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.session_links import SessionLinks
from avrgym.vr.server.sound_files import SOUNDS_FOLDER

REPORT_INTERVAL_S = 1.0
POLL_INTERVAL_S = 0.1
SESSION_LOCK_FILE = "sessions.lock"
"""File in the study's private folder. The process of a session locks its participant's number in it."""
EARLIER_PROCESS_TIMEOUT_S = 60.0
"""Maximum time in seconds to wait for the end of an earlier process of the same session after a crash of the host."""


@dataclass(frozen=True)
class SessionRequest:
    """Request to run a session. ``link_token``: the token of the participant's page.

    ``study_folder``: the study's folder. ``headset_check``: start with a headset check. ``listen_address``: address
    to listen on. ``is_temporary``: the folder is a temporary copy, see ``StudyStore``.
    """

    study_folder: Path
    pseudonym: str
    link_token: str
    headset_check: bool = True
    listen_address: str = "127.0.0.1"
    is_temporary: bool = False


@dataclass(frozen=True)
class SessionReport:
    """The state of a running session.

    ``server_port`` and ``server_host``: port and address of the session's server. ``trial`` and ``trials``: number of
    the current trial, and number of all trials. ``elapsed_s``: time since the start. ``cpu_load``: load in the last
    second, as a share of one core. ``missed_ticks``: number of missed ticks since the start. ``median_tick_ms``:
    median duration of a tick. ``latency_ms``: median latency from tracking to display, if known.
    ``untracked_fraction``: share of the time in trials without tracking of a required body part. ``latest_error``:
    latest error message to the experimenter.
    ``idle_cores``: number of idle cores of the computer, if known.
    """

    server_port: int
    phase: str = "starting"
    trial: int = 0
    trials: int = 0
    is_connected: bool = False
    is_paused: bool = False
    elapsed_s: float = 0.0
    cpu_load: float = 0.0
    missed_ticks: int = 0
    median_tick_ms: float = 0.0
    latency_ms: float | None = None
    untracked_fraction: float = 0.0
    latest_error: str = ""
    server_host: str = "127.0.0.1"
    idle_cores: float | None = None


@dataclass(frozen=True)
class SessionEnded:
    """Message to the host: the session has ended, and its end is stored."""


@dataclass(frozen=True)
class SessionCommand:
    """Message to the session: a command of an experimenter or of the host."""

    name: ExperimenterCommandName


@dataclass(frozen=True)
class MessageToParticipant:
    """Message to the session: a text to show on the participant's page."""

    text: str


MessageFromHost = SessionCommand | MessageToParticipant
MessageFromSession = SessionReport | SessionEnded | str
"""Messages to the host. A text is the error that prevented the start of the session."""


class ReportCollector:
    """Collects the state of a session from its messages to clients. ``latest_report``: the latest state."""

    def __init__(self) -> None:
        self.latest_report = SessionReport(0)
        self._statuses = self._untracked = 0

    def wrap_send_function(self, send: Callable[[Message], None]) -> Callable[[Message], None]:
        """Returns a function that collects the contents of a message, then calls ``send`` with it."""

        def observed(message: Message) -> None:
            self._collect(message)
            send(message)

        return observed

    def _collect(self, message: Message) -> None:
        match message:
            case PhaseDescription():
                self.latest_report = replace(
                    self.latest_report, phase=message.name, trial=message.trial, trials=message.trials
                )
            case TickTiming():
                self.latest_report = replace(
                    self.latest_report,
                    missed_ticks=message.missed_ticks,
                    median_tick_ms=message.tick_ms_median,
                )
            case SessionStatus():
                self._collect_status(message)
            case Problem(role="experimenter"):
                self.latest_report = replace(self.latest_report, latest_error=message.message)
            case _:
                pass

    def _collect_status(self, status: SessionStatus) -> None:
        if status.phase == "trial":
            self._statuses += 1
            self._untracked += any(part in status.needed_parts for part in status.untracked_parts)
        total = next((each.p50 for each in status.latency if each.stage == "total_ms"), None)
        share = self._untracked / self._statuses if self._statuses else 0.0
        self.latest_report = replace(
            self.latest_report, is_paused=status.paused, latency_ms=total, untracked_fraction=share
        )


def run_session(request: SessionRequest, pipe: Connection) -> None:
    """Run a session until its end. An error before the start is sent to the host as text."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the host receives the signals of the terminal
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    collector, links = ReportCollector(), SessionLinks()
    try:
        with (
            lock_number_in_file(
                request.study_folder / PRIVATE / SESSION_LOCK_FILE,
                parse_participant_number(request.pseudonym),
                EARLIER_PROCESS_TIMEOUT_S,
            ),
            StudyStore(request.study_folder, temporary=request.is_temporary) as store,
            ThreadPoolExecutor(1) as workers,
            StorageThread() as storing,
            ExperimenterTokens(store) as experimenters,
            LiveServer(
                lambda send: StudySessions(
                    store,
                    collector.wrap_send_function(send),
                    workers,
                    first=request.pseudonym,
                    first_link=request.link_token,
                    take_over=True,  # the lock was free: no other process of the host runs this session
                    storing=storing,
                    headset_check=request.headset_check,
                    links=links,
                ),
                request.listen_address,
                0,
                behind_proxy=True,  # the host's tunnel
                tokens=StudyTokens.load_for_study(
                    request.study_folder / PRIVATE / "tokens.json", experimenters, links
                ),
                sounds=request.study_folder / SOUNDS_FOLDER,
                links=links,
            ) as server,
        ):
            _watch(server, store, collector, pipe, storing)
    except (RuntimeError, ValueError, OSError) as error:
        with suppress(BrokenPipeError):
            pipe.send(str(error))
        raise SystemExit(1) from None


def _watch(
    server: LiveServer[StudySessions],
    store: StudyStore,
    collector: ReportCollector,
    pipe: Connection,
    storing: Executor,
) -> None:
    """Report the session's state and execute commands, until the session or the host has ended."""
    began_s = reported_s = time.monotonic()
    used_s = time.process_time()
    idle_cores = IdleCoreMonitor()
    pipe.send(replace(collector.latest_report, server_port=server.port, server_host=server.host))
    session_id = store.read_sessions(server.session.running_participant or "")[-1].id
    while server.loop.error is None:
        if pipe.poll(POLL_INTERVAL_S):
            try:
                command: MessageFromHost = pipe.recv()
            except (EOFError, ConnectionError):
                return
            _execute(
                command,
                server,
                lambda name, detail: storing.submit(record_session_event, store, session_id, name, detail),
            )
        if server.session.running_participant is None:
            pipe.send(SessionEnded())
            return
        now_s = time.monotonic()
        if now_s - reported_s >= REPORT_INTERVAL_S:
            before_s, used_s = used_s, time.process_time()
            pipe.send(
                replace(
                    collector.latest_report,
                    server_port=server.port,
                    server_host=server.host,
                    idle_cores=idle_cores.measure(),
                    latest_error=collector.latest_report.latest_error or read_object_store_error(store),
                    is_connected=server.has_participant,
                    elapsed_s=now_s - began_s,
                    cpu_load=(used_s - before_s) / (now_s - reported_s),
                )
            )
            reported_s = now_s


def _execute(
    command: MessageFromHost, server: LiveServer[StudySessions], record: Callable[[str, str], object]
) -> None:
    match command:
        case SessionCommand():
            server.loop.post(ExperimenterCommand(name=command.name))
        case MessageToParticipant():
            server.send(Problem(command.text, "participant"))
            record("message to participant", command.text)
