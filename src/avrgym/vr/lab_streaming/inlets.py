"""Receives streams of Lab Streaming Layer, each in its own thread."""

import threading
from collections import deque
from collections.abc import Iterator
from typing import Any

import pylsl
from pylsl.util import LostError

from avrgym.array_types import NumpyArray
from avrgym.recording.schema import Stream, StreamSamples

STREAM_SEARCH_DURATION_S = 1.0
"""Duration of one search for a stream, in seconds."""
REQUEST_TIMEOUT_S = 5.0
"""Timeout of requests to a stream, in seconds."""
MAX_CHUNK_DURATION_S = 0.05
"""Maximum duration in seconds of a chunk of samples. Short chunks do not delay ticks."""
MAX_CHUNK_SAMPLES = 4096
"""Maximum number of samples in a chunk."""
MAX_QUEUED_CHUNKS = 600
"""Maximum number of chunks in the queue. If it is full, the oldest chunks are dropped."""
RECEIVE_BUFFER_DURATION_S = 60
"""Duration in seconds of the samples in the receive buffer."""
SILENCE_TIMEOUT_S, SILENCE_TIMEOUT_INTERVALS = 1.0, 5.0
"""Time in seconds, and number of sample intervals, without samples. After both, a stream with a fixed rate is
considered lost."""


class Inlet:
    """Receives the stream that matches a query. If the stream is lost, the inlet searches for it again.

    Time stamps are corrected to the local clock of Lab Streaming Layer.
    """

    def __init__(self, name: str, query: str) -> None:
        """Start to search for the stream. ``name``: name of the stream in the study. ``query``: query that the stream
        matches."""
        self.name = name
        self.is_available = False
        self._query = query
        self._chunks: deque[tuple[Stream, StreamSamples]] = deque(maxlen=MAX_QUEUED_CHUNKS)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"stream {name}", daemon=True)
        self._thread.start()

    def pop_samples(self) -> list[tuple[Stream, StreamSamples]]:
        """Returns the chunks that have arrived since the last call, and removes them."""
        return [self._chunks.popleft() for _ in range(len(self._chunks))]

    def stop(self) -> None:
        """Requests the end of the thread. ``join`` waits for the end."""
        self._stopping.set()

    def join(self) -> None:
        """Wait until the thread ends, at most ``REQUEST_TIMEOUT_S`` seconds."""
        self._thread.join(REQUEST_TIMEOUT_S)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                for found in pylsl.resolve_bypred(self._query, 1, STREAM_SEARCH_DURATION_S)[:1]:
                    self._listen(pylsl.StreamInlet(found, RECEIVE_BUFFER_DURATION_S, recover=False))
            except (LostError, RuntimeError, TimeoutError):  # lost, or not available: search again
                self._stopping.wait(MAX_CHUNK_DURATION_S)
            self.is_available = False

    def _listen(self, inlet: pylsl.StreamInlet) -> None:
        info = inlet.info(REQUEST_TIMEOUT_S)
        kind = "texts" if info.channel_format() == pylsl.cf_string else "values"
        stream = describe_stream(self.name, info)
        inlet.time_correction(REQUEST_TIMEOUT_S)
        inlet.open_stream(REQUEST_TIMEOUT_S)
        for samples, times_s in self._chunks_of(inlet, stream.rate_hz):
            offset_s = inlet.time_correction(REQUEST_TIMEOUT_S)
            corrected_s = (times_s + offset_s).tolist()
            chunk = StreamSamples(stream.name, offset_s, corrected_s, **{kind: _plain(samples)})
            self._chunks.append((stream, chunk))

    def _chunks_of(self, inlet: pylsl.StreamInlet, rate_hz: float) -> Iterator[tuple[NumpyArray, NumpyArray]]:
        """Yields chunks of samples and their times on the device's clock. Updates ``is_available``."""
        patience_s = (
            max(SILENCE_TIMEOUT_S, SILENCE_TIMEOUT_INTERVALS / rate_hz) if rate_hz > 0.0 else float("inf")
        )
        silent_since_s = pylsl.local_clock()
        while not self._stopping.is_set():
            samples, times_s = inlet.pull_chunk(MAX_CHUNK_DURATION_S, MAX_CHUNK_SAMPLES, as_numpy=True)
            now_s = pylsl.local_clock()
            if len(times_s):
                silent_since_s = now_s
                yield samples, times_s
            self.is_available = now_s - silent_since_s < patience_s


def describe_stream(name: str, info: pylsl.StreamInfo) -> Stream:
    """Returns the description of a stream for recordings: name, type, rate and channels."""
    return Stream(
        name=name,
        device_name=info.name(),
        measurement_type=info.type(),
        rate_hz=info.nominal_srate(),
        channels=_words(info.get_channel_labels()),
        units=_words(info.get_channel_units()),
    )


def _plain(samples: NumpyArray) -> list[list[Any]]:
    """Returns samples as lists of numbers, or as lists of decoded text."""
    if samples.dtype != object:
        return samples.tolist()
    return [[text.decode(errors="replace") for text in row] for row in samples]


def _words(of_channels: list[str | None] | None) -> list[str]:
    return [word or "" for word in of_channels or ()]
