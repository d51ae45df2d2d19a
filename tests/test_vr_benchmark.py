"""The live server's measurement: its parts add up, and it measures a real session. No figure is asserted."""

import numpy as np
import pytest

from avrgym.vr import benchmark
from avrgym.vr.benchmark import PERCENTILES, measure_vr


def test_percentiles_rise_and_are_milliseconds() -> None:
    spread = benchmark._spread(np.arange(101) / 1000.0)
    assert spread == pytest.approx({"p50": 50.0, "p95": 95.0, "p99": 99.0, "max": 100.0})


def test_stages_add_up_to_the_round_trip() -> None:
    times = benchmark._Times()
    trips = {}
    for number in range(10):
        sent = 0.011 * number
        times.arrived[number], times.taken[number] = sent + 0.001, sent + 0.004
        times.answered[number] = sent + 0.006
        trips[number] = (sent, sent + 0.007)
    times.began, times.took = [0.0, 0.01, 0.02], [0.002, 0.003, 0.004]
    times.computed = [0.001, 0.001, 0.002]
    times.missed = [5, 6, 8]
    trips[99] = (1.0, 2.0)
    speed = benchmark._sum_up("avrgym/FeedingJaco-v1", times, trips)
    assert speed.round_trip_ms == pytest.approx(dict.fromkeys(PERCENTILES, 7.0))
    stages = {name: spread["p50"] for name, spread in speed.stages_ms.items()}
    assert stages == pytest.approx({"to_server": 1.0, "queue": 3.0, "tick": 2.0, "return": 1.0})
    assert (speed.rate_hz, speed.seconds, speed.missed_deadlines) == pytest.approx((100.0, 0.03, 3))
    assert (speed.tick_ms["max"], speed.processor_ms["max"]) == pytest.approx((4.0, 2.0))


def test_a_live_session_is_measured() -> None:
    speed = measure_vr("avrgym/FeedingJaco-v1", 1.0)
    assert speed.env == "avrgym/FeedingJaco-v1"
    assert speed.rate_hz > 0.0
    assert speed.stolen_s >= 0.0
    for spread in (speed.tick_ms, speed.processor_ms, speed.round_trip_ms, *speed.stages_ms.values()):
        assert list(spread.values()) == sorted(spread.values())
        assert all(np.isfinite(list(spread.values())))


def test_an_unknown_environment_is_named() -> None:
    with pytest.raises(ValueError, match="unknown environment 'avrgym/Flying-v1'"):
        measure_vr("avrgym/Flying-v1", 1.0)
