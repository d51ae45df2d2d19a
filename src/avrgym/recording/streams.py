"""Sample times of streams from other devices: correction of clock resets, number of gaps, and jitter.

The clock of a device can jump (clock reset). Times after a reset are corrected. Corrected times never decrease. Arrival
times on the session's clock distinguish gaps from resets. At a gap, sample times and arrival times both pause. At a
reset, the delay from sample to arrival changes by the size of the jump.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.recording.schema import Stream, StreamSamples
from avrgym.system.columns import Column

MIN_GAP_INTERVALS = 5.0
"""A gap in a regular stream is longer than this number of sample intervals."""
MIN_FORWARD_CLOCK_RESET_S, MIN_BACKWARD_CLOCK_RESET_S = 0.25, 0.05
"""Minimum forward and backward step of sample times that can be a clock reset. A smaller forward step is a gap, a
smaller backward step is jitter."""
MAX_ARRIVAL_DELAY_S = 60.0
"""Maximum plausible delay from sample to arrival: the buffer length of Lab Streaming Layer."""
MIN_JITTER_SAMPLES = 10
"""Minimum number of samples for the computation of jitter."""

MessagesByTopic = Mapping[str, Sequence[tuple[int, Any]]]
"""Messages (log_time_ns, record) of a recording, by topic."""
SampleChunks = Sequence[tuple[int, StreamSamples]]
"""Chunks of one stream's samples, each with its arrival time in nanoseconds on the session's clock."""


@dataclass(frozen=True)
class ClockReset:
    """A jump of a device's clock.

    ``time_s``: corrected time of the first sample after the jump. ``jump_s``: size of the jump; positive if the clock
    jumped forward.
    """

    time_s: float
    jump_s: float


@dataclass(frozen=True, eq=False)
class SampleTimes:
    """Corrected times (n,) of a stream's samples in seconds; they never decrease.

    ``clock_resets``: the corrected clock resets. ``num_corrected_samples``: number of samples with times before the
    previous sample, because of jitter. Their times were increased to that of the previous sample.
    """

    time_s: FloatArray
    clock_resets: tuple[ClockReset, ...]
    num_corrected_samples: int


@dataclass(frozen=True)
class _Segment:
    """A series of samples without a clock reset: ``first`` to ``end`` − 1. ``delay_s`` is the smallest delay from
    sample to arrival.
    """

    first: int
    end: int
    delay_s: float


def correct_sample_times(chunks: SampleChunks, rate_hz: float) -> SampleTimes:
    """Returns the sample times of a stream, corrected for clock resets.

    Args:
        chunks: all samples of the stream in the order of arrival.
        rate_hz: nominal sample rate; 0 for irregular samples.
    """
    given = np.concatenate([np.empty(0), *(np.array(chunk.time_s, float) for _, chunk in chunks)])
    arrived = np.repeat([time_ns / 1e9 for time_ns, _ in chunks], [len(chunk.time_s) for _, chunk in chunks])
    if not len(given):
        return SampleTimes(given, (), 0)
    segments = _segments(given, arrived, rate_hz)
    normal_delay_s = next((each.delay_s for each in segments if _is_plausible(each)), 0.0)
    corrected, resets, lead_s = given.copy(), list[ClockReset](), 0.0
    for each in segments:
        before_s = lead_s
        lead_s = _clock_lead_s(each, given, corrected, normal_delay_s, rate_hz)
        corrected[each.first : each.end] -= lead_s
        if each.first or lead_s:
            resets.append(ClockReset(float(corrected[each.first]), lead_s - before_s))
    rising = np.maximum.accumulate(corrected)
    return SampleTimes(rising, tuple(resets), int((rising > corrected).sum()))


def _is_plausible(segment: _Segment) -> bool:
    return -MIN_FORWARD_CLOCK_RESET_S <= segment.delay_s <= MAX_ARRIVAL_DELAY_S


def _segments(given: FloatArray, arrived: FloatArray, rate_hz: float) -> list[_Segment]:
    """Splits samples at clock resets. ``given`` and ``arrived`` are their sample and arrival times in seconds."""
    steps_s = np.diff(given)
    breaks = np.flatnonzero((steps_s > _gap_s(rate_hz)) | (steps_s < -MIN_BACKWARD_CLOCK_RESET_S)) + 1
    ends = [*breaks.tolist(), len(given)]
    found: list[_Segment] = []
    for first, end in zip([0, *ends], ends, strict=False):
        delay_s = float((arrived - given)[first:end].min())
        before = found[-1] if found else None
        if before is None or _is_reset(before.delay_s, delay_s, steps_s[first - 1], rate_hz):
            found.append(_Segment(first, end, delay_s))
        else:
            found[-1] = _Segment(before.first, end, min(before.delay_s, delay_s))
    return found


def _is_reset(before_s: float, after_s: float, step_s: float, rate_hz: float) -> bool:
    """Returns whether a clock reset explains a change of the smallest delay from ``before_s`` to ``after_s``.

    In irregular streams, a late sample looks like a forward jump of the clock. There, only a negative delay from sample
    to arrival proves a reset.
    """
    if step_s < -MIN_BACKWARD_CLOCK_RESET_S:
        return True
    return before_s - after_s > step_s / 2.0 and (
        rate_hz > 0.0 or after_s < -MIN_FORWARD_CLOCK_RESET_S <= before_s
    )


def _gap_s(rate_hz: float) -> float:
    """Returns the smallest step of sample times that may be a forward jump of the clock, in seconds."""
    return (
        max(MIN_GAP_INTERVALS / rate_hz, MIN_FORWARD_CLOCK_RESET_S)
        if rate_hz > 0.0
        else MIN_FORWARD_CLOCK_RESET_S
    )


def _clock_lead_s(
    segment: _Segment, given: FloatArray, corrected: FloatArray, normal_delay_s: float, rate_hz: float
) -> float:
    """Returns the clock offset of a segment in seconds; positive if the device's clock is ahead.

    If a regular stream continues without a gap, the sample rate determines the offset exactly. Otherwise the offset is
    estimated from arrival times.
    """
    by_arrival_s = normal_delay_s - segment.delay_s
    if not segment.first:
        return 0.0 if _is_plausible(segment) else by_arrival_s
    continued_s = corrected[segment.first - 1] + (1.0 / rate_hz if rate_hz > 0.0 else inf)
    by_rate_s = float(given[segment.first] - continued_s)
    return by_rate_s if abs(by_rate_s - by_arrival_s) <= _gap_s(rate_hz) else by_arrival_s


_UNEVEN = "irregular samples, or too few"


@dataclass(frozen=True)
class StreamQuality:
    """Quality of the sample times of a stream in one trial, after correction of clock resets."""

    stream: Annotated[str, Column("Name of the stream in the study.")]
    kind: Annotated[str, Column("Kind of measurement, as the device reports it.")]
    samples: Annotated[int, Column("Number of recorded samples.", allowed="0 and above")]
    rate_hz: Annotated[float, Column("Nominal sampling rate; 0 for irregular samples.", unit="Hz")]
    measured_hz: Annotated[float, Column("Measured sampling rate.", unit="Hz")]
    offset_ms: Annotated[float, Column("Correction of the device's clock: median over the trial.", unit="ms")]
    offset_range_ms: Annotated[float, Column("Maximum minus minimum of this correction.", unit="ms")]
    jitter_ms: Annotated[
        float | None,
        Column("Standard deviation of sample times about even spacing.", unit="ms", empty=_UNEVEN),
    ]
    gaps: Annotated[int | None, Column("Number of gaps with missing samples.", empty=_UNEVEN)]
    clock_resets: Annotated[int, Column("Number of jumps of the device's clock.", allowed="0 and above")]
    clock_jump_s: Annotated[float, Column("Largest jump of this clock; negative is backwards.", unit="s")]


def collect_streams(topics: MessagesByTopic) -> dict[str, Stream]:
    """Returns the descriptions of a recording's streams, by name of the stream."""
    return {each.name: each for _, each in topics["/streams"]}


def collect_stream_chunks(topics: MessagesByTopic, stream: str) -> SampleChunks:
    """Returns all samples of the stream with this name, with their arrival times."""
    return [(time_ns, chunk) for time_ns, chunk in topics["/samples"] if chunk.stream_name == stream]


def compute_stream_sample_times(topics: MessagesByTopic, stream: str) -> SampleTimes:
    """Returns the sample times of a stream in a recording, corrected for clock resets."""
    described = collect_streams(topics).get(stream)
    return correct_sample_times(
        collect_stream_chunks(topics, stream), described.rate_hz if described else 0.0
    )


def compute_stream_quality(topics: MessagesByTopic) -> list[StreamQuality]:
    """Returns the timing quality of each stream in a recording, in alphabetical order."""
    return [
        _quality(stream, collect_stream_chunks(topics, name), compute_stream_sample_times(topics, name))
        for name, stream in sorted(collect_streams(topics).items())
    ]


def _quality(stream: Stream, chunks: SampleChunks, found: SampleTimes) -> StreamQuality:
    times = found.time_s
    offsets_ms = 1e3 * np.array([chunk.clock_offset_s for _, chunk in chunks] or [0.0])
    lasted_s = float(times[-1] - times[0]) if len(times) > 1 else 0.0
    jitter_s, gaps = _jitter(times, stream.rate_hz)
    return StreamQuality(
        stream=stream.name,
        kind=stream.measurement_type,
        samples=len(times),
        rate_hz=stream.rate_hz,
        measured_hz=(len(times) - 1) / lasted_s if lasted_s > 0.0 else 0.0,
        offset_ms=float(np.median(offsets_ms)),
        offset_range_ms=float(np.ptp(offsets_ms)),
        jitter_ms=None if jitter_s is None else 1e3 * jitter_s,
        gaps=gaps,
        clock_resets=len(found.clock_resets),
        clock_jump_s=max((reset.jump_s for reset in found.clock_resets), key=abs, default=0.0),
    )


def _jitter(times: FloatArray, rate_hz: float) -> tuple[float | None, int | None]:
    """Returns the jitter in seconds and the number of gaps; ``None`` if they are unknown.

    Jitter is the standard deviation of sample times from a straight line, which is fitted to each segment without gaps.
    """
    if rate_hz <= 0.0 or len(times) < MIN_JITTER_SAMPLES:
        return None, None
    breaks = np.flatnonzero(np.diff(times) > MIN_GAP_INTERVALS / rate_hz) + 1
    segments = np.split(times, breaks)
    residuals = [_residuals(segment) for segment in segments if len(segment) >= MIN_JITTER_SAMPLES]
    return (float(np.concatenate(residuals).std()) if residuals else None), len(breaks)


def _residuals(times: FloatArray) -> FloatArray:
    numbers = np.arange(len(times), dtype=float)
    return times - np.polynomial.Polynomial.fit(numbers, times, 1)(numbers)
