"""Streams of other devices by real outlets and inlets of Lab Streaming Layer, on this machine."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from avrgym.recording.schema import Stream, StreamSamples
from avrgym.recording.streams import compute_stream_quality, compute_stream_sample_times
from avrgym.safety.limits import BODY_REGIONS
from avrgym.vr.lab_streaming.stream_settings import StreamSettings
from avrgym.vr.protocol.messages import ParticipantReady, SessionStatus, VrEntered
from avrgym.vr.session.events import StreamFound, StreamLost
from helpers.vr.lab_streams import RATE_HZ, SENT_BODIES, Device, LiveVisit, open_lab_streams, pylsl

LOOPBACK_S = 0.002
MARKERS = "AVR Gym events"


def test_poses_and_forces_are_sent(tmp_path: Path) -> None:
    """Before all others, whose streams have the same names."""
    with open_lab_streams(StreamSettings(send=True)) as streams:
        visit = LiveVisit(tmp_path, streams)
        inlets = []
        for what in ("poses", "forces"):
            (found,) = pylsl.resolve_bypred(f"name='AVR Gym {what}'", 1, 10.0)
            inlets.append(pylsl.StreamInlet(found, recover=False))
            inlets[-1].open_stream(10.0)
        visit.run_live(lambda: all(inlet.samples_available() > 3 for inlet in inlets))
        (posed, posed_s), (pressed, _) = [inlet.pull_chunk(0.0, 1000, as_numpy=True) for inlet in inlets]
        labels = inlets[0].info(5.0).get_channel_labels()
        visit.leave()
    assert labels == [
        f"{name}_{part}" for name in SENT_BODIES for part in ("x", "y", "z", "qw", "qx", "qy", "qz")
    ]
    body = visit.session.world.simulation.get_body_poses(0)[visit.session.bodies.index("person/head")]
    assert posed[-1, :7] == pytest.approx(body, abs=1e-3)
    assert (np.diff(posed_s) > 0).all()
    assert pressed.shape[1] == len(BODY_REGIONS)
    assert np.isfinite(pressed).all()


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveVisit]:
    """A whole trial with a device whose stream vanishes and comes back, and our own events received as a stream."""
    choice = StreamSettings(True, {"heart": "type='ECG' and name='Belt'", "own": f"name='{MARKERS}'"})
    belt = Device()
    with open_lab_streams(choice) as streams:
        visit = LiveVisit(tmp_path_factory.mktemp("recordings"), streams)
        visit.run_live(lambda: all(streams.stream_availability.values()))
        visit.send(VrEntered())
        visit.run_live_until("calibration")
        soon = visit.now_s + 0.3
        visit.run_live(lambda: visit.now_s > soon)
        visit.send(ParticipantReady())
        visit.run_live_until("questionnaire")
        belt.turn_off()
        visit.run_live(lambda: not streams.stream_availability["heart"])
        back = Device()
        visit.run_live(lambda: streams.stream_availability["heart"])
        soon = visit.now_s + 0.3
        visit.run_live(lambda: visit.now_s > soon)
        visit.answer(1, 2, 3, 4)
        visit.run_live_until("finished")
        back.turn_off()
        yield visit
        visit.leave()


@pytest.mark.slow
def test_samples_are_recorded_with_their_time_stamps(lived: LiveVisit) -> None:
    (recording,) = lived.recordings()
    began_s = next(event.time_s for event in lived.observed if type(event).__name__ == "TrialBegun")
    chunks = [chunk for _, chunk in recording.messages_by_topic["/samples"] if chunk.stream_name == "heart"]
    taken_s = np.concatenate([np.array(chunk.values)[:, 0] for chunk in chunks])
    error_s = (
        compute_stream_sample_times(recording.messages_by_topic, "heart").time_s
        + began_s
        + lived.began_s
        - taken_s
    )
    assert len(error_s) > RATE_HZ / 2
    assert np.abs(error_s).max() < LOOPBACK_S
    numbers = np.concatenate([np.array(chunk.values)[:, 1] for chunk in chunks])
    assert (np.diff(numbers) == 1.0).sum() >= len(numbers) - 2, (
        "only where the device was away is one missing"
    )


def test_the_quality_of_time_stamps_is_measured(lived: LiveVisit) -> None:
    heart, own = compute_stream_quality(lived.recordings()[0].messages_by_topic)
    assert (heart.stream, heart.kind, heart.rate_hz, heart.gaps) == ("heart", "ECG", RATE_HZ, 1)
    assert heart.jitter_ms is not None
    assert heart.jitter_ms < 1e3 * LOOPBACK_S
    assert abs(heart.offset_ms) < 1e3 * LOOPBACK_S
    assert (own.stream, own.kind, own.rate_hz, own.jitter_ms) == ("own", "Markers", 0.0, None)


def test_a_stream_is_described_before_its_samples(lived: LiveVisit) -> None:
    (recording,) = lived.recordings()
    described = {stream.name: stream for _, stream in recording.messages_by_topic["/streams"]}
    assert described["heart"] == Stream("heart", "Belt", "ECG", RATE_HZ, ["taken", "number"], ["s", ""])
    records = [record for _, _, record in recording.messages if isinstance(record, Stream | StreamSamples)]
    for name, stream in described.items():
        samples = (each for each in records if isinstance(each, StreamSamples) and each.stream_name == name)
        assert records.index(stream) < records.index(next(samples))


def test_a_lost_stream_is_an_event_and_a_problem_message(lived: LiveVisit) -> None:
    told = [
        (type(event), event.stream) for event in lived.observed if isinstance(event, StreamFound | StreamLost)
    ]
    heart = [kind for kind, name in told if name == "heart"]
    assert heart == [StreamFound, StreamLost, StreamFound]
    recorded = [(event.name, event.detail) for _, event in lived.recordings()[0].messages_by_topic["/events"]]
    assert [name for name, detail in recorded if detail == "heart"] == ["stream_lost", "stream_found"]
    assert "the stream heart is lost; the session continues without it" in lived.problems
    seen = {
        tuple((each.name, each.present) for each in status.streams)
        for status in lived.received(SessionStatus)
    }
    assert {(("heart", False), ("own", True)), (("heart", True), ("own", True))} <= seen


def test_events_are_sent_with_the_times_of_the_recording(lived: LiveVisit) -> None:
    (recording,) = lived.recordings()
    chunks = [chunk for _, chunk in recording.messages_by_topic["/samples"] if chunk.stream_name == "own"]
    sent = [json.loads(text) for chunk in chunks for (text,) in chunk.texts]
    times_s = compute_stream_sample_times(recording.messages_by_topic, "own").time_s
    phases = [(time_s, each["phase"]) for time_s, each in zip(times_s, sent, strict=True) if "phase" in each]
    recorded = {
        event.detail: time_ns / 1e9
        for time_ns, event in recording.messages_by_topic["/events"]
        if event.name == "phase"
    }
    of_trial = [(time_s, phase) for time_s, phase in phases if phase in recorded]
    assert [time_s for time_s, _ in of_trial] == pytest.approx(
        [recorded[each] for _, each in of_trial], abs=LOOPBACK_S
    )
    assert [phase for _, phase in of_trial][-2:] == ["free_after", "questionnaire"]
