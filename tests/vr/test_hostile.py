"""Malformed and hostile requests: each is refused without internal details, and the server continues."""

import logging
from collections.abc import Callable, Iterator
from itertools import product

import msgspec
import pytest
from fastapi import FastAPI, WebSocket
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_authentication import hear, participant, tell

from avrgym.study.dashboard.application import PARTICIPANT_ACTIONS, make_dashboard_app
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol import messages
from avrgym.vr.server import connection_limits as gate_module
from avrgym.vr.server.authentication import Tokens
from avrgym.vr.server.connection_limits import ConnectionLimiter
from avrgym.vr.server.http_protocols import MAX_MESSAGE_FRAGMENTS
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.response_headers import make_security_headers
from avrgym.vr.server.web_server import WebServer, open_listener
from avrgym.vr.session.session import Session
from helpers.studies.small_studies import make_study
from helpers.system.paths import ROOT
from helpers.vr.raw_clients import CLOSE, UPGRADE, connect, exchange, request, response_headers, status
from helpers.vr.visit import constant_policies, plan

PLAN = plan()
HTTP_ROUTES = {
    "/": None,
    "/index.html": None,
    "/spectator": None,
    "/dashboard": None,
    "/scenes/0.glb": ("participant", "experimenter", "spectator"),
    "/study/overview": ("experimenter",),
    "/study/participants/sub-001": ("experimenter",),
}
"""What is read, and whose token it needs."""
POSTED = ("/study/participants", *(f"/study/participants/sub-001/{name}" for name in PARTICIPANT_ACTIONS))
SOCKETS = {"/ws": ("participant",), "/watch": ("experimenter", "spectator")}
ROLES = ("participant", "experimenter", "spectator", None)
ORIGINS = (
    "http://evil.test", "null", "http://[::1", "http://[", "://", "", " ", "http://127.0.0.1", "https://127.0.0.1:{port}",
    "http://127.0.0.1:{port}.evil.test", "http://evil.test@127.0.0.1:{port}", "http://127.0.0.1:{port}/",
    "http://127.0.0.1:0{port}", "http://\xff\xfe", "HTTP://127.0.0.1:{port}", "file://", "http://127.0.0.1:99999999999",
)  # fmt: skip
HOSTS = (
    "evil.test", "evil.test:{port}", "127.0.0.1.evil.test", "[::1", "[::1]:{port}", "", "@127.0.0.1", "\xff\xfe",
    "127.0.0.1@evil.test", "*", "127.0.0.2:{port}", "0.0.0.0:{port}", "evil.test:127.0.0.1",
)  # fmt: skip
INSIDE = (b"Traceback", b"site-packages", b".py", b"Error(", b"uvicorn", b"starlette")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer[Session]]:
    folder = tmp_path_factory.mktemp("served")
    with (
        StudyStore(make_study(folder / "study", tasks='["Feeding"]')) as store,
        LiveServer(
            lambda send: Session(PLAN, constant_policies(PLAN), folder, send, "test"),
            "127.0.0.1",
            0,
            study=lambda tokens, _session: make_dashboard_app(store, tokens),
        ) as server,
    ):
        yield server


@pytest.fixture
def quiet(capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Nothing is printed or logged."""
    caplog.set_level(logging.WARNING)
    yield
    assert "".join(capfd.readouterr()) == ""
    assert not [record for record in caplog.records if not record.name.startswith("websockets")]


def bearer(server: LiveServer[Session], role: str | None) -> bytes:
    return f"Authorization: Bearer {getattr(server.tokens, role)}\r\n".encode() if role else b""


def field(name: str, value: str, port: int) -> bytes:
    return f"{name}: {value.replace('{port}', str(port))}\r\n".encode("latin-1")


def assert_guarded(answer: bytes, path: str = "") -> None:
    """It carries every header, and tells nothing of the inside."""
    given = response_headers(answer)
    for name, value in make_security_headers(path).items():
        assert name == "cache-control" or given[name] == value, name
    assert "cache-control" in given
    assert "server" not in given
    assert status(answer) == 200 or not any(secret in answer for secret in INSIDE)


# Every route, role, origin and host --------------------------------------------------------------------------


@pytest.mark.slow
def test_other_origins_and_hosts_are_refused_on_every_route(server: LiveServer[Session], quiet: None) -> None:
    """Also with the right token; and each is answered where neither is hostile."""
    port = server.port
    for path, role in product(HTTP_ROUTES, ROLES):
        for origin in ORIGINS:
            answer = exchange(
                port, request(port, path, field("Origin", origin, port), bearer(server, role), CLOSE)
            )
            assert status(answer) == 403, (path, role, origin)
            assert_guarded(answer, path)
        for host in HOSTS:
            line = f"GET {path} HTTP/1.1\r\n".encode() + field("Host", host, port)
            answer = exchange(port, line + bearer(server, role) + CLOSE + b"\r\n")
            assert status(answer) == 400, (path, role, host)
            assert_guarded(answer, path)


@pytest.mark.parametrize("path", HTTP_ROUTES)
@pytest.mark.parametrize("role", ROLES)
def test_every_route_opens_to_its_roles_only(
    server: LiveServer[Session], path: str, role: str | None, quiet: None
) -> None:
    port, allowed = server.port, HTTP_ROUTES[path]
    own = field("Origin", "http://127.0.0.1:{port}", port)
    answer = exchange(port, request(port, path, own, bearer(server, role), CLOSE))
    if allowed is not None and role not in allowed:
        assert status(answer) == 401
    else:
        assert status(answer) in ((200, 409) if "sub-001" in path else (200,))
    assert_guarded(answer, path)


@pytest.mark.parametrize("path", POSTED)
def test_other_origins_hosts_and_roles_cannot_post(
    server: LiveServer[Session], path: str, quiet: None
) -> None:
    port = server.port
    json = b"Content-Type: application/json\r\nContent-Length: 2\r\n"
    for role in ROLES:
        for origin in ORIGINS:
            given = request(
                port,
                path,
                field("Origin", origin, port),
                bearer(server, role),
                json,
                CLOSE,
                method="POST",
                body=b"{}",
            )
            assert status(exchange(port, given)) == 403
        if role != "experimenter":
            given = request(port, path, bearer(server, role), json, CLOSE, method="POST", body=b"{}")
            assert status(exchange(port, given)) == 401


@pytest.mark.parametrize("path", SOCKETS)
def test_no_socket_opens_to_hostile_origins_and_hosts(
    server: LiveServer[Session], path: str, quiet: None
) -> None:
    port = server.port
    for origin in ORIGINS:
        answer = exchange(port, request(port, path, field("Origin", origin, port), UPGRADE))
        assert status(answer) == 403, origin
        assert_guarded(answer)
    for host in HOSTS:
        line = f"GET {path} HTTP/1.1\r\n".encode() + field("Host", host, port)
        answer = exchange(port, line + UPGRADE + b"\r\n")
        assert status(answer) == 400, host
        assert_guarded(answer)


# What is no request ------------------------------------------------------------------------------------------

NO_REQUESTS: dict[str, Callable[[int], bytes]] = {
    "TLS": lambda port: b"\x16\x03\x01" + b"\xff" * 100 + b"\r\n\r\n",
    "two hosts": lambda port: request(port, "/", b"Host: evil.test\r\n"),
    "no host": lambda port: b"GET / HTTP/1.1\r\n\r\n",
    "a name that is none": lambda port: request(port, "/", b"\xff: a\r\n"),
    "a length that is none": lambda port: request(port, "/", b"Content-Length: many\r\n", method="POST"),
    "a header without end": lambda port: request(port, "/", b"X: " + b"a" * (1 << 20)),
    "a chunk that is none": lambda port: request(
        port, "/study/participants", b"Transfer-Encoding: chunked\r\n", method="POST", body=b"many\r\n"
    ),
    "no version": lambda port: b"GET /\r\n\r\n",
    "a socket by POST": lambda port: request(port, "/ws", UPGRADE, method="POST"),
    "a socket without key": lambda port: request(
        port, "/ws", b"Upgrade: websocket\r\nConnection: Upgrade\r\n"
    ),
    "a socket with a long header": lambda port: request(port, "/ws", UPGRADE, b"X: " + b"a" * 9000 + b"\r\n"),
    "a socket with 200 headers": lambda port: request(port, "/ws", UPGRADE, b"X: a\r\n" * 200),
    "a socket at a long path": lambda port: request(port, "/" + "a" * 9000, UPGRADE),
    "a socket where none is": lambda port: request(port, "/%00%ff", UPGRADE),
    "a socket of the study": lambda port: request(port, "/study/overview", UPGRADE),
}


@pytest.mark.parametrize("data", NO_REQUESTS.values(), ids=NO_REQUESTS)
def test_malformed_requests_are_refused_with_security_headers(
    server: LiveServer[Session], data: Callable[[int], bytes], quiet: None
) -> None:
    answer = exchange(server.port, data(server.port))
    assert answer == b"" or status(answer) in (400, 401, 403, 405, 414, 426, 431)
    if answer:
        assert_guarded(answer)


FIELDS = st.lists(
    st.tuples(
        st.sampled_from(
            ["Host", "Origin", "Authorization", "Range", "Connection", "Upgrade", "Content-Length", "Accept-Encoding",
             "Transfer-Encoding", "If-Modified-Since", "If-None-Match", "Sec-WebSocket-Key", "Expect", "X"]
        ),
        st.one_of(st.binary(max_size=60), st.sampled_from([b"websocket", b"Upgrade", b"chunked", b"bytes=0-", b"1"])),
    ),
    max_size=6,
)  # fmt: skip
TARGETS = st.one_of(
    st.sampled_from(
        ["/", "/ws", "/watch", "/study/overview", "/scenes/0.glb", "/assets/%zz", "*", "http://a/"]
    ),
    st.text(st.characters(codec="latin-1"), max_size=60).map(lambda text: "/" + text),
)


@given(
    method=st.sampled_from(["GET", "POST", "HEAD", "OPTIONS", "PUT", "\x00", "G ET"]),
    target=TARGETS,
    fields=FIELDS,
)
@settings(
    max_examples=150,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@pytest.mark.slow
def test_the_server_survives_random_bytes(
    server: LiveServer[Session], method: str, target: str, fields: list[tuple[str, bytes]]
) -> None:
    line = f"{method} {target} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n".encode("latin-1")
    data = line + b"".join(name.encode() + b": " + value + b"\r\n" for name, value in fields) + b"\r\n"
    answer = exchange(server.port, data, timeout_s=0.05)
    assert status(answer) != 500
    if status(answer) not in (None, 101, 200):
        assert not any(secret in answer for secret in INSIDE)


def test_attacks_leave_no_connections_and_no_log_entries(server: LiveServer[Session], quiet: None) -> None:
    with participant(server) as seated:
        tell(seated, messages.VrEntered())
        assert isinstance(hear(seated, messages.WorldStateChange), messages.WorldStateChange)
    assert server.loop.error is None


# Messages ----------------------------------------------------------------------------------------------------

NESTED = {
    "lists": b"\x91" * 60_000,
    "maps": b"\x81\xa1a" * 20_000,
    "beside the type": b"\x82\xa1x" + b"\x91" * 60_000,
    "in a field": b"\x83\xa4type\xa8tracking\xa4head" + b"\x91" * 60_000,
    "where the hello has its token": b"\x82\xa4type\xa5hello\xa5token" + b"\x91" * 60_000,
}


@pytest.mark.parametrize("data", NESTED.values(), ids=NESTED)
def test_nested_messages_are_refused_as_any_other(data: bytes) -> None:
    for decode in (
        messages.decode_participant_message,
        messages.decode_watcher_message,
        messages.decode_server_message,
    ):
        with pytest.raises(msgspec.DecodeError):
            decode(data)


@given(st.binary(max_size=400))
@settings(max_examples=500, derandomize=True, deadline=None)
def test_no_bytes_do_more_than_be_refused(data: bytes) -> None:
    for decode in (messages.decode_participant_message, messages.decode_watcher_message):
        try:
            message = decode(data)
        except msgspec.DecodeError:
            continue
        assert decode(messages.encode_message(message)) == message


@pytest.mark.parametrize("nested", [b"[" * 60_000, b'{"sex":' * 9_000, b'{"sex":"man","x":' + b"[" * 60_000])
def test_nested_json_is_refused(server: LiveServer[Session], nested: bytes, quiet: None) -> None:
    fields = (
        bearer(server, "experimenter"),
        f"Content-Type: application/json\r\nContent-Length: {len(nested)}\r\n".encode(),
        CLOSE,
    )
    answer = exchange(
        server.port, request(server.port, "/study/participants", *fields, method="POST", body=nested)
    )
    assert status(answer) == 422


def test_a_client_that_leaves_in_the_middle_leaves_no_trace(server: LiveServer[Session], quiet: None) -> None:
    fields = bearer(server, "experimenter"), b"Content-Type: application/json\r\nContent-Length: 100\r\n"
    with connect(server.port) as connection:
        connection.sendall(request(server.port, "/study/participants", *fields, method="POST", body=b"{"))
    exchange(server.port, request(server.port, "/", CLOSE))


def test_a_message_in_frames_without_end_is_cut_off(server: LiveServer[Session]) -> None:
    with connect(server.port) as connection:
        connection.sendall(request(server.port, "/ws", UPGRADE))
        assert status(connection.recv(1 << 16)) == 101
        empty = b"\x00\x80\x00\x00\x00\x00"
        connection.sendall(b"\x02" + empty[1:] + empty * (MAX_MESSAGE_FRAGMENTS + 1))
        answer = b""
        while more := connection.recv(1 << 16):
            answer += more
    assert (1009).to_bytes(2) in answer


# Failures that nobody foresaw --------------------------------------------------------------------------------


def failing() -> FastAPI:
    app = FastAPI(openapi_url=None)

    @app.get("/fail/{secret}")
    def fail(secret: str) -> None:
        raise KeyError(f"{secret} is not known")

    @app.websocket("/before")
    async def before(socket: WebSocket) -> None:
        raise KeyError("secret")

    @app.websocket("/after")
    async def after(socket: WebSocket) -> None:
        await socket.accept()
        raise KeyError("secret")

    return app


@pytest.mark.slow
def test_a_failure_is_a_plain_500_and_one_line_without_words(caplog: pytest.LogCaptureFixture) -> None:
    listener = open_listener("127.0.0.1", 0)
    port, web = (
        listener.getsockname()[1],
        WebServer(failing(), ConnectionLimiter(listener, Tokens.generate())),
    )
    web.start()
    try:
        secret = b"Authorization: Bearer TOKEN\r\n"
        for answer in (
            exchange(port, request(port, "/fail/TOKEN?token=TOKEN", secret, CLOSE)),
            exchange(port, request(port, "/before", secret, UPGRADE)),
        ):
            assert status(answer) == 500
            assert answer.endswith(b"\r\n\r\nInternal Server Error")
            assert_guarded(answer)
        with connect(port) as connection:
            connection.sendall(request(port, "/after", secret, UPGRADE))
            answer = b""
            while not answer.endswith((1011).to_bytes(2) + b"internal error"):
                answer += (more := connection.recv(1 << 16))
                assert more
    finally:
        web.stop()
    said = [record.getMessage() for record in caplog.records]
    assert [words.partition(", line ")[0] for words in said] == [
        f"{what} failed: KeyError in test_hostile.py"
        for what in ("http of /fail/{secret}", "websocket of /before", "websocket of /after")
    ]
    assert not any("\n" in words or "TOKEN" in words for words in said)
    assert not any(record.exc_info for record in caplog.records)


SECURITY = (ROOT / "docs" / "explanation" / "security.md").read_text("utf-8")


@pytest.mark.slow
def test_the_page_lists_connection_limits() -> None:
    for name in (
        "MAX_UNAUTHENTICATED_CONNECTIONS",
        "MAX_CONNECTIONS_PER_ROLE",
        "TLS_TIMEOUT_S",
        "IDLE_CONNECTION_TIMEOUT_S",
        "RESPONSE_TIMEOUT_S",
    ):
        assert f" {getattr(gate_module, name):g} " in SECURITY.replace("\n", " "), name
