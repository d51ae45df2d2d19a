"""Decodes the messages of a socket, and counts its states as browsers do."""

from contextlib import suppress
from weakref import WeakKeyDictionary

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import Receipt, ServerMessage, StateChange

_received: WeakKeyDictionary[ClientConnection, int] = WeakKeyDictionary()
"""Number of states received by each socket."""


def decode_message(socket: ClientConnection, data: str | bytes) -> ServerMessage:
    """Decode a received message."""
    assert isinstance(data, bytes)
    message = messages.decode_server(data)
    if isinstance(message, StateChange):
        _received[socket] = _received.get(socket, 0) + 1
        with suppress(ConnectionClosed):
            socket.send(messages.encode(Receipt(_received[socket])))
    return message
