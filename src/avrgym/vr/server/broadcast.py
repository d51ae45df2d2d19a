"""Broadcast of messages from the simulation's thread to the connections: one participant and any number of watchers."""

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Callable, Generator
from typing import TypeVar

from avrgym.vr.protocol.messages import (
    MAX_UNACKNOWLEDGED_STATES,
    DemonstrationProgress,
    Message,
    ParticipantTargets,
    Problem,
    Role,
    Scene,
    SessionStatus,
    TargetSelected,
    TickTiming,
    ToolForce,
    Welcome,
    WorldState,
)
from avrgym.vr.server.authentication import EXPIRED_LINK_REJECTION, TokenRejection

T = TypeVar("T")

MAX_OUTBOX_MESSAGES = 1000
"""Maximum number of waiting messages of a connection. If there are more, the oldest messages are dropped."""
WATCHER_ONLY_MESSAGES = (SessionStatus, TickTiming, DemonstrationProgress)


def is_message_for_role(message: Message, role: Role) -> bool:
    """Returns whether clients with this role receive a message."""
    if isinstance(message, Problem):
        return role in ("experimenter", message.role)
    if isinstance(message, ToolForce):
        return role == "demonstrator"
    if isinstance(message, ParticipantTargets):
        return role == "experimenter"
    if isinstance(message, TargetSelected):
        return role == "participant"
    return role != "participant" or not isinstance(message, WATCHER_ONLY_MESSAGES)


CLOSE_ALL_TIMEOUT_S = 1.0
"""Maximum time in seconds for closing all connections when the server stops."""


class ConnectionClosedError(Exception):
    """Raised after all queued messages are sent and the connection closes. ``close_code``: WebSocket close code."""

    def __init__(self, reason: str, code: int) -> None:
        super().__init__(reason)
        self.close_code = code


class Outbox:
    """Messages that wait to be sent to one connection: all messages in order, but only the newest state of the newest
    scene.

    The first message is the welcome; messages before it are discarded. ``created_s`` is the time at which the latest
    sent state was computed.

    Flow control: at most ``MAX_UNACKNOWLEDGED_STATES`` states are sent before the client acknowledges them. Otherwise
    buffers of system and browser would delay the states of a slow client by up to a minute.
    """

    def __init__(self) -> None:
        self._messages: deque[Message] = deque(maxlen=MAX_OUTBOX_MESSAGES)
        self._state: tuple[WorldState, float] | None = None
        self.latest_state_time_s = 0.0
        self._sent_states = self._received_states = 0
        self._welcomed = False
        self._farewell: ConnectionClosedError | None = None
        self._filled = asyncio.Event()

    def push(self, message: Message, created_s: float = 0.0) -> None:
        """Add a message; ``created_s`` is the time at which it was computed."""
        self._welcomed = self._welcomed or isinstance(message, Welcome)
        if not self._welcomed or self._farewell is not None:
            return
        if isinstance(message, WorldState):
            self._state = message, created_s
        else:
            self._messages.append(message)
            self._state = None if isinstance(message, Scene) else self._state
        self._filled.set()

    def acknowledge_states(self, states: int) -> None:
        """Store the number of states that the client has received."""
        self._received_states = states
        self._filled.set()

    def close(self, reason: str, code: int = 1001) -> None:
        """Close the connection after all waiting messages. Later messages are discarded."""
        self._farewell = ConnectionClosedError(reason, code)
        self._filled.set()

    async def next_message(self) -> Message:
        """Wait for the next message to send. Raises ``ConnectionClosedError`` when the connection closes."""
        while True:
            if self._messages:
                return self._messages.popleft()
            if (
                self._state is not None
                and self._sent_states < self._received_states + MAX_UNACKNOWLEDGED_STATES
            ):
                self._sent_states += 1
                (state, self.latest_state_time_s), self._state = self._state, None
                return state
            if self._farewell is not None:
                raise self._farewell
            self._filled.clear()
            await self._filled.wait()


class Broadcast:
    """Passes each message of the simulation's thread to all connections that may receive it, see
    ``is_message_for_role``.
    """

    def __init__(self) -> None:
        self._events: asyncio.AbstractEventLoop | None = None
        self._participant: Outbox | None = None
        self._watchers: list[tuple[Role, Outbox]] = []

    @property
    def has_participant(self) -> bool:
        """Whether the connection of a participant is open."""
        return self._participant is not None

    def has_connection(self, role: Role) -> bool:
        """Whether a connection in this role is open."""
        watching = any(each == role for each, _ in self._watchers)
        return self.has_participant if role == "participant" else watching

    def send(self, message: Message) -> None:
        """Send a message to all connections for which ``is_message_for_role`` is true. Call it from the simulation's
        thread.
        """
        if self._participant is not None or self._watchers:
            self._call(lambda created_s: self._deliver(message, created_s), time.monotonic())

    def make_sender(self, outbox: Outbox) -> Callable[[Message], None]:
        """Returns a function that sends a message to one connection. Call it from the simulation's thread."""
        return lambda message: self._call(outbox.push, message)

    @contextlib.contextmanager
    def register_connection(self, role: Role) -> Generator[Outbox]:
        """Register a connection for the duration of the context; yields its outbox."""
        self._events, outbox = asyncio.get_running_loop(), Outbox()
        self._join(outbox, role)
        try:
            yield outbox
        finally:
            self._leave(outbox)

    def close_all_connections(self, reason: str) -> None:
        """Close all connections with this reason. Call it from a thread other than the event loop's."""
        ends_s = time.monotonic() + CLOSE_ALL_TIMEOUT_S
        while self._participant is not None or self._watchers:
            watching = [outbox for _, outbox in self._watchers]
            for outbox in [self._participant, *watching] if self._participant is not None else watching:
                self._call(outbox.close, reason)
            if time.monotonic() > ends_s:
                return
            time.sleep(0.01)

    def close_participant_connection(self) -> None:
        """Close the participant's connection after all queued messages, because the link has expired."""
        self._call(self._dismiss, EXPIRED_LINK_REJECTION)

    def _dismiss(self, why: TokenRejection) -> None:
        if self._participant is not None:
            self._participant.close(why.message, why.close_code)

    def _join(self, outbox: Outbox, role: Role) -> None:
        if role == "participant":
            self._participant = outbox
        else:
            self._watchers = [*self._watchers, (role, outbox)]

    def _leave(self, outbox: Outbox) -> None:
        if outbox is self._participant:
            self._participant = None
        self._watchers = [each for each in self._watchers if each[1] is not outbox]

    def _deliver(self, message: Message, created_s: float) -> None:
        if self._participant is not None and is_message_for_role(message, "participant"):
            self._participant.push(message, created_s)
        for role, watcher in self._watchers:
            if is_message_for_role(message, role):
                watcher.push(message)

    def _call(self, function: Callable[[T], None], told: T) -> None:
        if self._events is not None:
            with contextlib.suppress(RuntimeError):  # the event loop has closed in the meantime
                self._events.call_soon_threadsafe(function, told)
