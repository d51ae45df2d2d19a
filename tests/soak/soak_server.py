"""Load tests of the server: `make soak`. Each test prints its measurements."""

import os
import random
import resource
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import pairwise
from pathlib import Path

import httpx
import msgspec
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from avrgym.recording.reader import read_recording
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    Hello,
    Message,
    ParticipantReady,
    PhaseDescription,
    Problem,
    Scene,
    SceneLoaded,
    TickTiming,
    VrEntered,
    Welcome,
    WorldStateChange,
)
from avrgym.vr.protocol.state_encoding import StateDecoder
from avrgym.vr.server.certificate import load_or_create_certificate
from avrgym.vr.server.connection import MAX_MESSAGES_PER_S
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.session import Session
from helpers.system.processes import kill_with_parent
from helpers.vr.raw_clients import TIMEOUT_S, exchange, is_closed, request, status
from helpers.vr.received_states import decode_message
from helpers.vr.visit import constant_policies, plan

CONNECTIONS, HANDSHAKES, MESSAGES = 2_000, 300, 200_000
OWN_MESSAGES = 2_000
"""Maximum number of a participant's messages in a trial, in addition to frames."""
FILE_HANDLES = 1_024
TRIAL_STEPS = 400
FAR_M = 1000.0
"""Distance beyond which non-finite positions are reported."""
FLOOD = """
import resource, socket, sys, time
resource.setrlimit(resource.RLIMIT_NOFILE, (4096, 4096))
port, count = int(sys.argv[1]), int(sys.argv[2])
held = []
for number in range(count):
    held.append(socket.create_connection(("127.0.0.1", port), 30))
    if number % 100 == 99:
        time.sleep(0.05)
print("open", flush=True)
time.sleep(1000)
"""


@pytest.fixture
def few_handles() -> Iterator[None]:
    """Limit the file handles to the default of a process."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (FILE_HANDLES, hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@contextmanager
def flooded(port: int, count: int) -> Iterator[None]:
    """Keep idle connections of another process open."""
    command = [sys.executable, "-c", FLOOD, str(port), str(count)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, preexec_fn=kill_with_parent) as flood:
        try:
            assert flood.stdout is not None
            assert flood.stdout.readline() == b"open\n"
            yield
        finally:
            flood.kill()


class Attendant:
    """A simulated participant with a real socket: calibration, a trial with 50 Hz tracking, and answers."""

    def __init__(self, server: LiveServer[Session], opened: ExitStack) -> None:
        self.person = SimulatedParticipant(sample_participant_traits("woman", 2), 2)
        self.inbox: Counter[type] = Counter()
        self.phase, self.finite, self.ended = "", True, False
        self._states = StateDecoder()
        self._socket = connect_client(server, "/ws", server.tokens.participant, opened)
        self._sending = threading.Lock()
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._listen, self._move)]
        self.send(VrEntered())
        for thread in self._threads:
            thread.start()

    def send(self, message: Message | bytes) -> None:
        """Send a message or raw bytes."""
        with self._sending:
            self._socket.send(message if isinstance(message, bytes) else messages.encode_message(message))

    def _listen(self) -> None:
        try:
            for data in self._socket:
                self._take(decode_message(self._socket, data))
        except ConnectionClosed:
            self.ended = True

    def _take(self, message: Message) -> None:
        self.inbox[type(message)] += 1
        if isinstance(message, Scene):
            self._states.reset()
            self.send(SceneLoaded(url=message.url))
        elif isinstance(message, PhaseDescription):
            self.phase = message.name
        elif isinstance(message, WorldStateChange):
            poses = np.frombuffer(self._states.decode(message).poses, "<f4")
            self.finite &= bool((np.abs(poses) < FAR_M).all())
        elif isinstance(message, messages.Question):
            self.send(messages.Answer(message.item, 4, 1.0))

    def _move(self) -> None:
        began, pressed = time.monotonic(), 0.0
        while not self.ended:
            now_s = time.monotonic() - began
            try:
                self.send(
                    self.person.make_tracking_frame(
                        now_s, moving=self.phase not in ("", "waiting", "calibration")
                    )
                )
                if self.phase in ("calibration", "check", "paused") and now_s > pressed + 1.5:
                    pressed = now_s
                    self.send(ParticipantReady())
            except ConnectionClosed:
                return
            time.sleep(0.02)


def connect_client(server: LiveServer[Session], path: str, token: str, opened: ExitStack) -> ClientConnection:
    """Open a socket and complete the hello and welcome messages."""
    url = f"ws://127.0.0.1:{server.port}{path}"
    socket_ = opened.enter_context(connect(url, max_size=None, max_queue=None))
    socket_.send(messages.encode_message(Hello(messages.PROTOCOL_VERSION, token, "soak", emulated=True)))
    data = socket_.recv(TIMEOUT_S)
    assert isinstance(data, bytes)
    assert isinstance(messages.decode_server_message(data), Welcome)
    return socket_


class Watcher:
    """Reads the messages to a watcher."""

    def __init__(self, connection: ClientConnection) -> None:
        self.inbox: Counter[type] = Counter()
        self.missed: list[int] = []
        self.states_s: list[float] = []
        self.closed = False
        self._connection = connection
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        try:
            for data in self._connection:
                message = decode_message(self._connection, data)
                self.inbox[type(message)] += 1
                if isinstance(message, WorldStateChange):
                    self.states_s.append(time.monotonic())
                elif isinstance(message, TickTiming):
                    self.missed.append(message.missed_ticks)
        except ConnectionClosed:
            self.closed = True


def wait_until(condition: Callable[[], bool], timeout_s: float = 180.0) -> None:
    discard_attempt = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < discard_attempt
        time.sleep(0.02)


def make_server(folder: Path, **options) -> LiveServer[Session]:
    trial = plan(free_movement_s=0.5, trial_steps=TRIAL_STEPS)
    return LiveServer(
        lambda send: Session(trial, constant_policies(trial), folder, send, "soak"), "127.0.0.1", 0, **options
    )


def memory_bytes() -> int:
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def test_intervals_of_states_and_response_times(tmp_path: Path) -> None:
    """Measures the intervals of a watcher's states, and response times on a persistent connection."""
    with make_server(tmp_path) as server, ExitStack() as opened:
        watcher = Watcher(connect_client(server, "/watch", server.tokens.spectator, opened))
        with httpx.Client(base_url=f"http://127.0.0.1:{server.port}", timeout=TIMEOUT_S) as client:
            took_ms = []
            for _ in range(100):
                began = time.perf_counter()
                assert client.get("/favicon.svg").status_code == 200
                took_ms.append(1000.0 * (time.perf_counter() - began))
        wait_until(lambda: len(watcher.states_s) > 400)
    apart_ms = [1000.0 * (after - before) for before, after in pairwise(watcher.states_s)]
    print(
        f"\na GET on a kept connection: {percentiles(took_ms)} ms; states: {percentiles(apart_ms)} ms apart"
    )


def percentiles(values: list[float]) -> str:
    return " / ".join(f"{value:.1f}" for value in np.percentile(values, [5, 50, 95]))


def test_2000_connections_while_a_trial_runs(tmp_path: Path, few_handles: None) -> None:
    """The clients get all responses, and the connections cause no additional dropped ticks."""
    with make_server(tmp_path) as server, ExitStack() as opened:
        watching = {
            role: Watcher(connect_client(server, "/watch", getattr(server.tokens, role), opened))
            for role in ("experimenter", "spectator")
        }
        attendant = Attendant(server, opened)
        wait_until(lambda: attendant.phase == "trial")
        time.sleep(3.0)
        missed_before = server.loop.missed_ticks
        began = time.monotonic()
        with flooded(server.port, CONNECTIONS):
            flooded_s = time.monotonic() - began
            missed = server.loop.missed_ticks - missed_before
            served = Counter[int]()
            for role in ("participant", "experimenter", "spectator"):
                token = {"authorization": f"Bearer {getattr(server.tokens, role)}"}
                for path in ("/", "/spectator", "/favicon.svg", "/scenes/0.glb"):
                    url = f"http://127.0.0.1:{server.port}{path}"
                    served[httpx.get(url, headers=token, timeout=TIMEOUT_S).status_code] += 1
            held = len(os.listdir("/proc/self/fd"))
            connect_client(server, "/watch", server.tokens.experimenter, opened).close()
            wait_until(lambda: attendant.phase == "finished")
        assert not attendant.ended
        assert not any(watcher.closed for watcher in watching.values())
        outcome = read_recording(server.session.recordings[-1]).outcome
    print(
        f"\n{CONNECTIONS} connections in {flooded_s:.1f} s: {missed} ticks given up meanwhile, requests of the three "
        f"parties {dict(served)}, {held} file handles of {FILE_HANDLES} held, the trial {outcome and outcome.result}"
    )
    assert missed == 0
    assert set(served) == {200}
    assert outcome is not None
    assert outcome.result == "completed"


def test_300_silent_handshakes_are_closed(tmp_path: Path, few_handles: None) -> None:
    certificate = load_or_create_certificate(("lab",), tmp_path / "certificate")
    trusted = ssl.create_default_context(cafile=str(certificate.certificate_file))
    with make_server(tmp_path, certificate=certificate) as server, ExitStack() as opened:
        began = time.monotonic()
        silent = [
            opened.enter_context(socket.create_connection(("127.0.0.1", server.port)))
            for _ in range(HANDSHAKES)
        ]
        page = httpx.get(f"https://localhost:{server.port}/", verify=trusted, timeout=TIMEOUT_S)
        assert page.status_code == 200
        closed = sum(is_closed(each) for each in silent)
        print(f"\n{closed} of {HANDSHAKES} silent handshakes closed after {time.monotonic() - began:.1f} s")
    assert closed == HANDSHAKES


def fuzzed(seed: int) -> Iterator[bytes]:
    """Yield messages endlessly: valid ones with damaged bytes or fields, random MessagePack, random bytes."""
    rng = random.Random(seed)
    person = SimulatedParticipant(sample_participant_traits("woman", 2), 2)
    numbers = [
        0,
        -1,
        1e30,
        -1e30,
        float("nan"),
        float("inf"),
        2**63 - 1,
        -(2**63),
        2**64 - 1,
        1e-320,
        None,
        "x",
        True,
    ]
    while True:
        frame = msgspec.to_builtins(person.make_tracking_frame(rng.uniform(0.0, 100.0), moving=True))
        kinds: list[dict] = [
            frame, {"type": "answer", "item": "L1", "value": 4, "response_time_s": 1.0}, {"type": "stop"},
            {"type": "choose_body", "sex": "man", "skin_tone": "light"}, {"type": "command", "name": "end"},
            {"type": "scene_loaded", "url": "scenes/0.glb"}, {"type": "correct_torso_height", "torso_height_m": 0.5},
            {"type": "hello", "protocol": messages.PROTOCOL_VERSION, "token": "x", "device": "", "emulated": True},
        ]  # fmt: skip
        message = rng.choice(kinds)
        name = rng.choice(list(message))
        way = rng.randrange(4)
        if way == 0 and isinstance(message[name], list):
            message[name] = [
                [rng.choice(numbers) for _ in range(3)],
                [rng.choice(numbers) for _ in range(4)],
            ]
        elif way == 1 and name != "type":
            message[name] = rng.choice(numbers)
        data = bytearray(msgspec.msgpack.encode(message))
        if way == 2:
            for _ in range(rng.randint(1, 4)):
                data[rng.randrange(len(data))] = rng.randrange(256)
        elif way == 3:
            data = bytearray(rng.randbytes(rng.randrange(200)))
        yield bytes(data)


def is_valid(data: bytes, decode: Callable[[bytes], Message]) -> bool:
    """Return whether the data is a valid message."""
    try:
        return not isinstance(decode(data), Hello)
    except msgspec.DecodeError:
        return False


def send_all(
    server: LiveServer[Session], path: str, token: str, count: int, seed: int, sent: Counter[str]
) -> None:
    """Send messages through successive sockets; unauthenticated ones close after the first message."""
    source = fuzzed(seed)
    while count > 0:
        try:
            with connect(f"ws://127.0.0.1:{server.port}{path}", max_size=None, max_queue=None) as stranger:
                threading.Thread(target=drain, args=(stranger,), daemon=True).start()
                if token:
                    stranger.send(
                        messages.encode_message(Hello(messages.PROTOCOL_VERSION, token, "", emulated=True))
                    )
                while count > 0:
                    data = next(source)
                    if not is_valid(data, messages.decode_watcher_message):
                        stranger.send(data)
                        sent[path] += 1
                        count -= 1
        except (ConnectionClosed, OSError, EOFError):
            sent["sockets closed"] += 1


def test_200_000_messages_during_a_session(tmp_path: Path) -> None:
    """Through sockets of participant, experimenter and spectator, and unauthenticated ones."""
    sent: Counter[str] = Counter()
    with make_server(tmp_path) as server, ExitStack() as opened:
        attendant = Attendant(server, opened)
        wait_until(lambda: attendant.phase == "trial")
        before = memory_bytes()
        own = threading.Thread(target=send_by, args=(attendant, OWN_MESSAGES, sent), daemon=True)
        others = [
            threading.Thread(target=send_all, args=(server, path, token, count, seed, sent), daemon=True)
            for seed, (path, token, count) in enumerate(
                (
                    ("/watch", server.tokens.experimenter, 4 * MESSAGES // 10),
                    ("/watch", server.tokens.spectator, 4 * MESSAGES // 10),
                    ("/ws", "", 2 * MESSAGES // 10 - OWN_MESSAGES),
                )
            )
        ]
        for thread in (own, *others):
            thread.start()
        wait_until(lambda: attendant.phase == "finished" or attendant.ended, 600.0)
        for thread in (own, *others):
            thread.join(1800.0)
            assert not thread.is_alive()
        growth = memory_bytes() - before
        assert status(exchange(server.port, request(server.port, "/", b"Connection: close\r\n"))) == 200
        outcome = read_recording(server.session.recordings[-1]).outcome
        assert server.loop.error is None
    everything = sum(sent.values()) - sent["sockets closed"]
    print(
        f"\n{everything} messages {dict(sent)}: "
        f"the trial {outcome and outcome.result}, states finite: {attendant.finite}, "
        f"{attendant.inbox[Problem]} problems reported to the participant, {growth >> 20} MiB growth"
    )
    assert attendant.finite
    assert not attendant.ended
    assert outcome is not None
    assert outcome.result == "completed"
    assert growth < 200 << 20


def drain(connection: ClientConnection) -> None:
    """Read and drop all messages."""
    with suppress(ConnectionClosed):
        for _ in connection:
            pass


def send_by(attendant: Attendant, count: int, sent: Counter[str]) -> None:
    """Send messages through the participant's socket at half of the rate limit."""
    source = fuzzed(99)
    while count > 0:
        data = next(source)
        if not is_valid(data, messages.decode_participant_message):
            attendant.send(data)
            sent["own"] += 1
            count -= 1
            time.sleep(2.0 / MAX_MESSAGES_PER_S)
