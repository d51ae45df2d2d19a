"""All that a session takes: the messages of its clients, and that the participant's connection is gone."""

from dataclasses import dataclass

from avrgym.vr.protocol.messages import ClientMessage, ExperimenterMessage


@dataclass(frozen=True)
class Disconnected:
    """The participant's connection is gone."""


Received = ClientMessage | ExperimenterMessage | Disconnected
