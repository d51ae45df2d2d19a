"""Security of a host: each route with each token, foreign sessions and studies, and connections that do nothing."""

import socket
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from fastapi.routing import APIRoute
from starlette.routing import Mount
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import ClientConnection

from avrgym.hosting.host import StudyHost
from avrgym.hosting.participant_app import PARTICIPANT_ACTIONS
from avrgym.hosting.rate_limits import RateLimits
from avrgym.hosting.session_pool import HostedSession
from avrgym.study.storage.database import StudyDatabase
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import Problem, Welcome
from avrgym.vr.server import connection_limits
from helpers.hosting.served_host import Served, first, wait_until
from helpers.studies.small_studies import small_study

pytestmark = pytest.mark.slow
OPEN_PATHS = ("/", "/favicon.svg", "/api/settings")
"""Paths of pages and settings that need no token."""
JSON_BODY = {"Content-Type": "application/json"}
INVITATION_PATHS = ("/api/invitation", "/api/participants", "/api/headset")
"""Paths that need an invitation or a code in the body."""


@pytest.fixture(autouse=True)
def many_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    """These tests send more requests than people do."""
    monkeypatch.setattr(RateLimits, "allows", lambda self, key: True)


@pytest.fixture(scope="module")
def running(served: Served) -> tuple[HostedSession, str]:
    """A running session, and its participant's own token."""
    return served.start()


def routes(app: object) -> list[tuple[str, str]]:
    """Method and path of every route of a web application, also of those that it contains."""
    found: list[tuple[str, str]] = []
    for route in app.routes:  # type: ignore[attr-defined]
        if isinstance(route, APIRoute):
            found += [(method, route.path) for method in route.methods or ()]
        elif isinstance(route, Mount) and hasattr(route.app, "routes"):
            found += [(method, route.path + path) for method, path in routes(route.app)]
    return found


def test_each_route_refuses_every_other_token(
    served: Served, running: tuple[HostedSession, str], tmp_path: Path
) -> None:
    """Tokens of other roles, of another study and of ended links open nothing."""
    session, own = running
    with StudyStore(small_study(tmp_path / "other")) as other_study, StudyHost(other_study) as other_host:
        other = Served(other_host)
        _, foreign = other.enrol()
        tokens = other_host.tokens
        wrong = {
            "none": "",
            "random": "A" * 22,
            "participant of another study": foreign,
            "experimenter of another study": tokens.experimenter,
            "invitation": served.invite(),
            "spectator": served.host.tokens.spectator,
        }
        for_public = wrong | {
            "experimenter": served.host.tokens.experimenter,
            "link of a session": session.link_token,
        }
        for_experimenter = wrong | {"participant": own, "link of a session": session.link_token}
        checked = 0
        for experimenter, given in ((False, for_public), (True, for_experimenter)):
            server = served.host._experimenter if experimenter else served.host._public
            for method, path in routes(app_of(server)):
                if path in (*OPEN_PATHS, *INVITATION_PATHS, "/participants") or "/session/" in path:
                    continue
                named = path.replace("{session_id}", session.id).replace("{pseudonym}", session.pseudonym)
                for name, token in given.items():
                    answer = served.request(method, named, token, experimenter=experimenter)
                    assert answer.status_code == 401, (method, path, name)
                    checked += 1
        assert checked > 150
    print(f"{checked} requests were refused")


def refused(socket: ClientConnection) -> int | None:
    """Receive all messages, none of which is a welcome. Returns the closing code."""
    with suppress(ConnectionClosed):
        while True:
            assert not isinstance(first(socket), Welcome)
    return socket.close_code


def app_of(server: object) -> object:
    """The web application of a server."""
    app = server._uvicorn.config.app  # type: ignore[attr-defined]
    while not hasattr(app, "routes"):
        closure = getattr(app, "__closure__", None)
        app = next(c.cell_contents for c in closure if callable(c.cell_contents)) if closure else app._app
    return app


def test_public_server_has_no_page_for_experimenters(served: Served) -> None:
    paths = [path for _, path in routes(app_of(served.host._public))]
    assert not [
        path for path in paths if any(word in path for word in ("study", "dashboard", "watch", "door"))
    ]
    token = served.host.tokens.experimenter
    for path in ("/study/overview", "/dashboard", "/host.html", "/dashboard.html", "/api/sessions", "/watch"):
        assert served.request("GET", path, token).status_code in (404, 403), path


def test_sockets_open_only_with_the_link_of_their_session(
    served: Served, running: tuple[HostedSession, str]
) -> None:
    session, own = running
    other, other_own = served.start()
    for token in (
        "",
        "A" * 22,
        own,
        other.link_token,
        other_own,
        served.host.tokens.experimenter,
        served.invite(),
    ):
        with served.connect(session.id, token) as opened:
            assert refused(opened) in (4401, 4403, 4410, 4411), token
    for path, experimenter in ((("watch"), False), (("ws"), True)):
        with (
            pytest.raises(InvalidHandshake),
            served.connect(session.id, served.host.tokens.experimenter, path, experimenter=experimenter),
        ):
            pass
    with pytest.raises(InvalidHandshake), served.connect("0" * 24, session.link_token):
        pass
    with served.connect(session.id, session.link_token, "watch", experimenter=True) as opened:
        assert refused(opened) == 4403
    served.post("withdrawal", other_own)
    wait_until(lambda: served.host.pool.find_session(other.id) is None, "the session ends")


@pytest.mark.parametrize(
    "headers", [{"Origin": "https://evil.example"}, {"Host": "evil.example"}], ids=["origin", "host"]
)
def test_other_origins_and_hosts_are_refused(
    served: Served, running: tuple[HostedSession, str], headers: dict[str, str]
) -> None:
    session, own = running
    for experimenter in (False, True):
        token = served.host.tokens.experimenter if experimenter else own
        path = "/api/sessions" if experimenter else "/api/stage"
        answer = served.request("GET", path, token, experimenter=experimenter, headers=headers)
        assert answer.status_code in (400, 403)
    if "Origin" in headers:
        with (
            pytest.raises(InvalidHandshake),
            served.connect(session.id, session.link_token, additional_headers=headers),
        ):
            pass


def test_pages_cannot_be_framed_and_tokens_are_not_in_addresses(
    served: Served, running: tuple[HostedSession, str]
) -> None:
    session, own = running
    for path in ("/", f"/session/{session.id}/"):
        headers = served.request("GET", path).headers
        assert headers["x-frame-options"] == "DENY"
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["referrer-policy"] == "no-referrer"
        assert "set-cookie" not in headers
    stage = served.stage(own)
    assert session.pseudonym not in stage["path"]
    assert stage["token"] not in stage["path"]


@pytest.mark.parametrize(
    "path",
    [
        "/session/../../study.toml",
        "/assets/../../vr/server/authentication.py",
        "/assets/%2e%2e/host.html",
        "/session/{id}/assets/..%2f..%2fhost.html",
        "/session/{id}/scenes/..%2f..%2fws",
        "/session/{id}/sounds/en/..%2f..%2f..%2fstudy.toml",
        "/session/{id}/study/overview",
        "/session/{id}/watch",
    ],
)
def test_paths_do_not_leave_their_folders(
    served: Served, running: tuple[HostedSession, str], path: str
) -> None:
    session, _ = running
    answer = served.request("GET", path.replace("{id}", session.id), session.link_token)
    assert answer.status_code in (404, 400, 403)


def test_session_continues_while_thousands_of_idle_connections_come(
    served: Served, running: tuple[HostedSession, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Connections that send nothing, or half a request, are closed. The session's connection is not, also after the
    time at which unused connections are closed."""
    session, own = running
    monkeypatch.setattr(connection_limits, "IDLE_CONNECTION_TIMEOUT_S", 1.0)
    with served.connect(session.id, session.link_token) as opened, ExitStack() as many:
        assert isinstance(first(opened), Welcome)
        for number in range(2000):
            idle = many.enter_context(socket.create_connection(("127.0.0.1", served.host.public_port)))
            if number % 2:
                idle.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nX-Slow: ")
        assert served.stage(own)["type"] == "session"
        ends_s = time.monotonic() + 2.0
        while time.monotonic() < ends_s:
            assert not isinstance(first(opened), Problem)
    assert session.crashes == 0


def test_session_continues_with_a_client_that_does_not_read(
    served: Served, running: tuple[HostedSession, str]
) -> None:
    """The spectator's connection is full after a while; the participant still receives all messages."""
    session, _ = running
    spectator = served.host.tokens.spectator
    with (
        served.connect(session.id, spectator, "watch", experimenter=True, max_queue=1),
        served.connect(session.id, session.link_token) as opened,
    ):
        assert isinstance(first(opened), Welcome)
        ends_s = time.monotonic() + 3.0
        while time.monotonic() < ends_s:
            assert not isinstance(first(opened), Problem)
    assert session.crashes == 0


def test_tokens_are_checked_without_the_database(
    served: Served, running: tuple[HostedSession, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The event loop, which also passes on the sessions' data, never waits for a slow database."""
    _, own = running
    tokens = served.host._public._limiter._tokens

    def refuse(*_: object) -> None:
        raise StudyError("a query")

    with monkeypatch.context() as patch:
        patch.setattr(StudyDatabase, "read_transaction", refuse)
        assert [tokens.find_client_by_token(each) is not None for each in (own, "A" * 22)] == [True, False]


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b'{"x": 1}', b"[" * 5000, b'"' + b"a" * 9000 + b'"'])
def test_malformed_bodies_are_refused(
    served: Served, running: tuple[HostedSession, str], body: bytes
) -> None:
    _, own = running
    for name in ("invitation", "participants", "headset", *PARTICIPANT_ACTIONS):
        answer = served.request("POST", f"/api/{name}", own, json=None, content=body, headers=JSON_BODY)
        assert 400 <= answer.status_code < 500, name


def test_only_the_public_address_is_an_origin_behind_a_proxy(tmp_path: Path) -> None:
    with (
        StudyStore(small_study(tmp_path / "study")) as store,
        StudyHost(store, address="https://Study.example", proxies=("127.0.0.1",)) as host,
    ):
        hosted = Served(host)
        token = hosted.invite()
        for origin, status in (
            ("https://study.example", 200),
            ("http://study.example", 403),
            ("https://study.example:8443", 403),
            ("null", 403),
        ):
            headers = {"Host": "study.example", "Origin": origin, "X-Forwarded-For": "203.0.113.7"}
            answer = hosted.request("POST", "/api/invitation", headers=headers, json={"token": token})
            assert answer.status_code == status, origin


def test_connections_of_one_address_behind_a_proxy_are_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Requests with a slow body: the oldest of the same address ends, and one of another address does not."""
    monkeypatch.setattr(connection_limits, "MAX_UNAUTHENTICATED_CONNECTIONS", 16)
    with (
        StudyStore(small_study(tmp_path / "study")) as store,
        StudyHost(store, address="https://study.example", proxies=("127.0.0.1",)) as host,
        ExitStack() as opened,
    ):

        def begin_request(address: str) -> socket.socket:
            connection = opened.enter_context(
                socket.create_connection(("127.0.0.1", host.public_port), timeout=10.0)
            )
            headers = "Host: study.example\r\nContent-Type: application/json\r\nContent-Length: 100\r\n"
            head = f"POST /api/invitation HTTP/1.1\r\n{headers}X-Forwarded-For: {address}\r\n\r\n"
            connection.sendall(head.encode())
            return connection

        other = begin_request("203.0.113.1")
        first, *rest = [begin_request("203.0.113.7") for _ in range(5)]
        assert first.recv(1) == b""
        for each in (other, *rest):
            each.settimeout(0.2)
            with pytest.raises(TimeoutError):
                each.recv(1)
