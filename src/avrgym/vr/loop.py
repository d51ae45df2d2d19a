"""The real-time loop: a thread that ticks a session at 100 Hz, whatever the network does."""

import threading
import time
from collections import deque
from typing import Generic, Protocol, TypeVar

from avrgym.models.human import Person
from avrgym.vr import messages
from avrgym.vr.session import Disconnected
from avrgym.vr.world import TICK_S

CATCH_UP_TICKS = 5
"""How far the loop may run behind before it gives up the lost ticks instead of hurrying after them."""
INBOX_MESSAGES = 1000
"""How many messages may wait for the next tick; no headset sends as many in ten seconds."""


class Runnable(Protocol):
    """What a loop can run and a server can serve: a participant's session, or an environment on show.

    ``scenes`` holds environment and person of each scene that the client was told of, by the number in its address.
    """

    scenes: list[tuple[str, Person]]

    def greet(self) -> None:
        """Tell a client that has just connected where things stand."""
        ...

    def receive(self, message: messages.ClientMessage | Disconnected, now_s: float) -> None:
        """Take a message of the client."""
        ...

    def tick(self, now_s: float) -> None:
        """Advance by 10 ms."""
        ...

    def close(self, now_s: float) -> None:
        """End."""
        ...


S = TypeVar("S", bound=Runnable)


class RealTimeLoop(Generic[S]):
    """Owns a session while it runs: after ``start`` only its thread touches it."""

    def __init__(self, session: S) -> None:
        self.session = session
        self.missed_ticks = 0
        self.error: BaseException | None = None
        self._inbox: deque[messages.ClientMessage | Disconnected | None] = deque()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)

    def start(self) -> None:
        """Begin to tick."""
        self._thread.start()

    def stop(self) -> None:
        """End the session and the thread; a running trial is kept as interrupted."""
        self._stopping.set()
        self._thread.join()

    @property
    def full(self) -> bool:
        """Whether so many messages wait that their sender should too."""
        return len(self._inbox) >= INBOX_MESSAGES

    def post(self, message: messages.ClientMessage | Disconnected) -> None:
        """Hand over a message from any thread; none is ever dropped."""
        self._inbox.append(message)

    def greet(self) -> None:
        """Have the session tell a new connection where things stand."""
        self._inbox.append(None)

    def _run(self) -> None:
        began = time.monotonic()
        due = began
        try:
            while not self._stopping.is_set():
                now = time.monotonic() - began
                self._take_messages(now)
                self.session.tick(now)
                due = self._wait(due + TICK_S)
        except BaseException as error:
            self.error = error
            raise
        finally:
            self.session.close(time.monotonic() - began)

    def _take_messages(self, now_s: float) -> None:
        for _ in range(len(self._inbox)):
            message = self._inbox.popleft()
            if message is None:
                self.session.greet()
            else:
                self.session.receive(message, now_s)

    def _wait(self, due: float) -> float:
        """Sleep until the next tick is due; return when it is due, moved on if the loop fell far behind."""
        late = time.monotonic() - due
        if late < 0.0:
            time.sleep(-late)
        elif late > CATCH_UP_TICKS * TICK_S:
            lost = int(late / TICK_S)
            self.missed_ticks += lost
            return due + lost * TICK_S
        return due
