"""A trial counts only with continuous tracking and time; otherwise it is interrupted and repeated."""

import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import numpy as np
import pytest
from test_live_server import make_server, participant, sit_down
from test_real_time_loop import FakeClock, FakeSession, await_that

from avrgym.recording.reader import Recording, read_recording
from avrgym.recording.schema import TrackingFrame
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import (
    TICK_S,
    ExperimenterCommand,
    ParticipantReady,
    PhaseDescription,
    TrackingFrameMessage,
    WorldStateChange,
)
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.real_time_loop import RealTimeLoop
from avrgym.vr.session import events as read_session_events
from avrgym.vr.session import session
from avrgym.vr.session.session import Session
from avrgym.vr.tracking.tracking_frames import MAX_SEQUENCE_GAP, MIN_RESTART_FRAMES, SequenceFilter
from helpers.studies.small_studies import enrol_with_consent, make_study
from helpers.system.processes import RunningServer, running_server
from helpers.vr.visit import Visit, events, result

FROZEN_TICKS = 1001
LARGEST = 2**53 - 1
"""The largest number that a browser can count to."""


def held(recording: Recording) -> list[bool]:
    return [frame.rejected for _, frame in recording.messages_by_topic["/tracking"]]


# Nobody is tracked -------------------------------------------------------------------------------------------


def test_no_trial_completes_whose_participant_is_not_tracked(visit: Callable[..., Visit]) -> None:
    silent = visit(trial_steps=50)
    silent.go_to("trial")
    silent.tracking = False
    silent.tick(500)
    assert silent.phase == "paused"
    (recording,) = silent.recordings()
    assert result(recording) == "interrupted"
    assert events(recording)[-2:] == ["tracking_timed_out", "robot_holds"]
    last_s = recording.messages_by_topic["/tracking"][-1][1].received_time_s
    holds_s = recording.messages_by_topic["/events"][-1][0] / 1e9
    print(f"\nthe robot holds {holds_s - last_s:.2f} s after the last frame")
    assert 1.0 < holds_s - last_s < 1.0 + 2.5 * TICK_S
    assert silent.session.attempt is None


def test_who_is_no_longer_tracked_is_told_and_the_trial_is_repeated(visit: Callable[..., Visit]) -> None:
    lost = visit(trial_steps=20)
    lost.go_to("trial")
    lost.tracking = False
    lost.tick(130)
    assert "tracking was lost for 1 s" in lost.problems[-1]
    assert "Tracking was lost for 1 s" in lost.received(PhaseDescription)[-1].text
    assert any(isinstance(each, read_session_events.TrackingTimedOut) for each in lost.observed)
    lost.send(ParticipantReady())
    lost.tick()
    assert lost.phase in ("paused", "loading")
    lost.tick(50)
    assert lost.phase == "paused"
    assert len(lost.session.recordings) == 1
    lost.tracking = True
    lost.tick(10)
    lost.send(ParticipantReady())
    lost.run_until("questionnaire")
    lost.answer(4, 4, 4, 4)
    first, second = lost.recordings()
    assert (first.configuration.attempt_number, second.configuration.attempt_number) == (1, 2)
    assert first.configuration.seed == second.configuration.seed
    assert [result(first), result(second)] == ["interrupted", "completed"]


@pytest.mark.parametrize("phase", ["free_before", "countdown"])
def test_no_robot_begins_to_drive_while_nobody_is_tracked(visit: Callable[..., Visit], phase: str) -> None:
    lost = visit(free_movement_s=3.0 if phase == "free_before" else 0.1, countdown_s=3.0)
    lost.go_to(phase)
    lost.tracking = False
    lost.tick(400)
    assert lost.phase == "paused"
    assert "trial" not in lost.phases
    assert result(lost.recordings()[0]) == "interrupted"


def test_the_countdown_waits_for_tracking(visit: Callable[..., Visit]) -> None:
    lost = visit(free_movement_s=0.3)
    lost.go_to("free_before")
    lost.tracking = False
    lost.tick(70)
    assert lost.phase == "countdown"
    lost.tracking = True
    lost.tick(5)
    assert lost.phase == "trial"


def test_a_session_that_goes_on_without_its_participant_waits_for_them(visit: Callable[..., Visit]) -> None:
    away = visit(seeds=(3, 4))
    away.go_to("free_before")
    away.send(ExperimenterCommand(name="pause"))
    away.tracking = False
    away.tick(200)
    for name in ("continue", "repeat", "skip"):
        away.send(ExperimenterCommand(name=name))
        away.tick(20)
        assert away.phase == "paused"
        assert "Tracking is lost" in away.received(PhaseDescription)[-1].text
    assert len(away.session.recordings) == 1


def test_what_the_robot_gave_is_kept_when_tracking_is_lost_after_it_has_finished(
    visit: Callable[..., Visit],
) -> None:
    finished = visit(free_movement_s=3.0)
    finished.go_to("free_after")
    finished.tracking = False
    finished.run_until("questionnaire")
    finished.answer(4, 4, 4, 4)
    assert result(finished.recordings()[0]) == "completed"


@pytest.mark.slow
@pytest.mark.parametrize("answers_pings", [True, False], ids=["frozen page", "half-open socket"])
def test_the_robot_holds_within_a_second_when_a_headset_falls_silent(
    tmp_path: Path, answers_pings: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "MAX_TICK_GAP_S", float("inf"))  # busy machines stand still
    with make_server(tmp_path) as server, participant(server) as client:
        sit_down(client)
        client.await_message(WorldStateChange)
        if not answers_pings:
            client._socket.send_data = lambda: None
        await_that(lambda: server.session.phase_name in ("paused", "waiting"))
        recording = read_recording(server.session.recordings[-1])
    steps = [topic for topic, _, record in recording.messages if topic == "/physics" or is_applied(record)]
    driven_s = TICK_S * (steps[::-1].index("/tracking") - 1)
    print(f"\nthe robot moves on for {driven_s:.2f} s")
    assert driven_s < 1.05
    assert result(recording) == "interrupted"


def is_applied(record: object) -> bool:
    return isinstance(record, TrackingFrame) and record.moved_person


# Frames that are out of order --------------------------------------------------------------------------------


def numbered(frame: TrackingFrameMessage, sequence: int) -> TrackingFrameMessage:
    return msgspec.structs.replace(frame, sequence=sequence)


@pytest.mark.slow
@pytest.mark.parametrize("number", [10**6, LARGEST, 2**63])
def test_a_frame_from_far_ahead_holds_no_others(visit: Callable[..., Visit], number: int) -> None:
    jumped = visit(seeds=(3, 4), trial_steps=20)
    jumped.go_to("trial")
    jumped.send(numbered(jumped.frame(), number))
    jumped.run_until("questionnaire")
    jumped.answer(4, 4, 4, 4)
    jumped.run_until("questionnaire")
    first, second = (held(recording) for recording in [*jumped.recordings()])
    print(f"\n{sum(second)} of {len(second)} frames of the next trial are held")
    assert sum(first) == 1
    assert sum(second) == 0


def test_a_client_that_counts_anew_is_followed_after_ten_frames(visit: Callable[..., Visit]) -> None:
    reloaded = visit(free_movement_s=3.0)
    reloaded.go_to("free_before")
    reloaded.tick(200)
    reloaded.participant._sequence = -1
    reloaded.run_until("countdown")
    reloaded.leave()
    assert sum(held(reloaded.recordings()[0])) == MIN_RESTART_FRAMES - 1


def test_a_stream_in_order_is_followed_whatever_came_before() -> None:
    """2,000 random histories of frames that are repeated, late, far ahead, or of another stream."""
    rng = np.random.default_rng(1)
    for _ in range(2000):
        numbering = SequenceFilter()
        wild = rng.integers(0, 3000, 30) * rng.choice([1, 1, 1, 2**40], 30)
        for number in wild.tolist():
            numbering.accepts(number)
        begins = int(rng.choice([0, 1, 500, 10**6, LARGEST - 50, LARGEST]))
        steps = rng.integers(1, MAX_SEQUENCE_GAP + 1, 40)
        stream = (begins + np.cumsum(steps)).tolist()
        assert all([numbering.accepts(number) for number in stream][MIN_RESTART_FRAMES - 1 :])


def test_no_frame_counts_twice_and_none_that_comes_late() -> None:
    rng = np.random.default_rng(2)
    numbering, newest = SequenceFilter(), -1
    for number in range(0, 20_000, 3):
        late = int(rng.integers(max(0, number - 500), number + 1))
        assert numbering.accepts(number)
        assert not numbering.accepts(number)
        assert not numbering.accepts(late)
        newest = number
    assert newest == 19_998


# Lost time ---------------------------------------------------------------------------------------------------


def freeze(visit: Visit, ticks: int = FROZEN_TICKS) -> None:
    """Let time pass in which the process does not run."""
    visit._ticks += ticks - 1
    visit.tick()


def test_no_trial_completes_in_which_time_was_lost(visit: Callable[..., Visit]) -> None:
    frozen = visit(trial_steps=50)
    frozen.go_to("trial")
    frozen.tick(50)
    freeze(frozen)
    assert frozen.phase == "paused"
    (recording,) = frozen.recordings()
    times_s = np.array([ns for ns, _ in recording.messages_by_topic["/physics"]]) / 1e9
    print(f"\na gap of {1000 * np.diff(times_s).max():.0f} ms")
    assert result(recording) == "interrupted"
    assert events(recording)[-2:] == ["time_lost", "robot_holds"]
    assert recording.messages_by_topic["/events"][-2][1].detail == "the computer was suspended for 10.0 s"
    (lost,) = (each for each in frozen.observed if isinstance(each, read_session_events.TimeLost))
    assert lost.seconds == pytest.approx(FROZEN_TICKS * TICK_S)
    assert "was suspended for 10.0 s" in frozen.problems[-1]
    assert "The computer did not respond" in frozen.received(PhaseDescription)[-1].text
    frozen.tick(5)
    frozen.send(ParticipantReady())
    frozen.run_until("questionnaire")
    frozen.answer(4, 4, 4, 4)
    assert [result(each) for each in frozen.recordings()] == ["interrupted", "completed"]


def test_a_short_pause_of_the_computer_ends_nothing(visit: Callable[..., Visit]) -> None:
    busy = visit(trial_steps=50)
    busy.go_to("trial")
    for _ in range(8):
        freeze(busy, 49)
        busy.tick(20)
    assert busy.phase == "trial"


def test_time_that_is_lost_after_the_robot_has_finished_is_only_noted(visit: Callable[..., Visit]) -> None:
    frozen = visit()
    frozen.go_to("questionnaire")
    freeze(frozen)
    frozen.answer(4, 4, 4, 4)
    (recording,) = frozen.recordings()
    assert result(recording) == "completed"
    assert "time_lost" in events(recording)


@pytest.mark.slow
def test_a_server_that_is_stopped_in_a_trial_says_so_when_it_goes_on(tmp_path: Path) -> None:
    folder = make_study(
        tmp_path / "study",
        tasks='["Feeding"]',
        robots='["Jaco"]',
        practice_policy='""',
        free_movement_s="0.2",
    )
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store)
    with (
        running_server(folder, "--participant", pseudonym) as server,
        participant(address_of(server)) as client,
    ):
        sit_down(client)
        server.process.send_signal(signal.SIGSTOP)
        time.sleep(0.8)
        server.process.send_signal(signal.SIGCONT)
        paused = client.await_message(PhaseDescription, lambda phase: phase.name == "paused")
        assert "The computer did not respond" in paused.text
        client.await_message(WorldStateChange, lambda state: len(stored(folder)) == 2)
    state, lost = stored(folder)
    assert state == "interrupted"
    print(f"\n{lost}")


def stored(folder: Path) -> list[str]:
    """How the ended attempts of a study ended, then what is stored of lost time."""
    time.sleep(0.2)
    with StudyStore(folder) as store:
        ended = [each.state for each in store.read_attempts("sub-001") if each.state != "running"]
        return ended + [event.detail for event in store.read_events() if event.name == "time lost"]


def address_of(server: RunningServer) -> LiveServer:
    """What a client needs to know of a server of another process."""
    port, token = re.findall(r":(\d+)/#token=(.*)", server.participant)[0]
    return cast(LiveServer, SimpleNamespace(port=int(port), tokens=SimpleNamespace(participant=token)))


class SleepyClock(FakeClock):
    """A machine that sleeps: its monotonic clock stands still meanwhile, that since it was started goes on."""

    CLOCK_BOOTTIME = 7

    def __init__(self) -> None:
        super().__init__()
        self.slept_s = 0.0

    def clock_gettime(self, clock: int) -> float:
        assert clock == self.CLOCK_BOOTTIME
        return self.now_s + self.slept_s


def test_a_session_notices_that_its_machine_slept(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SleepyClock()
    monkeypatch.setattr("avrgym.vr.server.real_time_loop.time", clock)

    def sleep(ticks: int) -> None:
        clock.slept_s = 3600.0 * (ticks >= 10)

    session = FakeSession(sleep)
    loop = RealTimeLoop(cast(Session, session))
    loop.start()
    await_that(lambda: len(session.ticked_s) >= 20)
    loop.stop()
    gaps_s = np.diff(session.ticked_s[:20])
    assert gaps_s.max() == pytest.approx(3600.0 + TICK_S)
    assert sorted(gaps_s)[-2] == pytest.approx(TICK_S)
    assert loop.missed_ticks == 0
