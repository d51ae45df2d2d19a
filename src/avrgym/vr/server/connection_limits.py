"""The limiter of a server: which connections may stay, and for how long.

Whoever has shown no token is a stranger. Strangers are few at a time, in all and from one address: where one is too
many, the one that has been silent longest goes. So newcomers are let in, and nobody who has shown a token makes room
for them. What says nothing, or takes too long over a handshake, a request or an answer, is closed.
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

MAX_UNAUTHENTICATED = 256
FILE_HANDLE_DIVISOR = 4
"""Strangers take at most this part of the file handles that the process may have."""
ADDRESS_DIVISOR = 4
"""Those of one address are at most this part of all; not on this machine, whose own address all share by a cable."""
MAX_PER_ROLE = 64
"""How many connections may have shown the token of one role; more of them stay unauthenticated."""
TLS_TIMEOUT_S = 5.0
"""How long TLS may take."""
IDLE_TIMEOUT_S = 10.0
"""How long a connection may stay without a whole request, at its beginning as after an answer."""
RESPONSE_TIMEOUT_S = 60.0
"""How long a stranger may take over a request, and anybody over taking in an answer."""
SWEEP_INTERVAL_S = 0.5
OUT_OF_HANDLES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
ACCEPT_RETRY_S = 0.05
"""Between attempts to accept, where there is no file handle for another connection."""

MakeProtocol = Callable[[], asyncio.Protocol]


class Connection:
    """One connection from its acceptance to its end.

    ``role``: whose token has been shown by it. ``busy``: a request is being answered, or a WebSocket is open.
    ``active_s``: when the latest whole request came or its answer was over.
    """

    def __init__(self, accepted: socket.socket, host: str) -> None:
        self.host = host
        self.role: Role | None = None
        self.busy = False
        self.active_s = time.monotonic()
        self._socket = accepted
        self._transport: asyncio.Transport | None = None
        self._handshake: asyncio.Task[None] | None = None

    @property
    def open(self) -> bool:
        """Whether it still holds a file handle."""
        return self._socket.fileno() >= 0

    @property
    def timed_out(self) -> bool:
        """Whether it has taken longer than it may."""
        silent_s = time.monotonic() - self.active_s
        closing = self._transport is not None and self._transport.is_closing()
        if self.busy:
            return closing or (self.role is None and silent_s > RESPONSE_TIMEOUT_S)
        return silent_s > (RESPONSE_TIMEOUT_S if closing or self._unsent else IDLE_TIMEOUT_S)

    @property
    def _unsent(self) -> int:
        return self._transport.get_write_buffer_size() if self._transport is not None else 0

    def note_activity(self, *, busy: bool) -> None:
        """A whole request has come, or its answer is over."""
        self.active_s, self.busy = time.monotonic(), busy

    def begin(self, make_protocol: MakeProtocol, tls: ssl.SSLContext | None) -> None:
        """Agree on TLS, where that is served, and hand over to a protocol."""
        self._handshake = asyncio.create_task(self._handshake_tls(make_protocol, tls))

    async def _handshake_tls(self, make_protocol: MakeProtocol, tls: ssl.SSLContext | None) -> None:
        with suppress(OSError):  # the other side's failure
            self._transport, _ = await asyncio.get_running_loop().connect_accepted_socket(
                make_protocol, self._socket, ssl=tls, ssl_handshake_timeout=TLS_TIMEOUT_S if tls else None
            )

    def end(self) -> None:
        """Close it at once."""
        if self._transport is not None:
            self._transport.abort()
        elif self._handshake is not None:
            self._handshake.cancel()


class ConnectionLimiter:
    """Accepts the connections of a socket that listens."""

    def __init__(self, listener: socket.socket, tokens: Tokens) -> None:
        self.listener = listener
        self._tokens = tokens
        self._connections: dict[tuple[str, int], Connection] = {}
        self._max_unauthenticated = min(MAX_UNAUTHENTICATED, max_open_files() // FILE_HANDLE_DIVISOR)

    async def open(self, make_protocol: MakeProtocol, tls: ssl.SSLContext | None) -> None:
        """Let connections in until cancelled."""
        self.listener.setblocking(False)
        sweeping = asyncio.create_task(self._sweep())
        try:
            while True:
                await self._accept(make_protocol, tls)
        finally:
            sweeping.cancel()

    def middleware(self, app: ASGIApp) -> ASGIApp:
        """An application that lets the limiter see whose requests it answers."""

        async def limited(scope: Scope, receive: Receive, send: Send) -> None:
            connection = self._connection(scope)
            if connection is None:
                await app(scope, receive, send)
                return
            caller = self._tokens.bearer(Headers(scope=scope))
            if caller is not None:
                self.authenticate(scope, caller.role)
            connection.note_activity(busy=True)
            try:
                await app(scope, receive, send)
            finally:
                connection.note_activity(busy=False)

        return limited

    def authenticate(self, scope: Scope, role: Role) -> None:
        """By the connection of this request or socket the token of a role has been shown."""
        connection = self._connection(scope)
        if connection is None:
            return
        if sum(each.role == role for each in self._connections.values()) < MAX_PER_ROLE:
            connection.role = role

    def _connection(self, scope: Scope) -> Connection | None:
        host, port = scope.get("client") or ("", 0)
        return self._connections.get((host, port))

    async def _accept(self, make_protocol: MakeProtocol, tls: ssl.SSLContext | None) -> None:
        try:
            accepted, address = await asyncio.get_running_loop().sock_accept(self.listener)
        except OSError as error:
            if error.errno in OUT_OF_HANDLES:
                _close_longest_idle(self._unauthenticated())
            await asyncio.sleep(ACCEPT_RETRY_S)
            return
        connection = self._connections[address] = Connection(accepted, address[0])
        connection.begin(make_protocol, tls)
        self._enforce_limits(connection.host)
        await asyncio.sleep(0)  # whatever else is to be done comes between two newcomers

    def _enforce_limits(self, host: str) -> None:
        self._forget_closed()
        unauthenticated = self._unauthenticated()
        same_address = [each for each in unauthenticated if each.host == host]
        if len(same_address) > self._max_unauthenticated // ADDRESS_DIVISOR and not _is_own(host):
            _close_longest_idle(same_address)
        elif len(unauthenticated) > self._max_unauthenticated:
            _close_longest_idle(unauthenticated)

    def _unauthenticated(self) -> list[Connection]:
        return [each for each in self._connections.values() if each.role is None]

    def _forget_closed(self) -> None:
        self._connections = {address: each for address, each in self._connections.items() if each.open}

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(SWEEP_INTERVAL_S)
            self._forget_closed()
            for each in self._connections.values():
                if each.timed_out:
                    each.end()


def _close_longest_idle(connections: list[Connection]) -> None:
    """End the one that has been silent longest; those that are being answered come last."""
    if connections:
        min(connections, key=lambda each: (each.busy, each.active_s)).end()


def _is_own(host: str) -> bool:
    return ipaddress.ip_address(host).is_loopback


def max_open_files() -> int:
    """How many files and sockets the system lets this process hold at a time."""
    try:
        import resource
    except ImportError:  # Windows, which sets no such limit for sockets
        return FILE_HANDLE_DIVISOR * MAX_UNAUTHENTICATED
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return FILE_HANDLE_DIVISOR * MAX_UNAUTHENTICATED if soft == resource.RLIM_INFINITY else soft
