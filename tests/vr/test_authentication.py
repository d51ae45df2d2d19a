"""Authentication on every route: tokens by role, hosts, origins; the certificate for the local network."""

import asyncio
import datetime
import ssl
import stat
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import httpx
import pytest
from cryptography import x509
from fastapi.routing import APIRoute, APIWebSocketRoute
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    ControllerPoseCommand,
    ExperimenterCommand,
    Hello,
    Message,
    PhaseDescription,
    Problem,
    SessionStatus,
    VrEntered,
    Welcome,
    WorldStateChange,
    XRPose,
)
from avrgym.vr.server import certificate as certificate_module
from avrgym.vr.server.authentication import Tokens
from avrgym.vr.server.certificate import Certificate, find_lan_host_names, load_or_create_certificate
from avrgym.vr.server.live_server import LiveServer, create_app
from avrgym.vr.server.web_server import ServerError
from avrgym.vr.session.session import Session
from helpers.vr.received_states import decode_message
from helpers.vr.visit import constant_policies, plan

PATIENCE_S = 180.0
SOCKETS = {"/ws": ("participant",), "/watch": ("experimenter", "spectator", "demonstrator")}
"""Every WebSocket, and the roles that it admits."""
PAGES = ("/spectator", "/demonstrator")
"""Every HTTP route that needs no token: pages without any data. All others need one."""
GUARDED = {"/scenes/0.glb": 200, "/sounds/en/chime": 204}
"""Routes that need a token, and their status with a token."""

CLIENT = httpx.Client(verify=False, timeout=PATIENCE_S, limits=httpx.Limits(max_keepalive_connections=0))
"""Made once, because that takes long; it keeps no connection."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer[Session]]:
    folder = tmp_path_factory.mktemp("study")
    with LiveServer(
        lambda send: Session(plan(), constant_policies(plan()), folder, send, "test"), "127.0.0.1", 0
    ) as server:
        yield server


def request(server: LiveServer, method: str, path: str, **headers: str) -> int:
    url = f"http://127.0.0.1:{server.port}{path}"
    return CLIENT.request(method, url, headers=headers).status_code


@contextmanager
def opened(
    server: LiveServer, path: str, token: str, origin: str | None = None
) -> Iterator[ClientConnection]:
    """A socket that has said hello."""
    url = f"ws://127.0.0.1:{server.port}{path}"
    with connect(url, origin=cast(Origin, origin), max_size=None) as socket:
        tell(socket, Hello(messages.PROTOCOL_VERSION, token, "test", emulated=True))
        yield socket


def tell(socket: ClientConnection, message: Message) -> None:
    socket.send(messages.encode_message(message))


def hear(socket: ClientConnection, kind: type) -> Message:
    """The next message of a kind."""
    discard_attempt = time.monotonic() + PATIENCE_S
    while time.monotonic() < discard_attempt:
        message = decode_message(socket, socket.recv(PATIENCE_S))
        if isinstance(message, kind):
            return message
    raise TimeoutError(f"no {kind.__name__}")


def hear_phase(socket: ClientConnection, name: str) -> None:
    """Wait until a phase is entered."""
    while cast(PhaseDescription, hear(socket, PhaseDescription)).name != name:
        pass


@contextmanager
def participant(server: LiveServer) -> Iterator[ClientConnection]:
    """The participant's socket, let in once the one before is gone."""
    discard_attempt = time.monotonic() + PATIENCE_S
    while time.monotonic() < discard_attempt:
        with opened(server, "/ws", server.tokens.participant) as socket:
            if isinstance(hear(socket, Message), Welcome):
                yield socket
                return
    raise TimeoutError("not let in")


def test_all_routes_are_tested(server: LiveServer) -> None:
    routes = server.app.routes
    assert {route.path for route in routes if isinstance(route, APIWebSocketRoute)} == set(SOCKETS)
    found = {route.path for route in routes if isinstance(route, APIRoute)}
    assert found == {*PAGES, "/scenes/{number}.glb", "/sounds/{language}/{name}"}
    assert all(route.methods == {"GET"} for route in routes if isinstance(route, APIRoute))


@pytest.mark.parametrize("path", SOCKETS)
def test_a_socket_opens_only_to_its_roles(server: LiveServer, path: str) -> None:
    for role in ("participant", "experimenter", "spectator", "demonstrator"):
        with opened(server, path, getattr(server.tokens, role)) as socket:
            first = hear(socket, Message)
            if role in SOCKETS[path]:
                assert isinstance(first, Welcome)
                assert first.role == role
            else:
                assert isinstance(first, Problem)
                with pytest.raises(ConnectionClosed) as closed:
                    hear(socket, WorldStateChange)
                assert closed.value.rcvd is not None
                assert closed.value.rcvd.code == 4403


@pytest.mark.parametrize("path", SOCKETS)
@pytest.mark.parametrize("token", ["", "x", "ü" * 60, "0" * 22])
def test_without_its_token_no_socket_opens(server: LiveServer, path: str, token: str) -> None:
    with opened(server, path, token) as socket:
        assert isinstance(hear(socket, Message), Problem)
        with pytest.raises(ConnectionClosed):
            hear(socket, WorldStateChange)


@pytest.mark.parametrize("path", GUARDED)
def test_data_requires_a_token(server: LiveServer, path: str) -> None:
    for wrong in ({}, {"authorization": "Bearer x"}, {"authorization": server.tokens.spectator}):
        assert request(server, "GET", path, **wrong) == 401
    for role in ("participant", "experimenter", "spectator", "demonstrator"):
        assert (
            request(server, "GET", path, authorization=f"Bearer {getattr(server.tokens, role)}")
            == GUARDED[path]
        )


@pytest.mark.parametrize("path", ["/", *PAGES, *GUARDED])
@pytest.mark.parametrize("method", ["GET", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "HEAD"])
def test_pages_of_other_origins_and_hosts_are_refused(server: LiveServer, method: str, path: str) -> None:
    token = f"Bearer {server.tokens.experimenter}"
    for origin in ("http://evil.test", "null", f"http://127.0.0.1:{server.port + 1}"):
        assert request(server, method, path, origin=origin, authorization=token) == 403
    for host in ("evil.test", f"evil.test:{server.port}", "127.0.0.1.evil.test"):
        assert request(server, method, path, host=host, authorization=token) == 400
    if method not in ("GET", "HEAD"):
        assert request(server, method, path, authorization=token) == 405


def test_one_demonstrator_drives_and_nobody_else_steers(server: LiveServer) -> None:
    steer = ControllerPoseCommand(
        clutch=False, grip=None, xr_from_world=XRPose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), scale=1.0
    )
    with opened(server, "/watch", server.tokens.demonstrator) as first:
        assert isinstance(hear(first, Message), Welcome)
        with opened(server, "/watch", server.tokens.demonstrator) as second:
            problem = hear(second, Problem)
            assert cast(Problem, problem).message.startswith("a demonstrator is already connected")
    with opened(server, "/watch", server.tokens.experimenter) as socket:
        hear(socket, Welcome)
        tell(socket, steer)
        assert cast(Problem, hear(socket, Problem)).message.startswith(
            "only demonstrators may steer the robot"
        )


@pytest.mark.parametrize("path", SOCKETS)
@pytest.mark.parametrize("origin", ["http://evil.test", "null", "https://127.0.0.1"])
def test_sockets_of_other_origins_and_hosts_are_refused(server: LiveServer, path: str, origin: str) -> None:
    with pytest.raises(InvalidStatus) as refused, opened(server, path, "", origin):
        pass
    assert refused.value.response.status_code == 403
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://127.0.0.1:{server.port}{path}", additional_headers={"Host": "evil.test"})
    assert refused.value.response.status_code == 400


def test_no_answer_may_be_framed_but_by_the_dashboard(server: LiveServer) -> None:
    for path, framed in {"/": "'none'", "/spectator": "'self'", "/scenes/0.glb": "'none'"}.items():
        headers = httpx.get(f"http://127.0.0.1:{server.port}{path}").headers
        assert f"frame-ancestors {framed};" in headers["content-security-policy"]


def test_tokens_differ_and_are_never_in_the_log(
    server: LiveServer, capfd: pytest.CaptureFixture[str]
) -> None:
    secrets = [*vars(server.tokens).values()]
    assert len({*secrets, *vars(Tokens.generate()).values()}) == 8
    for token in secrets:
        request(server, "GET", "/scenes/99.glb", authorization=f"Bearer {token}")
        for path in SOCKETS:
            with opened(server, path, token) as socket:
                if isinstance(hear(socket, Message), Welcome):
                    socket.send("nonsense")
                    hear(socket, Problem)
    printed = "".join(capfd.readouterr())
    assert not any(token in printed for token in secrets)


# Watching ----------------------------------------------------------------------------------------------------


def test_any_number_of_watchers_may_connect(server: LiveServer) -> None:
    watchers = [opened(server, "/watch", server.tokens.spectator) for _ in range(5)]
    with participant(server) as taking_part:
        sockets = [watcher.__enter__() for watcher in watchers]
        for socket in sockets:
            assert isinstance(hear(socket, SessionStatus), SessionStatus)
        tell(taking_part, VrEntered())
        for socket in sockets:
            hear_phase(socket, "calibration")
        for watcher in watchers:
            watcher.__exit__(None, None, None)
        assert isinstance(hear(taking_part, WorldStateChange), WorldStateChange)


def test_participants_receive_no_status_messages(server: LiveServer) -> None:
    with (
        participant(server) as taking_part,
        opened(server, "/watch", server.tokens.experimenter) as experimenter,
    ):
        kinds = set()
        for _ in range(3):
            hear(experimenter, SessionStatus)
        for _ in range(25):
            kinds.add(type(hear(taking_part, Message)))
        assert SessionStatus not in kinds


def test_spectators_cannot_send_commands(server: LiveServer) -> None:
    with opened(server, "/watch", server.tokens.spectator) as spectator:
        hear(spectator, Welcome)
        tell(spectator, ExperimenterCommand(name="end"))
        assert "may send no commands" in cast(Problem, hear(spectator, Problem)).message
        assert server.session.phase_name != "finished"


def test_participants_cannot_send_commands(server: LiveServer) -> None:
    with participant(server) as taking_part:
        tell(taking_part, ExperimenterCommand(name="end"))
        assert "invalid message" in cast(Problem, hear(taking_part, Problem)).message
        assert server.session.phase_name != "finished"


def test_the_experimenter_commands_the_session(tmp_path: Path) -> None:
    with (
        LiveServer(
            lambda send: Session(plan(), constant_policies(plan()), tmp_path, send, "x"), "127.0.0.1", 0
        ) as server,
        opened(server, "/watch", server.tokens.experimenter) as experimenter,
    ):
        tell(experimenter, ExperimenterCommand(name="end"))
        while cast(SessionStatus, hear(experimenter, SessionStatus)).phase != "finished":
            pass


# The local network -------------------------------------------------------------------------------------------

NAMES = ("192.0.2.7", "lab", "lab.local")


def loaded(certificate: Certificate) -> x509.Certificate:
    return x509.load_pem_x509_certificate(certificate.certificate_file.read_bytes())


def test_a_certificate_is_for_all_names_and_only_its_owner_reads_it(tmp_path: Path) -> None:
    made = load_or_create_certificate(NAMES, tmp_path / "new")
    names = loaded(made).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["localhost", "lab", "lab.local"]
    assert [str(ip) for ip in names.get_values_for_type(x509.IPAddress)] == ["127.0.0.1", "192.0.2.7"]
    for file in (made.certificate_file, made.key_file):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o700


def test_a_certificate_is_reused_until_it_is_invalid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def number(names: tuple[str, ...] = NAMES) -> int:
        return loaded(load_or_create_certificate(names, tmp_path)).serial_number

    first = number()
    assert number() == first
    assert number(NAMES[:1]) == first
    other = number(("192.0.2.8",))
    assert other != first
    (tmp_path / "key.pem").write_text("broken")
    mended = number(("192.0.2.8",))
    assert mended != other
    monkeypatch.setattr(
        certificate_module, "CERTIFICATE_VALIDITY_DAYS", certificate_module.MIN_REMAINING_VALIDITY_DAYS - 1
    )
    (tmp_path / "certificate.pem").unlink()
    soon_over = number(("192.0.2.8",))
    monkeypatch.undo()
    renewed = load_or_create_certificate(("192.0.2.8",), tmp_path)
    assert loaded(renewed).serial_number != soon_over
    left = loaded(renewed).not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    assert left.days >= certificate_module.CERTIFICATE_VALIDITY_DAYS - 1


def test_the_names_are_this_machines() -> None:
    names = find_lan_host_names()
    assert names[-1] == f"{names[-2]}.local"
    assert "127.0.0.1" not in names


@pytest.mark.slow
def test_the_local_network_requires_tls(tmp_path: Path) -> None:
    with pytest.raises(ServerError, match="--lan"):
        LiveServer(lambda send: cast(Session, None), "0.0.0.0", 0)
    made = load_or_create_certificate(("lab",), tmp_path)
    with LiveServer(
        lambda send: Session(plan(), constant_policies(plan()), tmp_path / "study", send, "lan"),
        "0.0.0.0",
        0,
        made,
    ) as server:
        trusted = ssl.create_default_context(cafile=str(made.certificate_file))
        with urllib.request.urlopen(f"https://localhost:{server.port}/spectator", context=trusted) as page:
            assert page.status == 200
        with pytest.raises(httpx.HTTPError):
            httpx.get(f"http://localhost:{server.port}/")
        assert server.participant_url.startswith("https://localhost:")
        assert [url.split("/")[2] for url in server.list_page_urls()] == [
            f"localhost:{server.port}", f"lab:{server.port}"
        ]  # fmt: skip


@pytest.mark.slow
def test_a_browser_keeps_no_scene_of_an_earlier_start() -> None:
    """Tokens outlast a restart, and the numbers of scenes begin at 0 again."""
    tokens, rendered = Tokens.generate(), list[bytes]()

    def started(glb: bytes) -> httpx.ASGITransport:
        async def render(*_: object) -> bytes:
            rendered.append(glb)
            return glb

        loop: Any = SimpleNamespace(session=SimpleNamespace(scenes=[("avrgym/FeedingJaco-v1", None)]))
        renderer: Any = SimpleNamespace(wait_for_glb=render)
        nothing: Any = None
        return httpx.ASGITransport(
            create_app(loop, nothing, tokens, nothing, ["localhost"], renderer, nothing)
        )

    def get(server: httpx.ASGITransport, version: str = "") -> httpx.Response:
        headers = {"authorization": f"Bearer {tokens.experimenter}", "if-none-match": version}

        async def ask() -> httpx.Response:
            async with httpx.AsyncClient(transport=server, base_url="http://localhost") as client:
                return await client.get("/scenes/0.glb", headers=headers)

        return asyncio.run(ask())

    first, later = started(b"first"), started(b"later")
    version = get(first).headers["etag"]
    assert "no-cache" in get(first).headers["cache-control"]
    assert get(first, version).status_code == 304
    assert get(later, version).content == b"later"
    assert rendered == [b"first", b"first", b"later"]
