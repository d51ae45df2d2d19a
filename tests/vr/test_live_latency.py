"""The measurement of live latency: its stages add up, and it measures a real session. No value is asserted."""

import multiprocessing
import os
import time
from contextlib import suppress

import numpy as np
import pytest

from avrgym.vr.benchmark import live_latency
from avrgym.vr.benchmark.cpu_steal import (
    MONITOR_PRIORITY,
    CpuStealMonitor,
    TimeSpan,
    compute_overlap_s,
    find_undisturbed_periods,
    merge_spans,
)
from avrgym.vr.benchmark.live_latency import PERCENTILE_LEVELS, measure_live_latency
from avrgym.vr.server.real_time_loop import LateTick


def test_percentiles_rise_and_are_milliseconds() -> None:
    spread = live_latency._spread(np.arange(101) / 1000.0)
    assert spread == pytest.approx({"p50": 50.0, "p95": 95.0, "p99": 99.0, "max": 100.0})


def test_stages_add_up_to_the_round_trip() -> None:
    times = live_latency._Times()
    trips = {}
    for number in range(10):
        sent = 0.011 * number
        times.arrived[number], times.taken[number] = sent + 0.001, sent + 0.004
        times.answered[number] = sent + 0.006
        trips[number] = (sent, sent + 0.007)
    times.began, times.took = [0.0, 0.01, 0.02], [0.002, 0.003, 0.004]
    times.computed = [0.001, 0.001, 0.002]
    times.late = [LateTick(-0.5, -0.45, 3), LateTick(0.0, 0.012, 0), LateTick(0.01, 0.023, 1)]
    times.stood_still = [(0.004, 0.0065), (0.0235, 0.0236)]
    trips[99] = (1.0, 2.0)
    speed = live_latency._sum_up("avrgym/FeedingJaco-v1", times, trips)
    assert speed.round_trip_ms == pytest.approx(dict.fromkeys(PERCENTILE_LEVELS, 7.0))
    stages = {name: spread["p50"] for name, spread in speed.stages_ms.items()}
    assert stages == pytest.approx({"to_server": 1.0, "queue": 3.0, "tick": 2.0, "return": 1.0})
    assert (speed.rate_hz, speed.seconds, speed.missed_deadlines) == pytest.approx((100.0, 0.03, 3))
    assert speed.missed_running == 2
    assert (speed.tick_ms["max"], speed.processor_ms["max"]) == pytest.approx((4.0, 2.0))
    assert speed.undisturbed_tick_ms is not None
    assert speed.undisturbed_tick_ms["p50"] == pytest.approx(2.5)
    assert speed.undisturbed_round_trip_ms == pytest.approx(speed.round_trip_ms)


@pytest.mark.slow
@pytest.mark.parametrize("policy", [None, "operator"])
def test_a_live_session_is_measured_also_with_a_second_headset(policy: str | None) -> None:
    speed = measure_live_latency("avrgym/FeedingJaco-v1", 1.0, policy)
    assert (speed.steering_ms is not None) == (policy == "operator")
    assert speed.env == "avrgym/FeedingJaco-v1"
    assert speed.rate_hz > 0.0
    assert speed.stolen_s >= 0.0
    assert speed.missed_running is None or 0 <= speed.missed_running <= speed.missed_deadlines
    undisturbed = speed.undisturbed_tick_ms or speed.tick_ms
    assert undisturbed["max"] <= speed.tick_ms["max"]
    for spread in (
        *(speed.tick_ms, undisturbed, speed.processor_ms, speed.round_trip_ms),
        *speed.stages_ms.values(),
        speed.steering_ms or {},
    ):
        assert list(spread.values()) == sorted(spread.values())
        assert all(np.isfinite(list(spread.values())))


def test_a_tick_is_late_by_itself_if_it_is_later_than_processors_stood_still() -> None:
    late = [LateTick(0.0, 0.014, 0), LateTick(0.01, 0.021, 0), LateTick(1.0, 1.015, 0)]

    def by_themselves(*stood_still: TimeSpan) -> list[LateTick]:
        return live_latency._late_running(late, list(stood_still))

    assert by_themselves() == late
    assert by_themselves((0.002, 0.0061), (1.002, 1.0071)) == []
    assert by_themselves((0.002, 0.004), (1.002, 1.0071)) == late[:1]
    assert by_themselves((0.5, 0.9)) == late


def test_spans_of_several_processors_are_merged() -> None:
    spans = merge_spans([(3.0, 4.0), (0.0, 1.0), (0.5, 2.0), (2.0, 2.5)])
    assert spans == [(0.0, 2.5), (3.0, 4.0)]
    assert compute_overlap_s(spans, 1.0, 3.5) == pytest.approx(2.0)
    assert compute_overlap_s(spans, 2.6, 2.9) == 0.0


def test_spans_outside_are_found() -> None:
    spans = [(1.0, 2.0), (3.0, 4.0)]
    began_s, ended_s = np.array([[0.0, 0.9], [0.5, 1.5], [1.2, 1.3], [2.1, 2.9], [2.1, 4.5], [4.1, 5.0]]).T
    assert find_undisturbed_periods(spans, began_s, ended_s).tolist() == [
        True,
        False,
        False,
        True,
        False,
        True,
    ]
    assert find_undisturbed_periods([], began_s, ended_s).all()


@pytest.mark.slow
def test_a_process_that_goes_before_the_watch_stops_a_processor() -> None:
    with CpuStealMonitor() as watch:
        context = multiprocessing.get_context("spawn")
        process = context.Process(target=go_before_all, args=(0.3,))
        process.start()
        process.join()
    if watch.steal_spans is None:
        pytest.skip("needs real-time priority: root, or a limit rtprio")
    assert max(ended_s - began_s for began_s, ended_s in watch.steal_spans) >= 0.25


def go_before_all(seconds: float) -> None:
    with suppress(OSError):  # where that is not allowed there is no watch either
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(MONITOR_PRIORITY + 1))
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        pass


def test_an_unknown_environment_is_named() -> None:
    with pytest.raises(ValueError, match="unknown environment 'avrgym/Flying-v1'"):
        measure_live_latency("avrgym/Flying-v1", 1.0)


def _leave_at_once(*_: object) -> None:
    """A client's process that ends before the trial."""


@pytest.mark.slow
def test_a_client_that_ends_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_latency, "run_client", _leave_at_once)
    with pytest.raises(RuntimeError, match="the client ended in phase waiting"):
        measure_live_latency("avrgym/FeedingJaco-v1", 60.0)
