"""Forward WebSockets as bytes between browsers and the processes of sessions.

A browser requests a WebSocket at ``/session/ID/ws`` or ``/session/ID/watch``. The host checks the host header, the
origin and the session's id. It sends the request to the session's server, and then copies all bytes in both directions.
The session's server authenticates the client. The web application rejects all other requests.

The tunnel waits while the session's process starts, or is replaced after a crash.
"""

import asyncio
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

from avrgym.hosting.session_pool import SessionPool
from avrgym.vr.protocol.messages import Role
from avrgym.vr.server.connection_limits import ConnectionLimiter
from avrgym.vr.server.http_protocols import WebSocketProtocol

TUNNEL_REQUEST_PATTERN = re.compile(rb"GET /session/([0-9a-f]{24})/(ws|watch) HTTP/1\.1")
FORWARDED_HEADERS = (
    b"upgrade",
    b"connection",
    b"sec-websocket-key",
    b"sec-websocket-version",
    b"user-agent",
)
SESSION_START_TIMEOUT_S = 8.0
"""Maximum time in seconds to wait for a session's process. The page connects again after 10 s."""
START_POLL_INTERVAL_S = 0.1
MAX_BUFFER_BYTES = 1 << 18
"""Maximum number of buffered bytes in one direction. Above it, reading from the other side pauses."""
MAX_TUNNELS_PER_SESSION = 8


@dataclass(frozen=True)
class TunnelRules:
    """The rules of one web server.

    ``channels``: the last parts of allowed paths. ``allowed_origins``: allowed origins of pages; requests without an
    origin are allowed. ``allowed_hosts``: allowed host headers. ``client_role``: role of all clients, for the
    connection limits.
    """

    pool: SessionPool
    limiter: ConnectionLimiter
    channels: tuple[str, ...]
    allowed_origins: frozenset[str]
    allowed_hosts: frozenset[str]
    client_role: Role


class TunnelFactory:
    """Creates the protocols of connections that request a WebSocket, and counts the tunnels of each session."""

    def __init__(self, rules: TunnelRules) -> None:
        self.rules = rules
        self._open: dict[str, int] = {}

    def make_protocol(self, config: Any, server_state: Any, app_state: Any, **_: Any) -> asyncio.Protocol:
        """Returns the protocol of a new connection. Uvicorn calls this method."""
        return _Upgrade(
            self,
            server_state.connections,
            lambda: WebSocketProtocol(config=config, server_state=server_state, app_state=app_state),
        )

    def open_tunnel(self, session_id: str) -> bool:
        """Count a new tunnel of a session. Returns false if the session has too many tunnels."""
        if self._open.get(session_id, 0) >= MAX_TUNNELS_PER_SESSION:
            return False
        self._open[session_id] = self._open.get(session_id, 0) + 1
        return True

    def close_tunnel(self, session_id: str) -> None:
        """Reduce the number of open tunnels of a session by one."""
        self._open[session_id] -= 1
        if not self._open[session_id]:
            del self._open[session_id]

    def parse_target(self, request: bytes) -> tuple[str, str] | None:
        """Returns session id and channel of a valid request; ``None`` for an invalid request."""
        line, *fields = request.split(b"\r\n")
        match = TUNNEL_REQUEST_PATTERN.fullmatch(line)
        if match is None:
            return None
        found = parse_headers(fields)
        host, origin = found.get(b"host", b"").decode("latin-1"), found.get(b"origin", b"").decode("latin-1")
        channel = match[2].decode()
        valid = host in self.rules.allowed_hosts and (not origin or origin in self.rules.allowed_origins)
        session_id = match[1].decode()
        if (
            not valid
            or channel not in self.rules.channels
            or self.rules.pool.find_session(session_id) is None
        ):
            return None
        return session_id, channel


def parse_headers(lines: list[bytes]) -> dict[bytes, bytes]:
    """Returns the headers of a request by lower-case name. If a header occurs several times, the last value is used."""
    pairs = (line.partition(b":") for line in lines if line)
    return {name.strip().lower(): value.strip() for name, _, value in pairs}


class _Upgrade(asyncio.Protocol):
    """A connection that requests a WebSocket: a tunnel, or the web application's protocol for invalid requests."""

    def __init__(
        self, tunnels: TunnelFactory, connections: set[Any], make_other: Callable[[], asyncio.Protocol]
    ) -> None:
        self._tunnels, self._connections, self._make_other = tunnels, connections, make_other
        self._chosen: asyncio.Protocol | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def data_received(self, data: bytes) -> None:
        if self._chosen is None:
            target = self._tunnels.parse_target(data)
            if target is not None and self._tunnels.open_tunnel(target[0]):
                self._chosen = _Tunnel(self._tunnels, self._connections, *target)
            else:
                self._chosen = self._make_other()
            self._chosen.connection_made(self._transport)
        self._chosen.data_received(data)

    def eof_received(self) -> bool | None:
        return self._chosen.eof_received() if self._chosen is not None else None

    def connection_lost(self, exc: Exception | None) -> None:
        if self._chosen is not None:
            self._chosen.connection_lost(exc)

    def pause_writing(self) -> None:
        if self._chosen is not None:
            self._chosen.pause_writing()

    def resume_writing(self) -> None:
        if self._chosen is not None:
            self._chosen.resume_writing()


class _Tunnel(asyncio.Protocol):
    """The browser's side of a tunnel. ``connections``: open connections, which the server closes when it stops."""

    def __init__(self, tunnels: TunnelFactory, connections: set[Any], session_id: str, channel: str) -> None:
        self._tunnels, self._connections = tunnels, connections
        self._id, self._channel = session_id, channel
        self._other: _SessionSide | None = None
        self._waiting: list[bytes] = []
        self._connecting: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(MAX_BUFFER_BYTES)
        self._connections.add(self)
        host, port = self.transport.get_extra_info("peername")[:2]
        rules = self._tunnels.rules
        rules.limiter.mark_in_use({"type": "websocket", "client": (host, port)}, rules.client_role)

    def data_received(self, data: bytes) -> None:
        if self._connecting is None:
            self._connecting = asyncio.create_task(self._connect(data))
        elif self._other is None:
            self._waiting.append(data)
            if sum(map(len, self._waiting)) > MAX_BUFFER_BYTES:
                self.transport.abort()
        else:
            self._other.transport.write(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._tunnels.close_tunnel(self._id)
        self._connections.discard(self)
        if self._connecting is not None:
            self._connecting.cancel()
        if self._other is not None:
            self._other.transport.close()

    def shutdown(self) -> None:
        """Close the tunnel. Uvicorn calls this method when the server stops."""
        self.transport.close()

    def pause_writing(self) -> None:
        if self._other is not None:
            self._other.transport.pause_reading()

    def resume_writing(self) -> None:
        if self._other is not None:
            self._other.transport.resume_reading()

    async def _connect(self, request: bytes) -> None:
        address = await self._address()
        if address is None:
            self.transport.write(
                b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\ncontent-length: 0\r\n\r\n"
            )
            self.transport.close()
            return
        try:
            _, other = await asyncio.get_running_loop().create_connection(
                lambda: _SessionSide(self.transport), *address
            )
        except OSError:
            self.transport.close()
            return
        other.transport.write(_repeated(request, self._channel, address[1]))
        for data in self._waiting:
            other.transport.write(data)
        self._other, self._waiting = other, []

    async def _address(self) -> tuple[str, int] | None:
        """Wait for the session's process. Returns address and port of its server; ``None`` if it has ended."""
        for _ in range(int(SESSION_START_TIMEOUT_S / START_POLL_INTERVAL_S)):
            session = self._tunnels.rules.pool.find_session(self._id)
            if session is None:
                return None
            if session.server_address is not None and session.process.is_alive():
                return session.server_address
            await asyncio.sleep(START_POLL_INTERVAL_S)
        return None


class _SessionSide(asyncio.Protocol):
    """The session's side of a tunnel: writes received bytes to the browser's connection."""

    def __init__(self, browser: asyncio.Transport) -> None:
        self._browser = browser

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(MAX_BUFFER_BYTES)

    def data_received(self, data: bytes) -> None:
        self._browser.write(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._browser.close()

    def pause_writing(self) -> None:
        with suppress(RuntimeError):
            self._browser.pause_reading()

    def resume_writing(self) -> None:
        with suppress(RuntimeError):
            self._browser.resume_reading()


def _repeated(request: bytes, channel: str, port: int) -> bytes:
    """Returns the request for the session's server. Only ``FORWARDED_HEADERS`` are copied; cookies are removed."""
    found = parse_headers(request.split(b"\r\n")[1:])
    lines = [f"GET /{channel} HTTP/1.1".encode(), f"host: localhost:{port}".encode()]
    lines += [name + b": " + found[name] for name in FORWARDED_HEADERS if name in found]
    return b"\r\n".join([*lines, b"", b""])
