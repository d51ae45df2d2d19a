"""Streams of a session over Lab Streaming Layer (https://labstreaminglayer.org). Needs the extra ``lsl``."""

from collections.abc import Generator, Mapping
from contextlib import contextmanager

import msgspec
import pylsl

from avrgym.recording.schema import Stream, StreamSamples
from avrgym.vr.lab_streaming.inlets import Inlet
from avrgym.vr.lab_streaming.outlets import Outlets
from avrgym.vr.lab_streaming.stream_settings import StreamSettings
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.session.events import SessionEvent

MAX_CLOCK_DRIFT_S = 1e-6
"""Maximum drift in seconds per tick between the session's clock and Lab Streaming Layer's clock. On one computer, the
actual drift is smaller."""


class LabStreams:
    """The streams of a session over Lab Streaming Layer. Implements ``session.device_streams.DeviceStreams``.

    The session passes the start time of its tick, which is earlier than the call. The call with the smallest delay
    therefore determines the offset between both clocks.
    """

    def __init__(self, choice: StreamSettings) -> None:
        """Create the sent streams, and start the search for the received streams."""
        self._clock_offset_s: float | None = None
        self._inlets = [Inlet(name, query) for name, query in choice.receive.items()]
        self._outlets = Outlets() if choice.send else None

    @property
    def stream_availability(self) -> Mapping[str, bool]:
        """Whether each received stream is available, by stream name."""
        return {inlet.name: inlet.is_available for inlet in self._inlets}

    def pop_samples(self, now_s: float) -> list[tuple[Stream, StreamSamples]]:
        """Returns the samples that have arrived since the last call, with times on the session's clock."""
        clock_offset_s = self._clock_offset_s = self._aligned(now_s)
        return [
            (stream, _later(samples, clock_offset_s))
            for inlet in self._inlets
            for stream, samples in inlet.pop_samples()
        ]

    def send_event(self, event: SessionEvent) -> None:
        """Send an event. Before the session's first tick, its time stamp is the time of this call."""
        if self._outlets is None:
            return
        if self._clock_offset_s is None or event.time_s == 0.0:
            self._outlets.send_event(event, pylsl.local_clock())
        else:
            self._outlets.send_event(event, event.time_s - self._clock_offset_s)

    def send_state(self, world: LiveWorld, now_s: float) -> None:
        """Send the current poses and forces of a world. ``now_s``: the time on the session's clock."""
        if self._outlets is not None and self._clock_offset_s is not None:
            self._outlets.send_state(world, now_s - self._clock_offset_s)

    def close(self) -> None:
        """Stop to receive and to send all streams."""
        for inlet in self._inlets:
            inlet.stop()
        for inlet in self._inlets:
            inlet.join()
        self._outlets = None

    def _aligned(self, now_s: float) -> float:
        """Returns the session's clock minus Lab Streaming Layer's clock, in seconds. The session's time is at least
        ``now_s``."""
        seen_s = now_s - pylsl.local_clock()
        return (
            seen_s if self._clock_offset_s is None else max(self._clock_offset_s - MAX_CLOCK_DRIFT_S, seen_s)
        )


def _later(samples: StreamSamples, by_s: float) -> StreamSamples:
    return msgspec.structs.replace(samples, time_s=[time_s + by_s for time_s in samples.time_s])


@contextmanager
def open_lab_streams(choice: StreamSettings) -> Generator[LabStreams]:
    """Context manager that yields the streams of a session and closes them at the end."""
    streams = LabStreams(choice)
    try:
        yield streams
    finally:
        streams.close()
