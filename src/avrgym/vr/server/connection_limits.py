"""Limits on unauthenticated connections, which have not presented a valid token.

The number of unauthenticated connections is limited, in total and for each address. At the limit, the unauthenticated
connection that has been idle longest is closed. Authenticated connections are never closed for this reason. Connections
have time limits for the TLS handshake, for a request and for a response.
"""

import asyncio
import errno
import ipaddress
import socket
import ssl
import time
from collections.abc import Callable
from contextlib import suppress

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from avrgym.vr.protocol.messages import Role
from avrgym.vr.server.authentication import Tokens

MAX_UNAUTHENTICATED_CONNECTIONS = 256
UNAUTHENTICATED_FILE_HANDLE_DIVISOR = 4
"""Divisor: the maximum number of unauthenticated connections is the maximum number of open files divided by it."""
PER_ADDRESS_LIMIT_DIVISOR = 4
"""Divisor: the maximum for one address is the maximum number of unauthenticated connections divided by it. Loopback has
no such limit, because USB headsets share this address."""
MAX_CONNECTIONS_PER_ROLE = 64
"""Maximum number of authenticated connections of one role. Further connections are treated as unauthenticated."""
TLS_TIMEOUT_S = 5.0
"""Timeout of the TLS handshake, in seconds."""
IDLE_CONNECTION_TIMEOUT_S = 10.0
"""Timeout in seconds of a connection that sends no complete request, at its start and after a response."""
RESPONSE_TIMEOUT_S = 60.0
"""Maximum duration in seconds of an unauthenticated request, and of the transmission of a response."""
TIMEOUT_CHECK_INTERVAL_S = 0.5
NO_FILE_HANDLE_ERROR_CODES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
ACCEPT_RETRY_DELAY_S = 0.05
"""Delay in seconds before the next attempt to accept a connection, if no file handle is free."""

ProtocolFactory = Callable[[], asyncio.Protocol]


class Connection:
    """A TCP connection of a client.

    ``role``: the role of the client's token; ``None`` while unauthenticated. ``is_busy``: a request is in progress, or
    a WebSocket is open. ``last_activity_s``: the time of the latest complete request or response.
    """

    def __init__(self, accepted: socket.socket, host: str) -> None:
        self.host = host
        self.role: Role | None = None
        self.is_busy = False
        self.last_activity_s = time.monotonic()
        self._socket = accepted
        self._transport: asyncio.Transport | None = None
        self._handshake: asyncio.Task[None] | None = None

    @property
    def is_open(self) -> bool:
        """Whether the connection's socket is open."""
        return self._socket.fileno() >= 0

    @property
    def has_timed_out(self) -> bool:
        """Whether the connection has exceeded its timeout."""
        silent_s = time.monotonic() - self.last_activity_s
        closing = self._transport is not None and self._transport.is_closing()
        if self.is_busy:
            return closing or (self.role is None and silent_s > RESPONSE_TIMEOUT_S)
        return silent_s > (RESPONSE_TIMEOUT_S if closing or self._unsent else IDLE_CONNECTION_TIMEOUT_S)

    @property
    def _unsent(self) -> int:
        return self._transport.get_write_buffer_size() if self._transport is not None else 0

    def record_activity(self, *, busy: bool) -> None:
        """Store that a request is complete (``busy``), or that its response has ended (not ``busy``)."""
        self.last_activity_s, self.is_busy = time.monotonic(), busy

    def start(self, make_protocol: ProtocolFactory, tls: ssl.SSLContext | None) -> None:
        """Start the TLS handshake (if ``tls`` is given) and the protocol."""
        self._handshake = asyncio.create_task(self._handshake_tls(make_protocol, tls))

    async def _handshake_tls(self, make_protocol: ProtocolFactory, tls: ssl.SSLContext | None) -> None:
        with suppress(OSError):  # the other side has failed
            self._transport, _ = await asyncio.get_running_loop().connect_accepted_socket(
                make_protocol, self._socket, ssl=tls, ssl_handshake_timeout=TLS_TIMEOUT_S if tls else None
            )

    def close_immediately(self) -> None:
        """Close the connection without waiting for unsent data."""
        if self._transport is not None:
            self._transport.abort()
        elif self._handshake is not None:
            self._handshake.cancel()


class ConnectionLimiter:
    """Accepts the connections of a listening socket and enforces the limits."""

    def __init__(
        self,
        listener: socket.socket,
        tokens: Tokens,
        max_per_role: int | None = None,
        client_address: Callable[[Scope], str] | None = None,
    ) -> None:
        """``client_address``: a function that returns the client's address of a request through a reverse proxy."""
        self.listener, self._client_address = listener, client_address
        self._tokens, self._max_per_role = tokens, max_per_role or MAX_CONNECTIONS_PER_ROLE
        self._connections: dict[tuple[str, int], Connection] = {}
        self._max_unauthenticated = min(
            MAX_UNAUTHENTICATED_CONNECTIONS, read_max_open_files() // UNAUTHENTICATED_FILE_HANDLE_DIVISOR
        )

    async def accept_connections(self, make_protocol: ProtocolFactory, tls: ssl.SSLContext | None) -> None:
        """Accept connections until the task is cancelled."""
        self.listener.setblocking(False)
        sweeping = asyncio.create_task(self._sweep())
        try:
            while True:
                await self._accept(make_protocol, tls)
        finally:
            sweeping.cancel()

    def wrap_with_middleware(self, app: ASGIApp) -> ASGIApp:
        """Returns the application in a middleware that stores the activity and the role of each connection."""

        async def limited(scope: Scope, receive: Receive, send: Send) -> None:
            connection = self._connection(scope)
            if connection is None:
                await app(scope, receive, send)
                return
            caller = self._tokens.authenticate_request(Headers(scope=scope))
            if caller is not None:
                self.mark_authenticated(scope, caller.role)
            connection.record_activity(busy=True)
            if self._client_address is not None:
                connection.host = self._client_address(scope)
                self._enforce_limits(connection.host)
            try:
                await app(scope, receive, send)
            finally:
                connection.record_activity(busy=False)

        return limited

    def mark_authenticated(self, scope: Scope, role: Role) -> None:
        """Store that the connection of this request or WebSocket has presented the token of a role."""
        connection = self._connection(scope)
        if connection is None:
            return
        if sum(each.role == role for each in self._connections.values()) < self._max_per_role:
            connection.role = role

    def mark_in_use(self, scope: Scope, role: Role) -> None:
        """Store that the connection of this WebSocket is in use until it closes. It is needed for WebSockets that do
        not pass the middleware."""
        connection = self._connection(scope)
        if connection is not None:
            connection.record_activity(busy=True)
            self.mark_authenticated(scope, role)

    def _connection(self, scope: Scope) -> Connection | None:
        host, port = scope.get("client") or ("", 0)
        return self._connections.get((host, port))

    async def _accept(self, make_protocol: ProtocolFactory, tls: ssl.SSLContext | None) -> None:
        try:
            accepted, address = await asyncio.get_running_loop().sock_accept(self.listener)
        except OSError as error:
            if error.errno in NO_FILE_HANDLE_ERROR_CODES:
                _close_longest_idle(self._unauthenticated())
            await asyncio.sleep(ACCEPT_RETRY_DELAY_S)
            return
        connection = self._connections[address] = Connection(accepted, address[0])
        connection.start(make_protocol, tls)
        self._enforce_limits(connection.host)
        await asyncio.sleep(0)  # lets other tasks run between two connections

    def _enforce_limits(self, host: str) -> None:
        self._forget_closed()
        unauthenticated = self._unauthenticated()
        same_address = [each for each in unauthenticated if each.host == host]
        if len(same_address) > self._max_unauthenticated // PER_ADDRESS_LIMIT_DIVISOR and not _is_own(host):
            _close_longest_idle(same_address)
        elif len(unauthenticated) > self._max_unauthenticated:
            _close_longest_idle(unauthenticated)

    def _unauthenticated(self) -> list[Connection]:
        return [each for each in self._connections.values() if each.role is None]

    def _forget_closed(self) -> None:
        self._connections = {address: each for address, each in self._connections.items() if each.is_open}

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(TIMEOUT_CHECK_INTERVAL_S)
            self._forget_closed()
            for each in self._connections.values():
                if each.has_timed_out:
                    each.close_immediately()


def _close_longest_idle(connections: list[Connection]) -> None:
    """Close the connection that has been idle longest. Busy connections are closed last."""
    if connections:
        min(connections, key=lambda each: (each.is_busy, each.last_activity_s)).close_immediately()


def _is_own(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a proxy sent another text
        return False


def read_max_open_files() -> int:
    """Returns the maximum number of open files and sockets of this process."""
    try:
        import resource
    except ImportError:  # Windows has no such limit for sockets
        return UNAUTHENTICATED_FILE_HANDLE_DIVISOR * MAX_UNAUTHENTICATED_CONNECTIONS
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return (
        UNAUTHENTICATED_FILE_HANDLE_DIVISOR * MAX_UNAUTHENTICATED_CONNECTIONS
        if soft == resource.RLIM_INFINITY
        else soft
    )
