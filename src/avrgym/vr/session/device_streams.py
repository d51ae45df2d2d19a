"""Data streams of other devices in the laboratory: records their samples, and sends events, poses and forces."""

from collections.abc import Mapping
from typing import Protocol

import msgspec

from avrgym.recording.schema import Stream, StreamSamples
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import StreamStatus
from avrgym.vr.session.events import SessionEvent, StreamFound, StreamLost
from avrgym.vr.session.session_state import SessionState

STATE_SEND_INTERVAL_TICKS = 2
"""Interval in ticks at which poses and forces are sent (50 Hz)."""


class DeviceStreams(Protocol):
    """The streams of other devices. Methods never block. Times are on the session's clock."""

    @property
    def stream_availability(self) -> Mapping[str, bool]:
        """Whether each received stream is available, by its name in the study."""
        ...

    def pop_samples(self, now_s: float) -> list[tuple[Stream, StreamSamples]]:
        """Returns the samples received since the last call, in chunks with the description of their stream."""
        ...

    def send_event(self, event: SessionEvent) -> None:
        """Send an event of the session to other devices."""
        ...

    def send_state(self, world: LiveWorld, now_s: float) -> None:
        """Send the poses and contact forces of the world."""
        ...


class StreamRecorder:
    """Records samples of other devices during attempts, reports lost streams, and sends the world's state."""

    def __init__(self, streams: DeviceStreams, state: SessionState) -> None:
        self._streams, self._state = streams, state
        self._present = dict.fromkeys(streams.stream_availability, False)
        self._described: dict[str, Stream] = {}
        self._attempt: object = None
        self._ticks = 0

    @property
    def stream_statuses(self) -> list[StreamStatus]:
        """The status of each received stream: whether it is available."""
        return [StreamStatus(name, present) for name, present in self._present.items()]

    def tick(self) -> None:
        """Record received samples, and send the world's state. Call it after each tick."""
        state, now_s = self._state, self._state.now_s
        arrived = self._streams.pop_samples(now_s)
        self._ticks += 1
        if self._ticks % STATE_SEND_INTERVAL_TICKS == 0:
            self._streams.send_state(state.world, now_s)
        if state.attempt_storage.attempt is not self._attempt:
            self._begin()
        self._notice_changes()
        for stream, samples in arrived:
            self._record(stream, samples)

    def _begin(self) -> None:
        """Record the streams that are missing at the start of a new recording."""
        self._attempt = self._state.attempt_storage.attempt
        self._described.clear()
        for name, present in self._present.items():
            if not present:
                self._state.record_event("stream_lost", name)

    def _notice_changes(self) -> None:
        state = self._state
        for name, present in self._streams.stream_availability.items():
            if present is self._present[name]:
                continue
            self._present[name] = present
            state.record_event("stream_found" if present else "stream_lost", name)
            state.event_sink.report((StreamFound if present else StreamLost)(state.now_s, name))
            if not present:
                state.report_problem(f"the stream {name} is lost; the session continues without it")

    def _record(self, stream: Stream, samples: StreamSamples) -> None:
        attempt, now_s = self._state.attempt_storage.attempt, self._state.now_s
        if attempt is None:
            return
        if self._described.get(stream.name) != stream:
            self._described[stream.name] = stream
            attempt.record("/streams", stream, now_s)
        of_trial = [time_s - attempt.start_time_s for time_s in samples.time_s]
        attempt.record("/samples", msgspec.structs.replace(samples, time_s=of_trial), now_s)
