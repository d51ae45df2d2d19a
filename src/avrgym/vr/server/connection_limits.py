"""The gate of a server: which connections may stay, and for how long.

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

MOST_STRANGERS = 256
SHARE_OF_HANDLES = 4
"""Strangers take at most this part of the file handles that the process may have."""
SHARE_OF_ONE_ADDRESS = 4
"""Those of one address are at most this part of all; not on this machine, whose own address all share by a cable."""
MOST_OF_ONE_ROLE = 64
"""How many connections may have shown the token of one role; more of them stay strangers."""
HANDSHAKE_S = 5.0
"""How long TLS may take."""
SILENT_S = 10.0
"""How long a connection may stay without a whole request, at its beginning as after an answer."""
ANSWER_S = 60.0
"""How long a stranger may take over a request, and anybody over taking in an answer."""
SWEEP_EVERY_S = 0.5
NO_HANDLES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
PAUSE_S = 0.05
"""Between attempts to accept, where there is no file handle for another connection."""

MakeProtocol = Callable[[], asyncio.Protocol]


class Connection:
    """One connection from its acceptance to its end.

    ``role``: whose token has been shown by it. ``busy``: a request is being answered, or a WebSocket is open.
    ``heard_s``: when the latest whole request came or its answer was over.
    """

    def __init__(self, accepted: socket.socket, host: str) -> None:
        self.host = host
        self.role: Role | None = None
        self.busy = False
        self.heard_s = time.monotonic()
        self._socket = accepted
        self._transport: asyncio.Transport | None = None
        self._handshake: asyncio.Task[None] | None = None

    @property
    def open(self) -> bool:
        """Whether it still holds a file handle."""
        return self._socket.fileno() >= 0

    @property
    def overdue(self) -> bool:
        """Whether it has taken longer than it may."""
        silent_s = time.monotonic() - self.heard_s
        closing = self._transport is not None and self._transport.is_closing()
        if self.busy:
            return closing or (self.role is None and silent_s > ANSWER_S)
        return silent_s > (ANSWER_S if closing or self._unsent else SILENT_S)

    @property
    def _unsent(self) -> int:
        return self._transport.get_write_buffer_size() if self._transport is not None else 0

    def hear(self, *, busy: bool) -> None:
        """A whole request has come, or its answer is over."""
        self.heard_s, self.busy = time.monotonic(), busy

    def begin(self, make_protocol: MakeProtocol, tls: ssl.SSLContext | None) -> None:
        """Agree on TLS, where that is served, and hand over to a protocol."""
        self._handshake = asyncio.create_task(self._shake_hands(make_protocol, tls))

    async def _shake_hands(self, make_protocol: MakeProtocol, tls: ssl.SSLContext | None) -> None:
        with suppress(OSError):  # the other side's failure
            self._transport, _ = await asyncio.get_running_loop().connect_accepted_socket(
                make_protocol, self._socket, ssl=tls, ssl_handshake_timeout=HANDSHAKE_S if tls else None
            )

    def end(self) -> None:
        """Close it at once."""
        if self._transport is not None:
            self._transport.abort()
        elif self._handshake is not None:
            self._handshake.cancel()


class Gate:
    """Accepts the connections of a socket that listens."""

    def __init__(self, listener: socket.socket, tokens: Tokens) -> None:
        self.listener = listener
        self._tokens = tokens
        self._connections: dict[tuple[str, int], Connection] = {}
        self._most_strangers = min(MOST_STRANGERS, most_file_handles() // SHARE_OF_HANDLES)

    async def open(self, make_protocol: MakeProtocol, tls: ssl.SSLContext | None) -> None:
        """Let connections in until cancelled."""
        self.listener.setblocking(False)
        sweeping = asyncio.create_task(self._sweep())
        try:
            while True:
                await self._accept(make_protocol, tls)
        finally:
            sweeping.cancel()

    def attend(self, app: ASGIApp) -> ASGIApp:
        """An application that lets the gate see whose requests it answers."""

        async def attended(scope: Scope, receive: Receive, send: Send) -> None:
            connection = self._connection(scope)
            if connection is None:
                await app(scope, receive, send)
                return
            caller = self._tokens.bearer(Headers(scope=scope))
            if caller is not None:
                self.recognise(scope, caller.role)
            connection.hear(busy=True)
            try:
                await app(scope, receive, send)
            finally:
                connection.hear(busy=False)

        return attended

    def recognise(self, scope: Scope, role: Role) -> None:
        """By the connection of this request or socket the token of a role has been shown."""
        connection = self._connection(scope)
        if connection is None:
            return
        if sum(each.role == role for each in self._connections.values()) < MOST_OF_ONE_ROLE:
            connection.role = role

    def _connection(self, scope: Scope) -> Connection | None:
        host, port = scope.get("client") or ("", 0)
        return self._connections.get((host, port))

    async def _accept(self, make_protocol: MakeProtocol, tls: ssl.SSLContext | None) -> None:
        try:
            accepted, address = await asyncio.get_running_loop().sock_accept(self.listener)
        except OSError as error:
            if error.errno in NO_HANDLES:
                _end_first(self._strangers())
            await asyncio.sleep(PAUSE_S)
            return
        connection = self._connections[address] = Connection(accepted, address[0])
        connection.begin(make_protocol, tls)
        self._make_room(connection.host)
        await asyncio.sleep(0)  # whatever else is to be done comes between two newcomers

    def _make_room(self, host: str) -> None:
        self._forget_closed()
        strangers = self._strangers()
        neighbours = [each for each in strangers if each.host == host]
        if len(neighbours) > self._most_strangers // SHARE_OF_ONE_ADDRESS and not _is_own(host):
            _end_first(neighbours)
        elif len(strangers) > self._most_strangers:
            _end_first(strangers)

    def _strangers(self) -> list[Connection]:
        return [each for each in self._connections.values() if each.role is None]

    def _forget_closed(self) -> None:
        self._connections = {address: each for address, each in self._connections.items() if each.open}

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(SWEEP_EVERY_S)
            self._forget_closed()
            for each in self._connections.values():
                if each.overdue:
                    each.end()


def _end_first(connections: list[Connection]) -> None:
    """End the one that has been silent longest; those that are being answered come last."""
    if connections:
        min(connections, key=lambda each: (each.busy, each.heard_s)).end()


def _is_own(host: str) -> bool:
    return ipaddress.ip_address(host).is_loopback


def most_file_handles() -> int:
    """How many files and sockets the system lets this process hold at a time."""
    try:
        import resource
    except ImportError:  # Windows, which sets no such limit for sockets
        return SHARE_OF_HANDLES * MOST_STRANGERS
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return SHARE_OF_HANDLES * MOST_STRANGERS if soft == resource.RLIM_INFINITY else soft
