"""Decodes the messages of a socket, and counts its states as browsers do."""

from contextlib import suppress
from weakref import WeakKeyDictionary

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import ServerMessage, StateReceipt, WorldStateChange

_received: WeakKeyDictionary[ClientConnection, int] = WeakKeyDictionary()
"""Number of states received by each socket."""


def decode_message(socket: ClientConnection, data: str | bytes) -> ServerMessage:
    """Decode a received message."""
    assert isinstance(data, bytes)
    message = messages.decode_server_message(data)
    if isinstance(message, WorldStateChange):
        _received[socket] = _received.get(socket, 0) + 1
        with suppress(ConnectionClosed):
            socket.send(messages.encode_message(StateReceipt(_received[socket])))
    return message
