"""Raw TCP clients that ignore the protocol."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

TIMEOUT_S = 60.0
UPGRADE = (
    b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
    b"Sec-WebSocket-Version: 13\r\n"
)
CLOSE = b"Connection: close\r\n"


def connect(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), TIMEOUT_S)


@contextmanager
def idle_connections(port: int, count: int) -> Iterator[list[socket.socket]]:
    """Open connections that send nothing. On a TLS port their handshake stays incomplete."""
    with ExitStack() as opened:
        yield [opened.enter_context(connect(port)) for _ in range(count)]


def is_closed(connection: socket.socket, timeout_s: float = TIMEOUT_S) -> bool:
    """Return whether the server closes a connection within the timeout; received data is dropped."""
    connection.settimeout(timeout_s)
    try:
        while connection.recv(1 << 16):
            pass
    except TimeoutError:
        return False
    except OSError:
        return True
    return True


def is_open(connection: socket.socket) -> bool:
    """Return whether a connection is still open; received data is dropped."""
    connection.setblocking(False)
    try:
        while connection.recv(1 << 16):
            pass
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


def request(port: int, target: str = "/", *fields: bytes, method: str = "GET", body: bytes = b"") -> bytes:
    """Return the bytes of a request with its host name and the given header fields."""
    line = f"{method} {target} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n".encode("utf-8", "surrogateescape")
    return line + b"".join(fields) + b"\r\n" + body


def exchange(port: int, data: bytes, timeout_s: float = TIMEOUT_S) -> bytes:
    """Send bytes, and return the response until the connection closes or the timeout passes."""
    with connect(port) as connection:
        connection.settimeout(timeout_s)
        answer = b""
        try:
            connection.sendall(data)
            while more := connection.recv(1 << 16):
                answer += more
        except OSError:
            pass
        return answer


def status(answer: bytes) -> int | None:
    """Return the status code of a response, or ``None``."""
    return int(answer.split(None, 2)[1]) if answer.startswith(b"HTTP/1.1 ") else None


def response_headers(answer: bytes) -> dict[str, str]:
    """Return the headers of a response by lower-case name."""
    lines = answer.partition(b"\r\n\r\n")[0].decode("latin-1").split("\r\n")[1:]
    return {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
