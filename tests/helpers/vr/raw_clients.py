"""Raw clients that keep to no rule, and what a server answers to them."""

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
    """A TCP connection."""
    return socket.create_connection(("127.0.0.1", port), TIMEOUT_S)


@contextmanager
def idle_connections(port: int, count: int) -> Iterator[list[socket.socket]]:
    """Connections that say nothing; to a TLS port they leave the handshake undone."""
    with ExitStack() as opened:
        yield [opened.enter_context(connect(port)) for _ in range(count)]


def is_closed(connection: socket.socket, timeout_s: float = TIMEOUT_S) -> bool:
    """Whether the server closes a connection, having said whatever it says."""
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
    """Whether the server has not closed a connection by now; what it sent is dropped."""
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
    """The bytes of a request with its own host name, then the fields as they are."""
    line = f"{method} {target} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n".encode("utf-8", "surrogateescape")
    return line + b"".join(fields) + b"\r\n" + body


def exchange(port: int, data: bytes, timeout_s: float = TIMEOUT_S) -> bytes:
    """All that the server answers to these bytes, until it closes or says nothing for so long."""
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
    """The status of an answer; ``None`` where there is none."""
    return int(answer.split(None, 2)[1]) if answer.startswith(b"HTTP/1.1 ") else None


def response_headers(answer: bytes) -> dict[str, str]:
    """The headers of an answer."""
    lines = answer.partition(b"\r\n\r\n")[0].decode("latin-1").split("\r\n")[1:]
    return {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
