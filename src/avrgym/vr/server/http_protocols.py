"""uvicorn's HTTP and WebSocket protocols, with security headers in rejections and a limit on message fragments."""

from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode, Frame
from websockets.http11 import Response

from avrgym.vr.server.response_headers import make_security_headers

MAX_MESSAGE_FRAGMENTS = 64
"""Maximum number of WebSocket frames of a message. Browsers send one frame per message."""

CLOSE_DELAY_S = 1.0
"""Delay in seconds between the rejection of a client and the closing of its connection."""


class HttpProtocol(H11Protocol):
    """HTTP/1.1 protocol. Responses to malformed requests contain the security headers."""

    def send_400_response(self, msg: str) -> None:
        """Send a 400 response, unless a response has begun, and close the connection."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.write(self._refusal(msg))
        self.transport.close()

    def _refusal(self, msg: str) -> bytes:
        fields = make_security_headers("") | {
            "content-type": "text/plain; charset=utf-8",
            "connection": "close",
        }
        events = (
            h11.Response(status_code=400, headers=list(fields.items()), reason="Bad Request"),
            h11.Data(data=msg.encode()),
            h11.EndOfMessage(),
        )
        return b"".join(self.conn.send(event) or b"" for event in events)


class WebSocketProtocol(WebSocketsSansIOProtocol):
    """WebSocket protocol. Rejections contain the security headers, and the client always receives them."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._reject = self.conn.reject
        self.conn.reject = self._refusal  # pyright: ignore[reportAttributeAccessIssue]

    def data_received(self, data: bytes) -> None:
        """Process received data. If the handshake is invalid, respond with an error."""
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.transport.is_closing():
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.transport.close()

    def handle_cont(self, event: Frame) -> None:
        """Process a continuation frame. Closes the connection if a message has more than ``MAX_MESSAGE_FRAGMENTS``
        frames.
        """
        super().handle_cont(event)
        if len(self.frames) > MAX_MESSAGE_FRAGMENTS:
            self.conn.fail(
                CloseCode.MESSAGE_TOO_BIG, f"a message may have at most {MAX_MESSAGE_FRAGMENTS} frames"
            )
            self.handle_parser_exception()

    def handle_parser_exception(self) -> None:
        """Send the reason for closing, and discard further data for ``CLOSE_DELAY_S``.

        If the connection closed immediately, the system would discard the reason before the client reads it.
        """
        if self.close_sent or self.conn.close_sent is None:
            return
        closed = self.conn.close_sent
        self.queue.put_nowait({"type": "websocket.disconnect", "code": closed.code, "reason": closed.reason})
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.transport.resume_reading()
        self.close_sent = True
        self.close_timer = self.loop.call_later(CLOSE_DELAY_S, self.transport.close)

    def _refusal(self, status: int, text: str) -> Response:
        response = self._reject(status, text)
        response.headers.update(make_security_headers(""))
        return response
