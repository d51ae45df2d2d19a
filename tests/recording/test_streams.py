"""The clocks of other devices: jumps do not count as gaps, and times never decrease."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avrgym.array_types import FloatArray
from avrgym.recording.schema import Stream, StreamSamples
from avrgym.recording.streams import (
    MIN_FORWARD_CLOCK_RESET_S,
    MIN_GAP_INTERVALS,
    compute_stream_quality,
    correct_sample_times,
)
from avrgym.study.export.physio import (
    read_numeric_stream_samples,
    read_text_events,
    read_text_stream_time_corrections,
)

RATES_HZ = st.sampled_from([1.0, 10.0, 50.0, 100.0, 512.0])
JUMPS_S = st.one_of(st.floats(0.6, 2.0), st.floats(2.0, 400_000.0)).flatmap(
    lambda size: st.sampled_from([size, -size])
)
PIECE = 60
"""Samples between two things that happen to a stream."""
DELAY_S = 0.02


def chunked(clock_s: FloatArray, taken_s: FloatArray, size: int, late: Sequence[float] = (0.0,)) -> list[Any]:
    """Samples as they are recorded: a chunk arrives after its last sample, some later than others."""
    return [
        (
            round(1e9 * (taken_s[start : start + size][-1] + DELAY_S + late[number % len(late)])),
            StreamSamples(
                "heart",
                0.0,
                clock_s[start : start + size].tolist(),
                [[0.0]] * len(clock_s[start : start + size]),
            ),
        )
        for number, start in enumerate(range(0, len(clock_s), size))
    ]


def figures(chunks: list[Any], rate_hz: float) -> Any:
    topics = {"/streams": [(0, Stream("heart", "Belt", "ECG", rate_hz, ["ecg"], []))], "/samples": chunks}
    (found,) = compute_stream_quality(topics)
    return found


@st.composite
def streams(draw: st.DrawFn) -> tuple[float, FloatArray, FloatArray, list[str], list[Any]]:
    """The rate, true times and those of the device's clock; what happened between pieces; chunks."""
    rate_hz = draw(RATES_HZ)
    pieces = draw(st.lists(st.sampled_from(["gap", "jump"]), max_size=4))
    taken = [np.arange(PIECE) / rate_hz]
    clock = [taken[0]]
    ahead_s = 0.0
    for what in pieces:
        step_s = 1.0 / rate_hz
        if what == "gap":
            step_s *= draw(st.floats(MIN_GAP_INTERVALS + 2.0, 20.0))
            step_s = max(step_s, 2.0 * MIN_FORWARD_CLOCK_RESET_S)
        else:
            ahead_s += draw(JUMPS_S) * max(1.0, 12.0 / rate_hz)
        start_s = taken[-1][-1] + step_s
        taken.append(start_s + np.arange(PIECE) / rate_hz)
        clock.append(taken[-1] + ahead_s)
    late = draw(st.lists(st.floats(0.0, 0.05), min_size=1, max_size=5))
    size = draw(st.integers(1, max(1, round(0.05 * rate_hz))))
    whole, shown = np.concatenate(taken), np.concatenate(clock)
    return rate_hz, whole, shown, pieces, chunked(shown, whole, size, late)


@settings(max_examples=150, deadline=None)
@given(streams())
def test_jumps_are_told_apart_from_gaps_and_times_are_those_of_the_samples(
    drawn: tuple[float, FloatArray, FloatArray, list[str], list[Any]],
) -> None:
    rate_hz, taken_s, clock_s, happened, chunks = drawn
    found = correct_sample_times(chunks, rate_hz)
    assert (np.diff(found.time_s) >= 0.0).all()
    assert len(found.clock_resets) == happened.count("jump")
    np.testing.assert_allclose(found.time_s, taken_s, rtol=0.0, atol=1e-6)
    assert figures(chunks, rate_hz).gaps == happened.count("gap")
    if "jump" not in happened:
        np.testing.assert_array_equal(found.time_s, clock_s)


@settings(max_examples=100, deadline=None)
@given(
    times=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60),
    arrivals=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=10),
    rate_hz=st.sampled_from([0.0, 1.0, 100.0]),
)
def test_whatever_a_device_sends_times_never_decrease(
    times: list[float], arrivals: list[float], rate_hz: float
) -> None:
    parts = np.array_split(np.array(times), len(arrivals))
    chunks = [
        (round(1e9 * at_s), StreamSamples("heart", 0.0, part.tolist(), [[0.0]] * len(part)))
        for at_s, part in zip(sorted(arrivals), parts, strict=True)
    ]
    found = correct_sample_times(chunks, rate_hz)
    assert len(found.time_s) == len(times)
    assert np.isfinite(found.time_s).all()
    assert (np.diff(found.time_s) >= 0.0).all()


@pytest.mark.parametrize("jump_s", [-1.0, 3 * 86_400.0])
def test_marks_at_any_time_are_put_where_they_arrived(jump_s: float) -> None:
    """Late single marks are no jumps; a mark before the one before it, or from the future, is one."""
    taken_s = np.array([0.5, 2.0, 2.4, 7.0, 7.1, 12.0])
    late = (0.0, 0.9, 0.0)
    untouched = correct_sample_times(chunked(taken_s, taken_s, 1, late), 0.0)
    assert untouched.clock_resets == ()
    np.testing.assert_array_equal(untouched.time_s, taken_s)
    clock_s = taken_s + np.where(taken_s > 7.05, jump_s, 0.0)
    found = correct_sample_times(chunked(clock_s, taken_s, 1), 0.0)
    assert [round(reset.jump_s, 1) for reset in found.clock_resets] == [jump_s]
    np.testing.assert_allclose(found.time_s, taken_s, rtol=0.0, atol=0.05)


def test_a_clock_that_is_wrong_from_the_beginning_is_corrected_by_arrivals() -> None:
    taken_s = np.arange(100) / 50.0
    found = correct_sample_times(chunked(taken_s + 86_400.0, taken_s, 5), 50.0)
    assert [round(reset.jump_s) for reset in found.clock_resets] == [86_400]
    np.testing.assert_allclose(found.time_s, taken_s, rtol=0.0, atol=0.1)


def test_jitter_that_steps_back_is_raised_and_no_reset() -> None:
    times_s = np.array([0.00, 0.01, 0.03, 0.02, 0.04])
    found = correct_sample_times(chunked(times_s, times_s, 5), 100.0)
    assert (found.clock_resets, found.num_corrected_samples) == ((), 1)
    assert found.time_s.tolist() == [0.00, 0.01, 0.03, 0.03, 0.04]


def test_exports_contain_corrected_times_and_what_was_corrected() -> None:
    taken_s = np.arange(200) / 100.0
    clock_s = taken_s - np.where(taken_s >= 1.0, 1.0, 0.0)
    heart = Stream("heart", "Belt", "ECG", 100.0, ["ecg"], ["microvolts"])
    said = [
        (1_000_000_000 * second, StreamSamples("button", 0.0, [second - 0.01 + ahead], [], [["pressed"]]))
        for second, ahead in ((1, 0.0), (2, 86_400.0), (3, 86_400.0))
    ]
    topics = {
        "/streams": [(0, heart), (0, Stream("button", "Box", "Markers", 0.0, [], []))],
        "/samples": [*chunked(clock_s, taken_s, 5), *said],
    }
    (series,) = read_numeric_stream_samples(topics, 0.5)
    np.testing.assert_allclose(series.sample_times_s, taken_s - 0.5, rtol=0.0, atol=1e-9)
    (reset,) = series.make_sidecar()["timestamp"]["ClockResets"]
    assert (reset["Onset"], reset["JumpInSeconds"]) == (pytest.approx(0.5), pytest.approx(-1.0))
    assert [round(time_ns / 1e9, 2) for time_ns, _ in read_text_events(topics)] == [0.99, 1.99, 2.99]
    assert len(read_text_stream_time_corrections(topics, 0.5)["button"]["ClockResets"]) == 1
    assert figures(chunked(clock_s, taken_s, 5), 100.0).gaps == 0
