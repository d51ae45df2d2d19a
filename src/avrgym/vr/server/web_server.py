"""A web server that runs an ASGI application in its own thread."""

import asyncio
import logging
import socket
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, cast

import uvicorn
from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.types import ASGIApp

from avrgym.vr.server.certificate import Certificate
from avrgym.vr.server.connection_limits import ConnectionLimiter
from avrgym.vr.server.http_protocols import HttpProtocol, WebSocketProtocol
from avrgym.vr.server.network_addresses import LOOPBACK_HOSTS
from avrgym.vr.server.response_headers import SecurityHeadersMiddleware

STATIC_FOLDER = Path(__file__).parents[1] / "static"
CLIENT_PAGES = (
    "index.html",
    "dashboard.html",
    "caregiver.html",
    "demonstrator.html",
    "replay.html",
    "participate.html",
    "host.html",
)
"""Names of the client's pages: for participants and spectators, for the experimenter, for caregivers, and for
replays."""
CLIENT_INSTALL_HINT = (
    "run `pip install --force-reinstall avrgym`, or `make client` in a clone of the repository"
)
SOCKET_PROTOCOL = socket.IPPROTO_TCP
"""Protocol of listening sockets. asyncio sets TCP_NODELAY only on sockets with an explicit protocol."""
LISTEN_BACKLOG = 1024
"""Maximum number of connections that wait to be accepted."""
MAX_MESSAGE_BYTES = 1 << 16
PING_INTERVAL_S, PING_TIMEOUT_S = 1.0, 4.0
"""Interval and timeout of WebSocket pings in seconds. Pings detect a headset that sleeps or has left the network."""
SHUTDOWN_TIMEOUT_S = 5

_log = logging.getLogger(__name__)


class ServerError(RuntimeError):
    """Raised if the server cannot start. The message contains the reason and a solution."""


def check_client_page(name: str) -> None:
    """Raises ``ServerError`` if a page of the client is not built."""
    if not (STATIC_FOLDER / name).exists():
        raise ServerError(f"the browser client is missing; {CLIENT_INSTALL_HINT}")


def make_page_endpoint(name: str) -> Callable[[], Awaitable[FileResponse]]:
    """Returns the endpoint of a file of the built client."""

    async def page() -> FileResponse:
        return FileResponse(STATIC_FOLDER / name)

    return page


def open_listener(
    host: str, port: int, certificate: Certificate | None = None, *, behind_proxy: bool = False
) -> socket.socket:
    """Returns a new listening socket. ``behind_proxy``: a reverse proxy provides TLS for other computers.

    Raises:
        ServerError: if the port is not available, or for an address other than loopback without a certificate.
    """
    if host not in LOOPBACK_HOSTS and certificate is None and not behind_proxy:
        raise ServerError(
            f"--host {host} needs --lan, because browsers allow VR only on pages with a certificate; "
            f"without --lan, use --host {' or '.join(LOOPBACK_HOSTS)}; a headset reaches it over USB"
        )
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, SOCKET_PROTOCOL)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen(LISTEN_BACKLOG)
    except OSError as error:
        listener.close()
        raise ServerError(
            f"cannot listen on {host}:{port} ({error.strerror}); choose another --port; 0 selects a free one"
        ) from error
    return listener


class WebServer:
    """Serves an ASGI application in its own thread, from ``start`` until ``stop``."""

    def __init__(
        self,
        app: FastAPI,
        limiter: ConnectionLimiter,
        certificate: Certificate | None = None,
        websockets: Callable[..., asyncio.Protocol] = WebSocketProtocol,
    ) -> None:
        """Create the server. A certificate enables TLS. ``stop`` closes the limiter's socket.

        ``websockets``: creates the protocol of a connection that becomes a WebSocket.
        """
        self._limiter = limiter
        limited = limiter.wrap_with_middleware(SecurityHeadersMiddleware(app))
        self._uvicorn = _Server(_configuration(limited, certificate, websockets), limiter)
        self._thread = threading.Thread(target=self._uvicorn.run, daemon=True)

    def start(self) -> None:
        """Start the thread, which accepts connections."""
        self._thread.start()

    def stop(self) -> None:
        """Close all connections, and stop the thread."""
        self._uvicorn.should_exit = True
        self._thread.join()
        self._limiter.listener.close()

    @property
    def is_running(self) -> bool:
        """Whether the thread of the server is alive."""
        return self._thread.is_alive()

    def wait(self, seconds: float) -> None:
        """Wait until the server stops, at most for ``seconds``."""
        self._thread.join(seconds)


class _Server(uvicorn.Server):
    """uvicorn's server. ``ConnectionLimiter`` accepts its connections."""

    def __init__(self, config: uvicorn.Config, limiter: ConnectionLimiter) -> None:
        super().__init__(config)
        self._limiter = limiter
        self._opened: asyncio.Task[None] | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start accepting connections."""
        await super().startup(sockets=[])
        asyncio.get_running_loop().set_exception_handler(_report)
        self._opened = asyncio.create_task(
            self._limiter.accept_connections(self._make_protocol, self.config.ssl)
        )

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop accepting connections, then finish the requests in progress."""
        if self._opened is not None:
            self._opened.cancel()
        self._limiter.listener.close()
        await super().shutdown(sockets=[])

    def _make_protocol(self) -> asyncio.Protocol:
        make = cast(Callable[..., asyncio.Protocol], self.config.http_protocol_class)
        return make(config=self.config, server_state=self.server_state, app_state=self.lifespan.state)


def _report(_events: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log the type of an error between requests. The error's message is omitted, because it may contain request
    data."""
    error = context.get("exception")
    _log.error("a connection failed: %s", type(error).__name__ if error else context.get("message"))


def _configuration(
    app: ASGIApp, certificate: Certificate | None, websockets: Callable[..., asyncio.Protocol]
) -> uvicorn.Config:
    """Returns uvicorn's configuration: fixed event loop and protocols, no trust in proxy headers."""
    return uvicorn.Config(
        app,
        loop="asyncio",
        http=HttpProtocol,
        ws=cast(Any, websockets),
        proxy_headers=False,
        server_header=False,
        log_level="critical",
        access_log=False,
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_ping_interval=PING_INTERVAL_S,
        ws_ping_timeout=PING_TIMEOUT_S,
        timeout_graceful_shutdown=SHUTDOWN_TIMEOUT_S,
        ws_per_message_deflate=False,
        ssl_certfile=certificate.certificate_file if certificate else None,
        ssl_keyfile=certificate.key_file if certificate else None,
    )
