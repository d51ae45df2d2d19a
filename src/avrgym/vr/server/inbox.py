"""Queue of messages for the next tick. Messages that stop the robot come first. Old tracking frames are dropped."""

import threading
from collections import deque
from dataclasses import dataclass
from typing import get_args

from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import ParticipantDisconnected, ReceivedMessage

MAX_MESSAGES_PER_TICK = 64
MAX_HANDLING_TIME_S = 0.002
"""Maximum time in seconds for messages in a tick. Further messages wait for the next tick."""
MAX_WAITING_FRAMES = 100
"""Maximum number of waiting tracking frames. If there are more, the oldest frames are dropped."""
MAX_WAITING_MESSAGES = 2000
"""Maximum number of waiting messages. At this number, senders of further messages must wait."""


@dataclass(frozen=True)
class NewConnection:
    """A client that has connected in a role. ``send`` is the function that sends messages to this client."""

    send: messages.MessageSender
    role: messages.Role


class Inbox:
    """Thread-safe queue of messages for the simulation's thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._urgent: deque[ReceivedMessage | NewConnection] = deque()
        self._waiting: deque[ReceivedMessage | NewConnection] = deque()
        self._frames = 0

    @property
    def is_full(self) -> bool:
        """Whether the queue is full. Senders must then wait."""
        return len(self._waiting) >= MAX_WAITING_MESSAGES

    def put(self, message: ReceivedMessage | NewConnection) -> None:
        """Add a message at the end, or at the front if it stops the robot.

        A loss of visibility is added twice: at the front and at the end, because an earlier message may report that the
        scene is visible. If a participant disconnects while more messages wait than a tick can handle, the
        participant's messages are discarded.
        """
        with self._lock:
            if stops_robot(message):
                self._urgent.append(message)
            if is_emergency_stop(message):
                return
            if isinstance(message, ParticipantDisconnected) and len(self._waiting) >= MAX_MESSAGES_PER_TICK:
                self._waiting = deque(each for each in self._waiting if not isinstance(each, _PARTICIPANTS))
                self._frames = 0
                self._urgent.append(message)
            else:
                self._waiting.append(message)
                self._frames += isinstance(message, messages.TrackingFrameMessage)

    def get(self) -> ReceivedMessage | NewConnection | None:
        """Remove and return the next message; ``None`` if no message waits. Drops tracking frames above the maximum."""
        with self._lock:
            if self._urgent:
                return self._urgent.popleft()
            while self._waiting:
                message = self._waiting.popleft()
                if not isinstance(message, messages.TrackingFrameMessage):
                    return message
                self._frames -= 1
                if self._frames < MAX_WAITING_FRAMES:
                    return message
            return None


def stops_robot(message: object) -> bool:
    """Returns whether a message stops the robot immediately: an emergency stop, or a loss of visibility."""
    return is_emergency_stop(message) or (
        isinstance(message, messages.VisibilityChanged) and message.visibility != "visible"
    )


def is_emergency_stop(message: object) -> bool:
    """Returns whether a message is an emergency stop."""
    if isinstance(message, messages.RobotCommand | messages.OtherPersonRobotCommand):
        return message.name == "stop"
    return isinstance(message, messages.Stop) or message == _STOP


_STOP = messages.ExperimenterCommand(name="stop")
_PARTICIPANTS = get_args(messages.ParticipantMessage)
