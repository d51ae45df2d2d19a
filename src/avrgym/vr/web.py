"""A web application on a thread of its own: who may reach it, where it listens, how it ends."""

import socket
import threading
from pathlib import Path

import uvicorn
from fastapi import FastAPI

from avrgym.vr.certificate import Certificate

STATIC = Path(__file__).parent / "static"
LOOPBACK = ("127.0.0.1", "localhost")
EVERY_ADDRESS = "0.0.0.0"
MAX_MESSAGE_BYTES = 1 << 16
PING_INTERVAL_S, PING_TIMEOUT_S = 1.0, 4.0
"""How a connection is found dead that did not say goodbye: a headset that fell asleep or left the network."""
FAREWELL_S = 5


class ServerError(RuntimeError):
    """The server cannot start; the message says why and what to do."""


def check_page(name: str) -> None:
    """``ServerError`` when a page of the client is not built."""
    if not (STATIC / name).exists():
        raise ServerError("the browser client is not built; run `make client`")


def listen(host: str, port: int, certificate: Certificate | None = None) -> socket.socket:
    """A socket that listens; ``ServerError`` where it cannot, or where others would reach it without TLS."""
    if host not in LOOPBACK and certificate is None:
        raise ServerError(
            f"--host {host} is not this machine's own address; allowed: {' and '.join(LOOPBACK)}, which a "
            "headset reaches over USB, because browsers allow VR only on secure pages; --lan serves the "
            "local network, with a certificate"
        )
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise ServerError(
            f"cannot listen on {host}:{port} ({error.strerror}); choose another --port; 0 takes a free one"
        ) from error
    return listener


class WebThread:
    """Serves an application on a socket that listens, from ``start`` to ``stop``."""

    def __init__(self, app: FastAPI, listener: socket.socket, certificate: Certificate | None = None) -> None:
        """With a certificate the pages are served by TLS. ``stop`` closes the socket."""
        self._listener = listener
        self._uvicorn = uvicorn.Server(_configuration(app, certificate))
        self._thread = threading.Thread(target=self._uvicorn.run, kwargs={"sockets": [listener]}, daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def stop(self) -> None:
        """Say goodbye to who is connected and end."""
        self._uvicorn.should_exit = True
        self._thread.join()
        self._listener.close()

    @property
    def running(self) -> bool:
        """Whether it serves."""
        return self._thread.is_alive()

    def wait(self, seconds: float) -> None:
        """Wait until it ends, but no longer than this."""
        self._thread.join(seconds)


def _configuration(app: FastAPI, certificate: Certificate | None) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_ping_interval=PING_INTERVAL_S,
        ws_ping_timeout=PING_TIMEOUT_S,
        timeout_graceful_shutdown=FAREWELL_S,
        ws_per_message_deflate=False,
        ssl_certfile=certificate.certificate_file if certificate else None,
        ssl_keyfile=certificate.key_file if certificate else None,
    )
