"""Connection limits: excess connections are closed, and participants are not affected."""

import resource
import socket
import ssl
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from test_authentication import hear, opened, participant, tell
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from avrgym.vr.protocol.messages import PhaseDescription, VrEntered, WorldStateChange
from avrgym.vr.server import connection_limits as gate_module
from avrgym.vr.server.authentication import Tokens
from avrgym.vr.server.certificate import load_or_create_certificate
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.session import Session
from helpers.vr.raw_clients import (
    TIMEOUT_S,
    connect,
    exchange,
    idle_connections,
    is_closed,
    is_open,
    request,
    status,
)
from helpers.vr.received_states import decode_message
from helpers.vr.visit import constant_policies, plan

PLAN = plan(free_movement_s=0.2, trial_steps=200)


@pytest.fixture
def make_server(tmp_path: Path) -> Callable[..., LiveServer[Session]]:
    def make(**options) -> LiveServer[Session]:
        return LiveServer(
            lambda send: Session(PLAN, constant_policies(PLAN), tmp_path, send, "test"),
            "127.0.0.1",
            0,
            **options,
        )

    return make


@pytest.fixture
def server(make_server: Callable[..., LiveServer[Session]]) -> Iterator[LiveServer[Session]]:
    with make_server() as server:
        yield server


def await_that(condition: Callable[[], bool]) -> None:
    discard_attempt = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < discard_attempt
        time.sleep(0.01)


def test_small_messages_are_sent_without_delay(
    server: LiveServer[Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nagle's algorithm is off on what is accepted: else an answer may wait 40 ms for an acknowledgement."""
    accepted: list[socket.socket] = []
    known = gate_module.Connection
    monkeypatch.setattr(
        gate_module, "Connection", lambda taken, host: accepted.append(taken) or known(taken, host)
    )
    with opened(server, "/watch", server.tokens.spectator) as watcher:
        assert isinstance(hear(watcher, WorldStateChange), WorldStateChange)
        assert accepted
        assert all(taken.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) for taken in accepted)


@pytest.mark.slow
def test_of_too_many_strangers_the_longest_silent_goes(
    make_server: Callable[..., LiveServer[Session]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate_module, "MAX_UNAUTHENTICATED_CONNECTIONS", 8)
    with make_server() as server, idle_connections(server.port, 8) as first:
        with idle_connections(server.port, 5):
            await_that(lambda: [is_open(each) for each in first] == [False] * 5 + [True] * 3)
        assert status(exchange(server.port, request(server.port, "/", b"Connection: close\r\n"))) == 200


class Listener:
    """Reads what a socket is sent, on a thread of its own, as browsers do; ``heard`` counts it by kind."""

    def __init__(self, connection: ClientConnection) -> None:
        self.inbox: Counter[type] = Counter()
        self.ended: ConnectionClosed | None = None
        self._connection = connection
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        try:
            for data in self._connection:
                self.inbox[type(decode_message(self._connection, data))] += 1
        except ConnectionClosed as ended:
            self.ended = ended

    def hears_more(self, kind: type) -> None:
        """Wait for another message of a kind."""
        before = self.inbox[kind]
        await_that(lambda: self.inbox[kind] > before or self.ended is not None)
        assert self.ended is None


@pytest.mark.slow
def test_authenticated_connections_survive_floods(
    make_server: Callable[..., LiveServer[Session]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six times as many strangers as may be, while participant, experimenter and spectator are connected."""
    monkeypatch.setattr(gate_module, "MAX_UNAUTHENTICATED_CONNECTIONS", 16)
    with (
        make_server() as server,
        participant(server) as seated,
        opened(server, "/watch", server.tokens.experimenter) as experimenter,
        opened(server, "/watch", server.tokens.spectator) as spectator,
    ):
        parties = {"participant": seated, "experimenter": experimenter, "spectator": spectator}
        listening = {role: Listener(connection) for role, connection in parties.items()}
        for each in listening.values():
            each.hears_more(WorldStateChange)
        with idle_connections(server.port, 100):
            for role in parties:
                token = {"authorization": f"Bearer {getattr(server.tokens, role)}"}
                for path in ("/", "/spectator", "/scenes/0.glb"):
                    url = f"http://127.0.0.1:{server.port}{path}"
                    assert httpx.get(url, headers=token, timeout=TIMEOUT_S).status_code == 200
            tell(seated, VrEntered())
            listening["participant"].hears_more(PhaseDescription)
            for each in listening.values():
                each.hears_more(WorldStateChange)
        assert server.loop.error is None


def test_one_address_fills_no_more_than_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of another machine; those of this one share an address with a headset on a cable."""
    monkeypatch.setattr(gate_module, "MAX_UNAUTHENTICATED_CONNECTIONS", 8)
    ended: list[str] = []

    class Taken(gate_module.Connection):
        def close_immediately(self) -> None:
            ended.append(self.host)
            self.role = "spectator"  # no stranger any more

    with socket.create_server(("127.0.0.1", 0)) as listener, socket.socket() as unused:
        limiter = gate_module.ConnectionLimiter(listener, Tokens.generate())
        hosts = ["192.0.2.1"] * 4 + ["192.0.2.2", "127.0.0.1", "127.0.0.1", "127.0.0.1", "192.0.2.3"]
        for port, host in enumerate(hosts):
            limiter._connections[host, port] = Taken(unused, host)
            limiter._enforce_limits(host)
    assert ended == ["192.0.2.1"] * 2


@pytest.mark.slow
def test_silence_is_closed(
    make_server: Callable[..., LiveServer[Session]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate_module, "IDLE_CONNECTION_TIMEOUT_S", 0.2)
    monkeypatch.setattr(gate_module, "TIMEOUT_CHECK_INTERVAL_S", 0.05)
    with make_server() as server:
        for said in (b"", b"GET / HTTP/1.1\r\nHost: ", request(server.port)):
            with connect(server.port) as connection:
                connection.sendall(said)
                assert is_closed(connection)
        with participant(server) as seated:
            listening = Listener(seated)
            time.sleep(0.5)
            tell(seated, VrEntered())
            listening.hears_more(WorldStateChange)


@pytest.mark.slow
def test_drop_by_drop_is_no_request(
    make_server: Callable[..., LiveServer[Session]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A header that goes on and on counts as silence."""
    monkeypatch.setattr(gate_module, "IDLE_CONNECTION_TIMEOUT_S", 0.3)
    monkeypatch.setattr(gate_module, "TIMEOUT_CHECK_INTERVAL_S", 0.05)
    with make_server() as server, connect(server.port) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ")
        await_that(lambda: not accepts(connection, b"x"))


def accepts(connection: socket.socket, data: bytes) -> bool:
    """Whether more can be sent."""
    try:
        connection.sendall(data)
    except OSError:
        return False
    return True


@pytest.mark.slow
def test_connections_without_handshake_time_out(
    make_server: Callable[..., LiveServer[Session]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate_module, "TLS_TIMEOUT_S", 0.3)
    certificate = load_or_create_certificate(("lab",), tmp_path / "certificate")
    with make_server(certificate=certificate) as server:
        with idle_connections(server.port, 20) as silent:
            assert all(is_closed(each) for each in silent)
        trusted = ssl.create_default_context(cafile=str(certificate.certificate_file))
        page = httpx.get(f"https://localhost:{server.port}/", verify=trusted, timeout=TIMEOUT_S)
        assert page.status_code == 200


def test_the_server_survives_without_free_file_handles(server: LiveServer[Session]) -> None:
    """All that the process may have are taken for a while: nobody can be accepted, then everybody again."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with participant(server) as seated, socket.socket() as waiting, socket.socket() as later:
        used = max(waiting.fileno(), later.fileno())
        busy_s = time.process_time()
        resource.setrlimit(resource.RLIMIT_NOFILE, (used + 1, hard))
        try:
            waiting.connect(("127.0.0.1", server.port))
            later.connect(("127.0.0.1", server.port))
            for _ in range(20):
                hear(seated, WorldStateChange)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert time.process_time() - busy_s < TIMEOUT_S
        later.settimeout(TIMEOUT_S)
        later.sendall(request(server.port))
        assert status(later.recv(1 << 16)) == 200
        assert isinstance(hear(seated, WorldStateChange), WorldStateChange)


def test_connections_above_the_role_limit_count_as_unauthenticated(
    make_server: Callable[..., LiveServer[Session]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A token opens many connections, but not so many that the server has none left."""
    monkeypatch.setattr(gate_module, "MAX_UNAUTHENTICATED_CONNECTIONS", 4)
    monkeypatch.setattr(gate_module, "MAX_CONNECTIONS_PER_ROLE", 2)
    token = b"Authorization: Bearer "
    with make_server() as server, idle_connections(server.port, 4) as many:
        shown = token + server.tokens.spectator.encode() + b"\r\n"
        for each in many:
            each.sendall(request(server.port, "/scenes/99.glb", shown))
            assert status(each.recv(1 << 16)) == 404
        with idle_connections(server.port, 4):
            await_that(lambda: sum(map(is_open, many)) == 2)
