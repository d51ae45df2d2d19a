"""The real-time loop with a fake session: ticks, messages and end."""

import os
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    ExperimenterCommand,
    ParticipantDisconnected,
    ParticipantReady,
    Stop,
    TrackingFrameMessage,
    VrEntered,
)
from avrgym.vr.server.inbox import (
    MAX_HANDLING_TIME_S,
    MAX_MESSAGES_PER_TICK,
    MAX_WAITING_FRAMES,
    MAX_WAITING_MESSAGES,
)
from avrgym.vr.server.real_time_loop import (
    GARBAGE_COLLECTION_INTERVAL_S,
    MAX_CATCH_UP_TICKS,
    REAL_TIME_PRIORITY,
    RealTimeLoop,
)
from avrgym.vr.session.session import Session

PATIENCE_S = 30.0


class FakeSession:
    """Notes what it is given; ``busy`` runs within every tick, with the number of ticks so far."""

    def __init__(self, busy: Callable[[int], None] = lambda ticks: None) -> None:
        self.ticked_s: list[float] = []
        self.received: list[object] = []
        self.closed_s: list[float] = []
        self.is_at_rest = False
        self._busy = busy

    def tick(self, now_s: float) -> None:
        self.ticked_s.append(now_s)
        self._busy(len(self.ticked_s))

    def receive(self, message: object, now_s: float) -> None:
        self.received.append(message)

    def send_initial_state(self, send: object, role: str, now_s: float) -> None:
        self.received.append(role)

    def close(self, now_s: float) -> None:
        self.closed_s.append(now_s)


class FakeClock:
    """A clock that only sleeping and work move on."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0.0
        self.now_s += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    """Time as the loop sees it."""
    clock = FakeClock()
    monkeypatch.setattr("avrgym.vr.server.real_time_loop.time", clock)
    return clock


def run(session: FakeSession, ticks: int) -> RealTimeLoop:
    """A loop that has ticked at least so often and stopped."""
    loop = RealTimeLoop(cast(Session, session))
    loop.start()
    await_that(lambda: len(session.ticked_s) >= ticks)
    loop.stop()
    return loop


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says how a thread is scheduled")
def test_only_the_loops_thread_has_real_time_priority() -> None:
    def scheduled() -> int:
        return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK

    found: list[int] = []

    def busy(ticks: int) -> None:
        with ThreadPoolExecutor(1) as child:
            found.extend((scheduled(), child.submit(scheduled).result()))

    run(FakeSession(busy), 1)
    assert found[:2] == [highest_allowed(), os.SCHED_OTHER]
    assert scheduled() == os.SCHED_OTHER


def highest_allowed() -> int:
    """How the system lets a thread of this process be scheduled."""

    def ask() -> int:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
        except OSError:
            return os.SCHED_OTHER
        return os.sched_getscheduler(0) if len(os.sched_getaffinity(0)) > 1 else os.SCHED_OTHER

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(ask).result()


def await_that(condition: Callable[[], bool]) -> None:
    discard_attempt = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < discard_attempt
        time.sleep(0.001)


def test_it_ticks_every_10_ms_independent_of_the_work(clock: FakeClock) -> None:
    session = FakeSession(lambda ticks: clock.sleep(0.001 * (ticks % 9)))
    loop = run(session, 100)
    assert session.ticked_s[:100] == pytest.approx([i * TICK_S for i in range(100)])
    assert loop.missed_ticks == len(loop.late_ticks) == 0


def test_it_hurries_after_a_short_delay(clock: FakeClock) -> None:
    late_s = 0.9 * MAX_CATCH_UP_TICKS * TICK_S
    session = FakeSession(lambda ticks: clock.sleep(late_s if ticks == 10 else 0.0))
    loop = run(session, 30)
    due = [i * TICK_S for i in range(30)]
    assert session.ticked_s[:10] == pytest.approx(due[:10])
    assert session.ticked_s[10] == pytest.approx(due[9] + late_s)
    assert session.ticked_s[15:30] == pytest.approx(due[15:])
    assert loop.missed_ticks == 0
    assert len(loop.late_ticks) == MAX_CATCH_UP_TICKS - 1
    assert [tick.ended_s - tick.due_s - TICK_S for tick in loop.late_ticks] == pytest.approx(
        [late_s - (i + 1) * TICK_S for i in range(MAX_CATCH_UP_TICKS - 1)]
    )


def test_it_sends_tick_durations_once_a_second(clock: FakeClock) -> None:
    session, told = FakeSession(lambda ticks: clock.sleep(0.004 if ticks == 50 else 0.001)), []
    loop = RealTimeLoop(cast(Session, session), told.append)
    loop.start()
    await_that(lambda: len(told) >= 3)
    loop.stop()
    first, second = told[:2]
    assert (first.tick_ms_median, first.tick_ms_max, first.missed_ticks) == pytest.approx((1.0, 4.0, 0))
    assert second.tick_ms_max == pytest.approx(1.0)


def test_it_skips_and_counts_ticks_after_a_long_delay(clock: FakeClock) -> None:
    session = FakeSession(lambda ticks: clock.sleep(1.003 if ticks == 10 else 0.0))
    loop = run(session, 30)
    assert loop.missed_ticks == 99
    assert [tick.missed_ticks for tick in loop.late_ticks] == [99]
    assert session.ticked_s[12:30] == pytest.approx([(i + 99) * TICK_S for i in range(12, 30)])


def test_garbage_is_collected_only_at_rest(clock: FakeClock, monkeypatch: pytest.MonkeyPatch) -> None:
    def rest(ticks: int) -> None:
        session.is_at_rest = ticks > 2000

    session, collected = FakeSession(rest), []
    monkeypatch.setattr(
        "avrgym.vr.server.real_time_loop.gc", SimpleNamespace(collect=lambda: collected.append(clock.now_s))
    )
    run(session, 5000)
    assert collected[0] == pytest.approx(100.0 + 2000 * TICK_S)
    assert np.diff(collected).min() >= GARBAGE_COLLECTION_INTERVAL_S
    assert len(collected) >= 3


def test_real_time_passes() -> None:
    began = time.monotonic()
    session = FakeSession()
    loop = run(session, 20)
    assert time.monotonic() - began >= 19 * TICK_S
    assert session.ticked_s[-1] <= session.closed_s[0]
    assert session.ticked_s[0] < 1.0
    assert loop.error is None


def test_messages_reach_the_session_in_order() -> None:
    session = FakeSession()
    loop = RealTimeLoop(cast(Session, session))
    sent = [Answer(item=str(i), value=1, response_time_s=0.0) for i in range(50)]
    loop.post(ParticipantReady())
    loop.send_initial_state(lambda message: None, "participant")
    loop.start()
    for message in sent:
        loop.post(message)
    loop.post(ParticipantDisconnected())
    await_that(lambda: len(session.received) == 53)
    loop.stop()
    assert session.received == [ParticipantReady(), "participant", *sent, ParticipantDisconnected()]


def test_a_flooding_sender_must_wait() -> None:
    session = FakeSession()
    loop = RealTimeLoop(cast(Session, session))
    assert not loop.inbox_is_full
    for _ in range(MAX_WAITING_MESSAGES):
        loop.post(ParticipantReady())
    assert loop.inbox_is_full
    loop.start()
    await_that(lambda: not loop.inbox_is_full)
    await_that(lambda: len(session.received) == MAX_WAITING_MESSAGES)
    loop.stop()


def test_messages_take_limited_time_of_a_tick_and_stops_come_first(clock: FakeClock) -> None:
    """Messages that take 0.4 ms each, as those do who enter again and again."""
    session, received_at = FakeSession(), []

    def receive(message: object, now_s: float) -> None:
        clock.sleep(0.0004)
        session.received.append(message)
        received_at.append(now_s)

    session.receive = receive  # type: ignore[method-assign]
    loop = RealTimeLoop(cast(Session, session))
    for _ in range(300):
        loop.post(VrEntered())
    loop.post(ExperimenterCommand(name="stop"))
    loop.post(Stop())
    loop.start()
    await_that(lambda: len(session.received) == 302)
    loop.stop()
    assert session.received[:2] == [ExperimenterCommand(name="stop"), Stop()]
    assert received_at[0] == received_at[1] == session.ticked_s[0]
    assert max(Counter(received_at).values()) <= MAX_HANDLING_TIME_S / 0.0004 + 1
    assert loop.missed_ticks == len(loop.late_ticks) == 0


def test_of_many_frames_the_newest_count(clock: FakeClock) -> None:
    session = FakeSession()
    loop = RealTimeLoop(cast(Session, session))
    for sequence in range(3 * MAX_WAITING_FRAMES):
        loop.post(
            TrackingFrameMessage(
                sequence=sequence,
                client_time_ms=0.0,
                head=None,
                left=None,
                right=None,
                left_modality="none",
                right_modality="none",
            )
        )
    loop.start()
    await_that(lambda: len(session.received) == MAX_WAITING_FRAMES)
    loop.stop()
    received = [cast(TrackingFrameMessage, message).sequence for message in session.received]
    assert received == list(range(2 * MAX_WAITING_FRAMES, 3 * MAX_WAITING_FRAMES))


def test_a_disconnection_discards_waiting_messages(clock: FakeClock) -> None:
    session = FakeSession()
    loop = RealTimeLoop(cast(Session, session))
    for _ in range(MAX_MESSAGES_PER_TICK):
        loop.post(VrEntered())
    loop.post(ExperimenterCommand(name="end"))
    loop.post(ParticipantDisconnected())
    loop.start()
    await_that(lambda: len(session.received) == 2)
    loop.stop()
    assert session.received == [ParticipantDisconnected(), ExperimenterCommand(name="end")]


def test_an_error_at_the_end_is_stored() -> None:
    def fail(now_s: float) -> None:
        raise OSError("the disk is full")

    session = FakeSession()
    session.close = fail  # type: ignore[method-assign]
    loop = RealTimeLoop(cast(Session, session))
    loop.start()
    loop.stop()
    assert str(loop.error) == "the disk is full"


def test_an_error_is_stored_and_ends_the_session() -> None:
    def fail(ticks: int) -> None:
        if ticks == 3:
            raise ValueError("nonsense")

    session = FakeSession(fail)
    loop = RealTimeLoop(cast(Session, session))
    loop.start()
    await_that(lambda: bool(session.closed_s))
    loop.stop()
    assert str(loop.error) == "nonsense"
    assert len(session.ticked_s) == 3
    assert len(session.closed_s) == 1


def test_it_ends_the_session_when_it_is_stopped() -> None:
    session = FakeSession()
    loop = run(session, 3)
    ticks = len(session.ticked_s)
    assert len(session.closed_s) == 1
    assert loop.error is None
    time.sleep(5 * TICK_S)
    assert len(session.ticked_s) == ticks
