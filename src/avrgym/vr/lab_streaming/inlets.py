"""A stream that comes in: found, received and lost on a thread of its own."""

import threading
from collections import deque
from collections.abc import Iterator
from typing import Any

import pylsl
from pylsl.util import LostError

from avrgym.array_types import NumpyArray
from avrgym.recording.schema import Stream, StreamSamples

FIND_S = 1.0
"""How long each search for a stream lasts."""
OPEN_S = 5.0
"""How long a stream that was found may take to answer."""
CHUNK_S = 0.05
"""How long samples are collected before they are handed on: in pieces so small that no tick has to wait for one."""
CHUNK_SAMPLES = 4096
CHUNKS_KEPT = 600
"""How many chunks wait to be taken; of more the oldest are dropped."""
BUFFER_S = 60
SILENT_S, SILENT_INTERVALS = 1.0, 5.0
"""A stream of a regular rate is lost when nothing has come for so long, and for so many of its intervals."""


class Inlet:
    """Receives the stream that answers a query, and searches it again whenever it is lost.

    Samples come with times on Lab Streaming Layer's clock here: its correction has been added.
    """

    def __init__(self, name: str, query: str) -> None:
        """Begin to search."""
        self.name = name
        self.present = False
        self._query = query
        self._chunks: deque[tuple[Stream, StreamSamples]] = deque(maxlen=CHUNKS_KEPT)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"stream {name}", daemon=True)
        self._thread.start()

    def take(self) -> list[tuple[Stream, StreamSamples]]:
        """The chunks that have come since the last call."""
        return [self._chunks.popleft() for _ in range(len(self._chunks))]

    def stop(self) -> None:
        """Receive no more; ``join`` waits until that is so."""
        self._stopping.set()

    def join(self) -> None:
        """Wait for the thread, which looks up several times a second but while it opens a stream."""
        self._thread.join(OPEN_S)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                for found in pylsl.resolve_bypred(self._query, 1, FIND_S)[:1]:
                    self._listen(pylsl.StreamInlet(found, BUFFER_S, recover=False))
            except (LostError, RuntimeError, TimeoutError):  # gone, or not to be opened: search again
                self._stopping.wait(CHUNK_S)
            self.present = False

    def _listen(self, inlet: pylsl.StreamInlet) -> None:
        info = inlet.info(OPEN_S)
        kind = "texts" if info.channel_format() == pylsl.cf_string else "values"
        stream = describe(self.name, info)
        inlet.time_correction(OPEN_S)
        inlet.open_stream(OPEN_S)
        for samples, times_s in self._chunks_of(inlet, stream.rate_hz):
            offset_s = inlet.time_correction(OPEN_S)
            corrected_s = (times_s + offset_s).tolist()
            chunk = StreamSamples(stream.stream, offset_s, corrected_s, **{kind: _plain(samples)})
            self._chunks.append((stream, chunk))

    def _chunks_of(self, inlet: pylsl.StreamInlet, rate_hz: float) -> Iterator[tuple[NumpyArray, NumpyArray]]:
        """What comes, and its times on the device's clock; meanwhile ``present`` says whether the stream is silent."""
        patience_s = max(SILENT_S, SILENT_INTERVALS / rate_hz) if rate_hz > 0.0 else float("inf")
        silent_since_s = pylsl.local_clock()
        while not self._stopping.is_set():
            samples, times_s = inlet.pull_chunk(CHUNK_S, CHUNK_SAMPLES, as_numpy=True)
            now_s = pylsl.local_clock()
            if len(times_s):
                silent_since_s = now_s
                yield samples, times_s
            self.present = now_s - silent_since_s < patience_s


def describe(name: str, info: pylsl.StreamInfo) -> Stream:
    """A stream as recordings describe it."""
    return Stream(
        stream=name,
        source=info.name(),
        kind=info.type(),
        rate_hz=info.nominal_srate(),
        channels=_words(info.get_channel_labels()),
        units=_words(info.get_channel_units()),
    )


def _plain(samples: NumpyArray) -> list[list[Any]]:
    """Numbers as such; texts, which come as bytes, as what can be read of them."""
    if samples.dtype != object:
        return samples.tolist()
    return [[text.decode(errors="replace") for text in row] for row in samples]


def _words(of_channels: list[str | None] | None) -> list[str]:
    return [word or "" for word in of_channels or ()]
