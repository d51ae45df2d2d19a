"""The server over real sockets: authentication, served files, and hostile clients."""

import asyncio
import json
import multiprocessing
import os
import random
import re
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Self, TypeVar, cast

import httpx
import msgspec
import pytest
from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin
from websockets.uri import parse_uri

from avrgym.models.human import Person
from avrgym.recording.reader import read_recording
from avrgym.tasks.settings import Settings
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    Answer,
    Hello,
    InputProfileMessage,
    Language,
    Message,
    ParticipantBody,
    ParticipantReady,
    PhaseDescription,
    Problem,
    Scene,
    SceneLoaded,
    StateReceipt,
    Stop,
    VrEntered,
    Welcome,
    WorldState,
    WorldStateChange,
)
from avrgym.vr.protocol.state_encoding import StateDecoder
from avrgym.vr.scene import export_process as rendering_module
from avrgym.vr.scene.export_process import SceneExporter
from avrgym.vr.server import broadcast, connection, web_server
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.web_server import ServerError
from avrgym.vr.session.session import Session
from helpers.system.processes import kill_with_parent
from helpers.vr.received_states import decode_message
from helpers.vr.visit import constant_policies, plan

pytestmark = pytest.mark.usefixtures("relaxed_limits")

M = TypeVar("M", bound=Message)

PATIENCE_S = 60.0
TYPES = (
    "hello, tracking, receipt, entered, left, ready, scene_loaded, stop, robot_command, visibility_changed, "
    "recalibrate, request_break, change_preferences, origin_reset, answer"
)


PLAN = plan(free_movement_s=0.2, trial_steps=200)


def make_server(folder: Path, port: int = 0) -> LiveServer:
    return LiveServer(
        lambda send: Session(PLAN, constant_policies(PLAN), folder, send, "test"),
        "127.0.0.1",
        port,
    )


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    """One server for all tests, each of which leaves it without a participant."""
    with make_server(tmp_path_factory.mktemp("study")) as server:
        yield server


class Client:
    """A participant's client, without a picture: it shows every scene immediately.

    Where somebody is ``tracked``, their frames go out as often as states come in.
    """

    tracked: SimulatedParticipant | None = None

    def __init__(self, server: LiveServer, host: str = "127.0.0.1", origin: str | None = None) -> None:
        self._server = server
        self._opened = ExitStack()
        raw = socket.create_connection(("127.0.0.1", server.port))
        uri = f"ws://{host}:{server.port}/ws"
        self._socket = self._opened.enter_context(
            connect(uri, sock=raw, origin=cast(Origin, origin), max_size=None, max_queue=None)
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def send(self, *sent: Message | bytes | str) -> None:
        for each in sent:
            self._socket.send(messages.encode_message(each) if isinstance(each, Message) else each)

    def hello(self, **changed: Any) -> None:
        fields = {
            "protocol": messages.PROTOCOL_VERSION,
            "token": self._server.tokens.participant,
            "device": "test",
            "emulated": True,
        }
        self.send(Hello(**fields | changed))

    def receive(self) -> Message:
        message = decode_message(self._socket, self._socket.recv(timeout=PATIENCE_S))
        if isinstance(message, Scene):
            self.send(SceneLoaded(url=message.url))
        if isinstance(message, WorldStateChange) and self.tracked is not None:
            self.send(self.tracked.make_tracking_frame(0.0, moving=False))
        return message

    def await_message(self, kind: type[M], that: Callable[[M], bool] = lambda _: True) -> M:
        """The next message of a kind that fulfils a condition."""
        discard_attempt = time.monotonic() + PATIENCE_S
        while time.monotonic() < discard_attempt:
            message = self.receive()
            if isinstance(message, kind) and that(message):
                return message
        raise TimeoutError(f"no {kind.__name__}")

    def refusal(self) -> tuple[str, int, str]:
        """The words of the problem, then the code and the reason of the close."""
        problem = self.await_message(Problem)
        with pytest.raises(ConnectionClosed) as closed:
            self.await_message(PhaseDescription)
        assert closed.value.rcvd is not None
        return problem.message, closed.value.rcvd.code, closed.value.rcvd.reason

    def vanish(self) -> None:
        """Break the connection without a word."""
        self._socket.socket.shutdown(socket.SHUT_RDWR)


@contextmanager
def participant(server: LiveServer) -> Iterator[Client]:
    """A client that was let in; waits until the one before is gone."""
    discard_attempt = time.monotonic() + PATIENCE_S
    while True:
        client = Client(server)
        client.hello()
        if isinstance(client.receive(), Welcome):
            break
        client.__exit__()
        assert time.monotonic() < discard_attempt
    with client:
        yield client


def send_and_listen(client: Client, *sent: Message) -> None:
    """Send, then listen as long as the connection lasts."""
    client.send(*sent)
    while True:
        client.receive()


def sit_down(client: Client) -> None:
    """Let the client's participant be measured; their trial begins."""
    client.tracked = SimulatedParticipant(sample_participant_traits("woman", 2), 2)
    client.send(VrEntered())
    client.await_message(PhaseDescription, lambda phase: phase.name == "calibration")
    client.send(
        *(client.tracked.make_tracking_frame(0.0, moving=False) for _ in range(6)), ParticipantReady()
    )
    client.await_message(PhaseDescription, lambda phase: phase.name == "check")
    client.send(ParticipantReady())
    client.await_message(PhaseDescription, lambda phase: phase.name == "trial")


def await_that(condition: Callable[[], bool]) -> None:
    discard_attempt = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < discard_attempt
        time.sleep(0.005)


# What is served ----------------------------------------------------------------------------------------------


def get(server: LiveServer, path: str, **headers: str) -> httpx.Response:
    return httpx.get(f"http://127.0.0.1:{server.port}{path}", headers=headers, timeout=PATIENCE_S)


def test_the_page_and_all_that_it_names_are_served(server: LiveServer) -> None:
    page = get(server, "/")
    assert page.status_code == 200
    assert "text/html" in page.headers["content-type"]
    named = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert named
    for path in named:
        assert get(server, "/" + path.lstrip("./")).status_code == 200


def test_a_scene_needs_the_token_and_is_a_glb(server: LiveServer) -> None:
    assert get(server, "/scenes/0.glb").status_code == 401
    token = server.tokens.participant
    for wrong in ("Bearer", "Bearer x", token, f"bearer {token}", f"Bearer {token}x"):
        refused = get(server, "/scenes/0.glb", authorization=wrong)
        assert refused.status_code == 401
        assert "token" in refused.json()["detail"]
    assert get(server, f"/scenes/0.glb?token={server.tokens.participant}").status_code == 401
    allowed = {"authorization": f"Bearer {server.tokens.participant}"}
    for unknown in (-1, 10**6, 10**30):
        assert get(server, f"/scenes/{unknown}.glb", **allowed).status_code == 404

    scene = get(server, "/scenes/0.glb", **allowed)
    assert scene.status_code == 200
    assert scene.headers["content-type"] == "model/gltf-binary"
    assert scene.content.startswith(b"glTF")
    length = int.from_bytes(scene.content[12:16], "little")
    nodes = json.loads(scene.content[20 : 20 + length])["nodes"]
    drawn = {node["extras"]["body"] for node in nodes if "body" in node.get("extras", {})}
    assert drawn
    assert drawn <= {*server.session.bodies, "world"}


SECRETS = ("def create_app", "root:", "[project]", "SQLite")
HOSTILE_PATHS = (
    "/../server.py", "/../../cli.py", "/%2e%2e/server.py", "/..%2fserver.py", "/%2e%2e%2fserver.py",
    "/assets/../../server.py", "/assets/..%5c..%5cserver.py", "/..%5cserver.py", "/....//server.py",
    "//etc/passwd", "/%2fetc/passwd", "/%2Fetc%2Fpasswd", "///etc/passwd", "/etc/passwd",
    "/../../../../../../../../../../etc/passwd", "/%252e%252e%252fserver.py",
    "/scenes/../../etc/passwd.glb", "/scenes/..%2f..%2fetc%2fpasswd.glb", "/scenes/-1.glb", "/scenes/x.glb",
    "/scenes/0.glb/../../server.py", "/scenes/1e3.glb", "/scenes/.glb", "/scenes/%00.glb", "/scenes/0.glb%00",
    "/scenes/" + "9" * 6000 + ".glb", "/index.html%00", "/%00", "/assets/%00/../../server.py", "/a" * 3000,
    "/%ff%fe", "/docs", "/openapi.json", "/ws", "/assets/", "/assets", "http://evil.test/../server.py",
)  # fmt: skip


@pytest.mark.parametrize("path", HOSTILE_PATHS, ids=lambda path: path[:40])
def test_files_outside_the_page_are_not_served(server: LiveServer, path: str) -> None:
    status, body = raw_get(server, path)
    assert 300 <= status < 500
    assert not any(secret in body for secret in SECRETS)
    assert raw_get(server, "/")[0] == 200


def raw_get(server: LiveServer, path: str) -> tuple[int, str]:
    """A GET with the path exactly as it is, with the token; status and body."""
    request = (
        f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {server.tokens.participant}\r\n"
        "Connection: close\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", server.port), PATIENCE_S) as raw:
        raw.sendall(request.encode())
        answer = b"".join(iter(lambda: raw.recv(1 << 16), b"")).decode("utf-8", "replace")
    head, _, body = answer.partition("\r\n\r\n")
    return int(head.split()[1]), body


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
@pytest.mark.parametrize("path", ["/", "/scenes/0.glb", "/index.html", "/new"])
def test_nothing_can_be_written(server: LiveServer, method: str, path: str) -> None:
    headers = {"authorization": f"Bearer {server.tokens.participant}"}
    url = f"http://127.0.0.1:{server.port}{path}"
    assert httpx.request(method, url, headers=headers, content=b"x").status_code == 405
    headers["origin"] = "http://evil.test"
    assert httpx.request(method, url, headers=headers, content=b"x").status_code == 403


@pytest.mark.parametrize(
    "host", ["evil.test", "127.0.0.1.evil.test", "localhost.evil.test:80", "", "[::1]", "[::1"]
)
def test_another_host_name_is_refused(server: LiveServer, host: str) -> None:
    for path in ("/", "/scenes/0.glb"):
        assert (
            get(server, path, host=host, authorization=f"Bearer {server.tokens.participant}").status_code
            == 400
        )
    if "evil" in host:
        with pytest.raises(InvalidStatus) as refused:
            Client(server, host=host.partition(":")[0])
        assert refused.value.response.status_code == 400


def test_the_token_is_in_the_fragment_and_never_in_the_log(
    server: LiveServer, capfd: pytest.CaptureFixture[str]
) -> None:
    assert server.participant_url == f"http://localhost:{server.port}/#token={server.tokens.participant}"
    assert len(server.tokens.participant) >= 20
    get(server, "/scenes/0.glb", authorization=f"Bearer {server.tokens.participant}x")
    with Client(server) as client:
        client.hello(token=server.tokens.participant + "x")
        client.refusal()
    assert server.tokens.participant not in "".join(capfd.readouterr())


# Who is let in -----------------------------------------------------------------------------------------------

GOOD_HELLO = Hello(protocol=messages.PROTOCOL_VERSION, token="?", device="test", emulated=True)


@pytest.mark.parametrize(
    "first",
    [
        VrEntered(),
        Stop(),
        b"",
        b"\xc1 nonsense",
        messages.encode_message(GOOD_HELLO)[:-3],
        "hello",
    ],
    ids=str,
)  # fmt: skip
def test_a_connection_without_hello_is_refused(server: LiveServer, first: Message | bytes | str) -> None:
    with Client(server) as client:
        client.send(first)
        words, code, reason = client.refusal()
    assert code == 4400
    assert words == reason == f"the first message must be a hello of protocol {messages.PROTOCOL_VERSION}"
    assert server.session.phase_name == "waiting"


@pytest.mark.parametrize("protocol", [0, messages.PROTOCOL_VERSION - 1, messages.PROTOCOL_VERSION + 1])
def test_a_page_of_another_protocol_must_reload(server: LiveServer, protocol: int) -> None:
    with Client(server) as client:
        client.hello(protocol=protocol)
        words, code, reason = client.refusal()
    assert code == 4400
    assert (
        words
        == reason
        == (
            f"this page uses protocol {protocol}, the server protocol {messages.PROTOCOL_VERSION}: "
            "reload the page to update it"
        )
    )


def test_a_connection_without_hello_may_reconnect(
    server: LiveServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page that was too busy to speak is not one of another version, which would give up for good."""
    monkeypatch.setattr(connection, "HELLO_TIMEOUT_S", 0.1)
    with Client(server) as client:
        words, code, reason = client.refusal()
    assert code == 4408
    assert words == reason == "no hello was received within 0.1 s; connect again"


@pytest.mark.parametrize("token", ["", "x", "ü", "x" * 128])
def test_a_wrong_token_is_refused(server: LiveServer, token: str) -> None:
    with Client(server) as client:
        client.hello(token=token)
        words, code, reason = client.refusal()
    assert code == (4403 if token else 4401)
    assert ("earlier start" if token else "token") in words
    assert words == reason


@pytest.mark.parametrize("origin", ["http://evil.test", "https://127.0.0.1", "null", "file://"])
def test_another_page_is_refused(server: LiveServer, origin: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        Client(server, origin=origin)
    assert refused.value.response.status_code == 403


def test_the_own_page_is_let_in_by_any_of_its_names(server: LiveServer) -> None:
    for name in ("127.0.0.1", "localhost"):
        with Client(server, host=name, origin=f"http://{name}:{server.port}") as client:
            client.hello(protocol=0)
            assert client.refusal()[1] == 4400


def test_one_participant_at_a_time(server: LiveServer) -> None:
    with participant(server), Client(server) as second:
        second.hello()
        words, code, reason = second.refusal()
    assert code == 4409
    assert "only one is allowed" in words
    assert words == reason
    with participant(server) as third:
        third.await_message(WorldStateChange)


def test_only_one_of_many_participants_is_accepted(server: LiveServer) -> None:
    with participant(server):
        pass
    await_that(lambda: not connected(server))
    clients = [Client(server) for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda client: client.hello(), clients))
    kinds = [type(client.receive()) for client in clients]
    assert sorted(kind.__name__ for kind in kinds) == ["Problem"] * 7 + ["Welcome"]
    for client in clients:
        client.__exit__()


def connected(server: LiveServer) -> bool:
    """Whether somebody is let in."""
    with Client(server) as client:
        client.hello()
        return isinstance(client.receive(), Problem)


# What a client can do ----------------------------------------------------------------------------------------


def test_the_first_messages_are_welcome_language_body_input_scene_and_phase(server: LiveServer) -> None:
    for _ in range(3):
        with participant(server) as client:
            assert isinstance(client.receive(), Language)
            assert isinstance(client.receive(), ParticipantBody)
            assert isinstance(client.receive(), InputProfileMessage)
            assert isinstance(client.receive(), Scene)
            phase = client.receive()
            assert isinstance(phase, PhaseDescription)
            assert phase.name == "waiting"
            states = [client.await_message(WorldStateChange) for _ in range(5)]
            assert [state.sequence for state in states] == sorted({state.sequence for state in states})
            assert len(StateDecoder().decode(states[0]).poses) == 4 * 7 * len(server.session.bodies)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("text", "a text frame was received"),
        (b"", "invalid message"),
        (b"\xc1", "invalid message"),
        (random.Random(1).randbytes(500), "invalid message"),
        (messages.encode_message(VrEntered())[:-1], "invalid message"),
        (messages.encode_message(VrEntered()) + b"\x00", "invalid message"),
        (b"\x81\xa4type\xa4fire", "invalid message"),
        (b"\x82\xa4type\xa7entered\xa1x\x01", "invalid message"),
        (b"\x94" * 20_000, "invalid message"),
        (
            messages.encode_message(Answer(item="L1", value=4, response_time_s=1.0)).replace(
                b"\x04", b"\x00"
            ),
            "value",
        ),
    ],
)
def test_an_invalid_message_is_reported_and_the_connection_remains(
    server: LiveServer, data: bytes | str, words: str
) -> None:
    with participant(server) as client:
        client.send(data)
        problem = client.await_message(Problem)
        assert words in problem.message
        assert TYPES in problem.message
        client.send(VrEntered())
        assert (
            client.await_message(PhaseDescription, lambda phase: phase.name != "waiting").name
            == "calibration"
        )


def test_a_too_large_message_closes_only_its_connection(server: LiveServer) -> None:
    with participant(server) as client:
        with suppress(ConnectionClosed):
            client.send(b"\xc0" * (1 << 16) + b"\xc0")
        with pytest.raises(ConnectionClosed) as closed:
            client.await_message(PhaseDescription, lambda phase: phase.name == "finished")
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009
    with participant(server) as other:
        other.await_message(WorldStateChange)


def test_damaged_messages_never_end_the_session(server: LiveServer) -> None:
    person = SimulatedParticipant(sample_participant_traits("woman", 2), 2)
    rng = random.Random(7)
    with participant(server) as client:
        for _ in range(400):
            sound = (
                person.make_tracking_frame(0.0, moving=True),
                VrEntered(),
                ParticipantReady(),
                Stop(),
                GOOD_HELLO,
            )
            data = bytearray(messages.encode_message(rng.choice(sound)))
            for _ in range(rng.randint(1, 4)):
                data[rng.randrange(len(data))] = rng.randrange(256)
            client.send(bytes(data))
        client.await_message(WorldStateChange)
    assert server.loop.error is None


@pytest.mark.parametrize("kind", ["frames", "entered"])
@pytest.mark.slow
def test_a_flooding_client_is_disconnected_with_the_reason(server: LiveServer, kind: str) -> None:
    person = SimulatedParticipant(sample_participant_traits("woman", 2), 2)
    frame = person.make_tracking_frame(0.0, moving=False)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with participant(server) as client:
        flood = (
            msgspec.structs.replace(frame, sequence=i) if kind == "frames" else VrEntered()
            for i in range(20_000)
        )
        with pytest.raises(ConnectionClosed) as closed:
            send_and_listen(client, *flood)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        assert closed.value.rcvd.reason.startswith(
            "too many messages: the limits are 1000 in a burst and 250 per second"
        )
    with participant(server) as client:
        sit_down(client)
    assert server.loop.error is None
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 * 1024


def test_a_client_that_does_not_listen_is_not_remembered_for_ever() -> None:
    async def push() -> tuple[list[Message], int]:
        outbox = broadcast.Outbox()
        outbox.push(Problem(message="before the welcome"))
        outbox.push(state_of(0))
        outbox.push(Welcome(protocol=1, session="x", role="participant", haptics=True, sounds=True))
        first = await outbox.next_message()
        for i in range(10_000):
            outbox.push(Problem(message=str(i)))
            outbox.push(state_of(i))
        rest = [await outbox.next_message() for _ in range(broadcast.MAX_OUTBOX_MESSAGES + 1)]
        return [first, *rest[-2:]], len(rest)

    (first, problem, state), _ = asyncio.run(push())
    assert isinstance(first, Welcome)
    assert problem == Problem(message="9999")
    assert isinstance(state, WorldState)
    assert state.sequence_number == 9999


def state_of(sequence: int) -> WorldState:
    numbers: dict[str, Any] = {"joint_targets": b"", "deviating_parts": [], "poses": b""}
    return WorldState(sequence_number=sequence, simulation_time_s=0.0, tracking_sequence_number=-1, **numbers)


@pytest.mark.parametrize("takes", [1, 5, 100])
def test_a_slow_client_receives_the_newest_state(takes: int) -> None:
    """Of a hundred states made, a client takes so many: what it takes is never older than what may be on the way."""
    most_behind = messages.MAX_UNACKNOWLEDGED_STATES * 100 // takes

    async def run() -> None:
        outbox, on_the_way, received = broadcast.Outbox(), list[int](), 0
        outbox.push(Welcome(protocol=1, session="x", role="participant", haptics=True, sounds=True))
        await outbox.next_message()
        for made in range(5000):
            outbox.push(state_of(made))
            with suppress(TimeoutError):
                async with asyncio.timeout(0):
                    state = await outbox.next_message()
                    assert isinstance(state, WorldState)
                    assert state.sequence_number == made
                    on_the_way.append(made)
            if made * takes % 100 < takes and on_the_way:
                assert made - on_the_way.pop(0) <= most_behind
                received += 1
                if received % messages.STATES_PER_RECEIPT == 0:
                    outbox.acknowledge_states(received)
            assert len(on_the_way) <= messages.MAX_UNACKNOWLEDGED_STATES

    asyncio.run(run())


@pytest.mark.parametrize("says", [10**12, 0, 7])
def test_invalid_receipts_stop_only_states(server: LiveServer, says: int) -> None:
    with participant(server) as client:
        client.await_message(WorldStateChange)
        client.send(StateReceipt(says))
        client.send(Answer(item="none", value=1, response_time_s=1.0))
        client.await_message(Problem)
    assert server.loop.error is None


@pytest.mark.parametrize("politely", [True, False])
def test_a_dropped_connection_halts_the_robot_and_the_next_is_greeted(
    server: LiveServer, politely: bool
) -> None:
    with participant(server) as client:
        sit_down(client)
        recording = server.session.recordings[-1]
        client.await_message(WorldStateChange)
        if not politely:
            client.vanish()
    await_that(lambda: server.session.phase_name == "waiting")
    await_that(lambda: read_recording(recording).outcome is not None)
    with participant(server) as client:
        assert isinstance(client.receive(), Language)
        assert isinstance(client.receive(), ParticipantBody)
        assert isinstance(client.receive(), InputProfileMessage)
        assert isinstance(client.receive(), Scene)
        phase = client.receive()
        assert isinstance(phase, PhaseDescription)
        assert (phase.name, phase.text) == ("waiting", "The connection was lost. Choose Enter VR to go on.")
    recorded = read_recording(recording)
    assert recorded.is_complete
    assert recorded.outcome is not None
    assert recorded.outcome.result == "interrupted"
    last, event = recorded.messages_by_topic["/physics"][-1], recorded.messages_by_topic["/events"][-1]
    assert event[1].name == "robot_holds"
    assert event[0] == last[0]


@pytest.mark.slow
def test_a_silent_headset_is_disconnected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_server, "PING_INTERVAL_S", 0.1)
    monkeypatch.setattr(web_server, "PING_TIMEOUT_S", 1.0)
    with make_server(tmp_path) as server, socket.create_connection(("127.0.0.1", server.port)) as raw:
        speak_and_fall_silent(server, raw)
        assert connected(server)
        with participant(server) as client:
            client.await_message(WorldStateChange)


def speak_and_fall_silent(server: LiveServer, raw: socket.socket) -> None:
    """Say hello over a bare socket and answer nothing from then on."""
    protocol = ClientProtocol(parse_uri(f"ws://127.0.0.1:{server.port}/ws"))
    protocol.send_request(protocol.connect())
    raw.sendall(b"".join(protocol.data_to_send()))
    protocol.receive_data(raw.recv(4096))
    list(protocol.events_received())
    hello = Hello(
        protocol=messages.PROTOCOL_VERSION, token=server.tokens.participant, device="", emulated=True
    )
    protocol.send_binary(messages.encode_message(hello))
    raw.sendall(b"".join(protocol.data_to_send()))
    raw.recv(4096)


# Scenes are rendered elsewhere -------------------------------------------------------------------------------


class Pool(ThreadPoolExecutor):
    """As a pool of processes, takes nothing more once one of them has ended."""

    broken = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if self.broken:
            raise BrokenProcessPool("killed")
        return super().submit(self._run, fn, *args)

    def _run(self, fn: Callable[..., Any], *args: Any) -> Any:
        try:
            return fn(*args)
        except BrokenProcessPool:
            self.broken = True
            raise


class Rendering:
    """Stands in for the process that renders."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.rendered: list[str] = []
        self.pools = 0
        self.failure: Exception | None = None
        monkeypatch.setattr(rendering_module, "export_scene", self._render)
        monkeypatch.setattr(rendering_module, "make_export_pool", self._make)

    def _make(self) -> ThreadPoolExecutor:
        self.pools += 1
        return Pool(1)

    def _render(self, environment: str, person: Person, settings: Settings) -> bytes:
        time.sleep(0.02)
        self.rendered.append(environment)
        if self.failure is not None:
            raise self.failure
        return environment.encode()


@pytest.fixture
def rendering(monkeypatch: pytest.MonkeyPatch) -> Rendering:
    return Rendering(monkeypatch)


def ask(*numbers: int, exporter: SceneExporter) -> list[bytes | BaseException]:
    """Request scenes concurrently."""

    async def gather() -> list[bytes | BaseException]:
        asked = [exporter.wait_for_glb(number, str(number), Person()) for number in numbers]
        return await asyncio.gather(*asked, return_exceptions=True)

    return asyncio.run(gather())


def test_each_scene_is_exported_once(rendering: Rendering) -> None:
    exporter = SceneExporter()
    assert ask(0, 0, 1, 0, exporter=exporter) == [b"0", b"0", b"1", b"0"]
    assert ask(0, 1, exporter=exporter) == [b"0", b"1"]
    exporter.close()
    assert rendering.rendered == ["0", "1"]


def test_after_an_error_the_next_request_exports_again(rendering: Rendering) -> None:
    exporter = SceneExporter()
    rendering.failure = ValueError("no mesh")
    assert [str(error) for error in ask(0, 0, exporter=exporter)] == ["no mesh", "no mesh"]
    rendering.failure = BrokenProcessPool("killed")
    assert [str(error) for error in ask(0, 1, exporter=exporter)] == ["killed", "killed"]
    rendering.failure = None
    assert ask(0, exporter=exporter) == [b"0"]
    exporter.close()
    assert rendering.rendered == ["0", "0", "1", "0"]
    assert rendering.pools == 2


def test_scenes_exported_in_advance_are_cached(rendering: Rendering) -> None:
    exporter = SceneExporter()
    ahead = exporter.start_export(0, "0", Person())
    assert ask(0, exporter=exporter) == [b"0"]
    assert ahead.done()
    exporter.close()
    assert rendering.rendered == ["0"]


def test_only_the_newest_scenes_are_cached(rendering: Rendering) -> None:
    exporter = SceneExporter()
    many = rendering_module.MAX_CACHED_SCENES + 2
    for number in range(many):
        ask(number, exporter=exporter)
    ask(many - 1, 2, 0, exporter=exporter)
    exporter.close()
    assert rendering.rendered == [*map(str, range(many)), "0"]


ORPHAN = """
import os, time
from avrgym.vr.scene.export_process import make_export_pool
if __name__ == "__main__":
    print(make_export_pool().submit(os.getpid).result(), flush=True)
    time.sleep(100)
"""


@pytest.mark.slow
def test_a_killed_server_leaves_no_process_behind(tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(ORPHAN)
    with subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        preexec_fn=kill_with_parent,
    ) as killed:
        assert killed.stdout is not None
        exporter = int(killed.stdout.readline())
        killed.send_signal(signal.SIGKILL)
    await_that(lambda: not is_alive(exporter))


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


# Beginning and end -------------------------------------------------------------------------------------------


def test_a_port_in_use_is_named_with_the_way_out(server: LiveServer, tmp_path: Path) -> None:
    with pytest.raises(ServerError, match=rf"127\.0\.0\.1:{server.port} .*--port"):
        make_server(tmp_path, server.port)


@pytest.mark.parametrize("host", ["no.such.host.invalid", "::1", "a" * 70, "1.2.3.4"])
def test_an_address_that_is_not_here_is_named(host: str) -> None:
    with pytest.raises(ServerError, match="--host"):
        LiveServer(lambda send: cast(Session, None), host, 0)


def test_a_missing_client_is_named_with_the_way_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(web_server, "STATIC_FOLDER", tmp_path)
    with pytest.raises(ServerError, match="make client"):
        make_server(tmp_path)


def test_the_port_is_free_again_when_the_session_cannot_be_made() -> None:
    ports: list[int] = []

    def fail(_: object) -> Session:
        raise ValueError("no such trial")

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        ports.append(probe.getsockname()[1])
    with pytest.raises(ValueError, match="no such trial"):
        LiveServer(fail, "127.0.0.1", ports[0])
    with socket.socket() as again:
        again.bind(("127.0.0.1", ports[0]))


@pytest.mark.slow
def test_the_server_leaves_nothing_behind(tmp_path: Path) -> None:
    simulations = count_threads("simulation")
    children = len(multiprocessing.active_children())
    with make_server(tmp_path) as server:
        client = Client(server)
        client.hello()
        client.await_message(WorldStateChange)
    with client, pytest.raises(ConnectionClosed):
        client.await_message(PhaseDescription, lambda phase: phase.name == "finished")
    assert count_threads("simulation") == simulations
    assert len(multiprocessing.active_children()) == children
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", server.port))
    with make_server(tmp_path, server.port):
        pass


def count_threads(name: str) -> int:
    return sum(thread.name == name for thread in threading.enumerate())


@pytest.mark.slow
def test_waiting_ends_when_the_simulation_fails(tmp_path: Path) -> None:
    def fail(now_s: float) -> None:
        raise ArithmeticError("the physics exploded")

    def make_session(send: Callable[[Message], None]) -> Session:
        session = Session(PLAN, constant_policies(PLAN), tmp_path, send, "test")
        session.tick = fail
        return session

    server = LiveServer(make_session, "127.0.0.1", 0)
    with pytest.raises(ServerError, match="the physics exploded"), server:
        server.wait()
    assert isinstance(server.loop.error, ArithmeticError)
