"""The real-time control loop: a thread that ticks a session at 100 Hz, independent of the network."""

import gc
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Generic, Protocol, TypeVar

from avrgym.models.human import Person
from avrgym.tasks.settings import Settings
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S, MessageSender, ReceivedMessage
from avrgym.vr.server.cpu_idle import CpuIdlePrevention
from avrgym.vr.server.inbox import MAX_HANDLING_TIME_S, MAX_MESSAGES_PER_TICK, Inbox, NewConnection

TIMING_INTERVAL_TICKS = 100
GARBAGE_COLLECTION_INTERVAL_S = 10.0
"""Interval in seconds of garbage collections, which run only at rest. Automatic collection could delay any tick."""
MAX_CATCH_UP_TICKS = 5
"""Maximum number of late ticks that the loop executes later. If more ticks are late, all of them are skipped."""
MAX_STORED_LATE_TICKS = 10_000
REAL_TIME_PRIORITY = 10
"""Real-time priority of the loop's thread (``SCHED_FIFO``, 1 to 99)."""


@dataclass(frozen=True)
class LateTick:
    """A tick that ended after the next tick was due.

    ``due_s``, ``ended_s``: times in seconds at which it was due and at which it ended, on the monotonic clock.
    ``missed_ticks``: number of ticks that were skipped after it.
    """

    due_s: float
    ended_s: float
    missed_ticks: int


class RealTimeSession(Protocol):
    """Interface of sessions and of the environment viewer, for the real-time loop and the server."""

    @property
    def scenes(self) -> Sequence[tuple[str, Person, Settings]]:
        """(environment, person, settings) of each scene. The index of a scene is the number in its address."""
        ...

    @property
    def is_at_rest(self) -> bool:
        """Whether robot and participant are at rest. A tick may then be some milliseconds late."""
        ...

    def send_initial_state(self, send: MessageSender, role: messages.Role, now_s: float) -> None:
        """Send welcome, scene and phase to a new connection with this role."""
        ...

    def receive(self, message: ReceivedMessage, now_s: float) -> None:
        """Handle a message of a client that arrived at the time ``now_s``."""
        ...

    def tick(self, now_s: float) -> None:
        """Advance by 10 ms. ``now_s``: the time on the loop's clock."""
        ...

    def close(self, now_s: float) -> None:
        """End the session or the viewer."""
        ...


S = TypeVar("S", bound=RealTimeSession)


class RealTimeLoop(Generic[S]):
    """Runs a session in a thread; after ``start`` only this thread accesses the session.

    ``late_ticks``: the most recent late ticks. ``missed_ticks``: the number of skipped ticks. ``error``: the error that
    ended the thread; ``None`` without an error.
    """

    def __init__(self, session: S, send: MessageSender = lambda message: None) -> None:
        """Create the loop. ``send`` receives the durations of the ticks once a second."""
        self.session = session
        self.missed_ticks = 0
        self.late_ticks: deque[LateTick] = deque(maxlen=MAX_STORED_LATE_TICKS)
        self.error: Exception | None = None
        self._send = send
        self._took_s: list[float] = []
        self._collected_s = 0.0
        self._inbox = Inbox()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)

    def start(self) -> None:
        """Start the thread, which calls ``tick`` every 10 ms."""
        self._thread.start()

    def stop(self) -> None:
        """End the session and the thread. A running trial is stored as interrupted."""
        self._stopping.set()
        self._thread.join()

    @property
    def inbox_is_full(self) -> bool:
        """Whether the queue of messages is full. Senders must then wait."""
        return self._inbox.is_full

    def post(self, message: ReceivedMessage) -> None:
        """Pass a message to the session from any thread; see ``Inbox``."""
        self._inbox.put(message)

    def send_initial_state(self, send: MessageSender, role: messages.Role) -> None:
        """Queue a request to send the session's current state to a new connection."""
        self._inbox.put(NewConnection(send, role))

    def _run(self) -> None:
        use_real_time_priority()
        cpu_idle_prevention = CpuIdlePrevention()
        began, due = _clock_s(), time.monotonic()
        try:
            while not self._stopping.is_set():
                now = _clock_s() - began
                self._take_messages(now)
                self.session.tick(now)
                self._send_timing(_clock_s() - began - now)
                self._collect_garbage(now)
                cpu_idle_prevention.set_enabled(not self.session.is_at_rest)
                due = self._wait(due + TICK_S)
        except Exception as error:
            self.error = error
        cpu_idle_prevention.set_enabled(False)
        try:
            self.session.close(_clock_s() - began)
        except Exception as error:
            self.error = self.error or error

    def _take_messages(self, now_s: float) -> None:
        """Handle waiting messages within the time limit of a tick."""
        ends_s = time.monotonic() + MAX_HANDLING_TIME_S
        for _ in range(MAX_MESSAGES_PER_TICK):
            message = self._inbox.get()
            if message is None:
                return
            if isinstance(message, NewConnection):
                self.session.send_initial_state(message.send, message.role, now_s)
            else:
                self.session.receive(message, now_s)
            if time.monotonic() > ends_s:
                return

    def _send_timing(self, took_s: float) -> None:
        self._took_s.append(took_s)
        if len(self._took_s) == TIMING_INTERVAL_TICKS:
            took_ms = [1000.0 * took_s for took_s in self._took_s]
            self._took_s.clear()
            self._send(messages.TickTiming(median(took_ms), max(took_ms), self.missed_ticks))

    def _collect_garbage(self, now_s: float) -> None:
        if self.session.is_at_rest and now_s >= self._collected_s + GARBAGE_COLLECTION_INTERVAL_S:
            self._collected_s = now_s
            gc.collect()

    def _wait(self, due: float) -> float:
        """Sleep until the next tick is due at time ``due``. Returns ``due``, increased by the duration of skipped
        ticks."""
        late = time.monotonic() - due
        if late < 0.0:
            time.sleep(-late)
            return due
        lost = int(late / TICK_S) if late > MAX_CATCH_UP_TICKS * TICK_S else 0
        self.late_ticks.append(LateTick(due - TICK_S, due + late, lost))
        self.missed_ticks += lost
        return due + lost * TICK_S


def _clock_s() -> float:
    """Returns the time in seconds on a clock that continues while the computer is suspended.

    The clock of ``time.monotonic`` continues only on Windows.
    """
    clock = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))
    return time.monotonic() if clock is None else time.clock_gettime(clock)


def use_real_time_priority() -> bool:
    """Give this thread real-time priority. Returns whether the system permits it.

    Requires Linux, and root or the limit ``rtprio``. A computer with a single processor is excluded, because the thread
    would block all others.
    """
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) == 1:
        return False
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # child threads have normal priority
        os.sched_setscheduler(0, policy, os.sched_param(REAL_TIME_PRIORITY))
    except OSError:
        return False
    return True
