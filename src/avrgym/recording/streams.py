"""Streams of other devices: which of them a session takes, and how well their samples lie in time."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.recording.records import Stream
from avrgym.recording.stream_clocks import GAP_INTERVALS, Chunks, SampleTimes, sample_times

NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,39}")
"""A stream's name also stands in the names of files."""
QUERY = re.compile(r"{one}( and {one})*".format(one=r"(name|type|source_id|hostname)='[^'<>&\"]{1,80}'"))
QUERIES = "name='…', type='…', source_id='…' or hostname='…', several of them joined by \"and\""
FEWEST = 10
"""Of fewer samples nothing is said about jitter."""

Topics = Mapping[str, Sequence[tuple[int, Any]]]


class StreamChoice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a session exchanges with other devices by Lab Streaming Layer.

    ``send``: events, poses and forces go out. ``receive``: a query for each stream that comes in, by its name.
    """

    send: bool = False
    receive: Mapping[str, str] = {}


def stream_fault(name: str, query: str) -> str:
    """What is wrong with a stream to be received and what is allowed; empty where nothing is."""
    if not NAME.fullmatch(name):
        return f"{name!r} is no name of a stream; allowed: a letter, then up to 39 letters and digits"
    return "" if QUERY.fullmatch(query) else f"{query!r} finds no stream; allowed: {QUERIES}"


def stream_choice(send: bool, received: Sequence[str]) -> StreamChoice:
    """The choice that options of a command make; ``ValueError`` for one that is not ``NAME=QUERY``."""
    receive = dict(_named(each) for each in received)
    return StreamChoice(send, receive)


def _named(option: str) -> tuple[str, str]:
    name, _, query = option.partition("=")
    fault = stream_fault(name, query)
    if fault:
        raise ValueError(f"--receive {option}: {fault}, as in --receive \"heart=type='ECG'\"")
    return name, query


@dataclass(frozen=True)
class StreamFigures:
    """How well the samples of a stream lie in time in one trial.

    ``rate_hz`` is what the device promises, 0 for samples at any time; ``measured_hz`` what came. ``offset_ms`` is the
    median of what was added to the device's clock, ``offset_range_ms`` from its least to its most. ``jitter_ms`` is
    the standard deviation of times about even spacing between gaps, ``gaps`` counts these; ``None`` where spacing is
    not even or samples are few. ``clock_resets`` counts jumps of the device's clock, ``clock_jump_s`` is the furthest;
    all other figures are of corrected times.
    """

    stream: str
    kind: str
    samples: int
    rate_hz: float
    measured_hz: float
    offset_ms: float
    offset_range_ms: float
    jitter_ms: float | None
    gaps: int | None
    clock_resets: int
    clock_jump_s: float


def described_streams(topics: Topics) -> dict[str, Stream]:
    """The streams in a recording, by its topics and their names."""
    return {each.stream: each for _, each in topics["/streams"]}


def chunks_of(topics: Topics, stream: str) -> Chunks:
    """The samples of a stream, with the times of their arrival."""
    return [(time_ns, chunk) for time_ns, chunk in topics["/samples"] if chunk.stream == stream]


def times_of(topics: Topics, stream: str) -> SampleTimes:
    """When the samples of a stream were taken, corrected where its clock jumped."""
    described = described_streams(topics).get(stream)
    return sample_times(chunks_of(topics, stream), described.rate_hz if described else 0.0)


def stream_figures(topics: Topics) -> list[StreamFigures]:
    """Of each stream in a recording, by its topics; in the order of their names."""
    return [
        _figures(stream, chunks_of(topics, name), times_of(topics, name))
        for name, stream in sorted(described_streams(topics).items())
    ]


def _figures(stream: Stream, chunks: Chunks, found: SampleTimes) -> StreamFigures:
    times = found.time_s
    offsets_ms = 1e3 * np.array([chunk.offset_s for _, chunk in chunks] or [0.0])
    lasted_s = float(times[-1] - times[0]) if len(times) > 1 else 0.0
    jitter_s, gaps = _evenness(times, stream.rate_hz)
    return StreamFigures(
        stream=stream.stream,
        kind=stream.kind,
        samples=len(times),
        rate_hz=stream.rate_hz,
        measured_hz=(len(times) - 1) / lasted_s if lasted_s > 0.0 else 0.0,
        offset_ms=float(np.median(offsets_ms)),
        offset_range_ms=float(np.ptp(offsets_ms)),
        jitter_ms=None if jitter_s is None else 1e3 * jitter_s,
        gaps=gaps,
        clock_resets=len(found.resets),
        clock_jump_s=max((reset.jump_s for reset in found.resets), key=abs, default=0.0),
    )


def _evenness(times: FloatArray, rate_hz: float) -> tuple[float | None, int | None]:
    """The deviation from the straight line through each stretch without a gap, and the number of gaps."""
    if rate_hz <= 0.0 or len(times) < FEWEST:
        return None, None
    breaks = np.flatnonzero(np.diff(times) > GAP_INTERVALS / rate_hz) + 1
    stretches = np.split(times, breaks)
    residuals = [_residuals(stretch) for stretch in stretches if len(stretch) >= FEWEST]
    return (float(np.concatenate(residuals).std()) if residuals else None), len(breaks)


def _residuals(times: FloatArray) -> FloatArray:
    numbers = np.arange(len(times), dtype=float)
    return times - np.polynomial.Polynomial.fit(numbers, times, 1)(numbers)
