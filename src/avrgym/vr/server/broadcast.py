"""Broadcasts what the simulation's thread says to the connections: the participant's one, and any number that watch."""

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Callable, Generator
from typing import TypeVar

from avrgym.vr.protocol.messages import (
    MAX_UNACKNOWLEDGED_STATES,
    Message,
    Problem,
    Role,
    Scene,
    State,
    Status,
    Timing,
    Welcome,
)
from avrgym.vr.server.authentication import LINK_ENDED, Refusal

T = TypeVar("T")

OUTBOX_MESSAGES = 1000
"""What a connection may still have to send; of more, which only floods lead to, the oldest are dropped."""
FOR_WATCHERS_ONLY = (Status, Timing)


def is_for_role(message: Message, role: Role) -> bool:
    """Whether somebody in this role is to get a message."""
    if isinstance(message, Problem):
        return role in ("experimenter", message.role)
    return role != "participant" or not isinstance(message, FOR_WATCHERS_ONLY)


CLOSE_TIMEOUT_S = 1.0
"""How long connections have to hear that the server ends."""


class ConnectionEnd(Exception):
    """A connection has nothing more to send and ends, with the code of its closing, for the reason in words."""

    def __init__(self, reason: str, code: int) -> None:
        super().__init__(reason)
        self.code = code


class Outbox:
    """What one connection still has to send: every message in order, but of states only the newest of the newest scene.

    It begins with the welcome; what was on its way to others before is not for this one. ``made_s`` is when the state
    that was taken last was handed out.

    For a client that draws too slowly, buffers of system and browser would hold the states of a minute. So few are on
    the way at once: the next waits here, and is replaced by newer ones, until the client has received one before.
    """

    def __init__(self) -> None:
        self._messages: deque[Message] = deque(maxlen=OUTBOX_MESSAGES)
        self._state: tuple[State, float] | None = None
        self.made_s = 0.0
        self._sent_states = self._received_states = 0
        self._welcomed = False
        self._farewell: ConnectionEnd | None = None
        self._filled = asyncio.Event()

    def push(self, message: Message, made_s: float = 0.0) -> None:
        """Have a message sent that was handed out at a time."""
        self._welcomed = self._welcomed or isinstance(message, Welcome)
        if not self._welcomed or self._farewell is not None:
            return
        if isinstance(message, State):
            self._state = message, made_s
        else:
            self._messages.append(message)
            self._state = None if isinstance(message, Scene) else self._state
        self._filled.set()

    def receipt(self, states: int) -> None:
        """The client has received so many states."""
        self._received_states = states
        self._filled.set()

    def close(self, reason: str, code: int = 1001) -> None:
        """Let the connection end when all is sent; nothing more is taken."""
        self._farewell = ConnectionEnd(reason, code)
        self._filled.set()

    async def next(self) -> Message:
        """Wait for the message to send next; raises ``ConnectionEnd`` when there will be none."""
        while True:
            if self._messages:
                return self._messages.popleft()
            if (
                self._state is not None
                and self._sent_states < self._received_states + MAX_UNACKNOWLEDGED_STATES
            ):
                self._sent_states += 1
                (state, self.made_s), self._state = self._state, None
                return state
            if self._farewell is not None:
                raise self._farewell
            self._filled.clear()
            await self._filled.wait()


class Broadcast:
    """Hands each message of the simulation's thread to the connections that it is_for_role."""

    def __init__(self) -> None:
        self._events: asyncio.AbstractEventLoop | None = None
        self._participant: Outbox | None = None
        self._watchers: list[tuple[Role, Outbox]] = []

    @property
    def taken(self) -> bool:
        """Whether a participant is connected."""
        return self._participant is not None

    def send(self, message: Message) -> None:
        """Send a message to all whom it is_for_role; called from the simulation's thread."""
        if self._participant is not None or self._watchers:
            self._call(lambda made_s: self._deliver(message, made_s), time.monotonic())

    def sender(self, outbox: Outbox) -> Callable[[Message], None]:
        """Sends to one connection, from the simulation's thread."""
        return lambda message: self._call(outbox.push, message)

    @contextlib.contextmanager
    def connection(self, role: Role) -> Generator[Outbox]:
        """Take a place; gives the outbox to send from."""
        self._events, outbox = asyncio.get_running_loop(), Outbox()
        self._join(outbox, role)
        try:
            yield outbox
        finally:
            self._leave(outbox)

    def close_all(self, reason: str) -> None:
        """End all connections, for a reason in words; from any other thread than theirs."""
        ends_s = time.monotonic() + CLOSE_TIMEOUT_S
        while self._participant is not None or self._watchers:
            watching = [outbox for _, outbox in self._watchers]
            for outbox in [self._participant, *watching] if self._participant is not None else watching:
                self._call(outbox.close, reason)
            if time.monotonic() > ends_s:
                return
            time.sleep(0.01)

    def close_participant(self) -> None:
        """End the participant's connection after all that was sent before, because their link has ended."""
        self._call(self._dismiss, LINK_ENDED)

    def _dismiss(self, why: Refusal) -> None:
        if self._participant is not None:
            self._participant.close(why.words, why.code)

    def _join(self, outbox: Outbox, role: Role) -> None:
        if role == "participant":
            self._participant = outbox
        else:
            self._watchers = [*self._watchers, (role, outbox)]

    def _leave(self, outbox: Outbox) -> None:
        if outbox is self._participant:
            self._participant = None
        self._watchers = [each for each in self._watchers if each[1] is not outbox]

    def _deliver(self, message: Message, made_s: float) -> None:
        if self._participant is not None and is_for_role(message, "participant"):
            self._participant.push(message, made_s)
        for role, watcher in self._watchers:
            if is_for_role(message, role):
                watcher.push(message)

    def _call(self, function: Callable[[T], None], told: T) -> None:
        if self._events is not None:
            with contextlib.suppress(RuntimeError):  # the event loop closed meanwhile
                self._events.call_soon_threadsafe(function, told)
