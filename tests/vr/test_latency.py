"""Latency from tracking to display: measurement, validation, status and recording."""

import math
from pathlib import Path

import msgspec
import pytest

from avrgym.recording.schema import MAX_LATENCY_FRAMES, MAX_LATENCY_MS, Latency
from avrgym.vr.latency import LATENCY_STAGES, compute_percentiles_ms
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import SessionStatus, WorldState
from avrgym.vr.server.connection import MAX_STORED_FRAME_TIMES, FrameLatencyTracker
from helpers.vr.visit import Visit, plan


def told(frames: int, **stages: float) -> messages.Latency:
    """Of frames that all take as long."""
    columns = [[stages.get(stage, 1.0)] * frames for stage in LATENCY_STAGES]
    return messages.Latency(list(range(frames)), *columns)


def state(followed: int) -> WorldState:
    return WorldState(0, 0.0, followed, b"", [], b"")


def test_a_frame_passes_once_from_its_arrival_to_the_first_state_that_follows_it() -> None:
    passage = FrameLatencyTracker()
    passage.record_arrival(3)
    passage.record_arrival(4)
    assert passage.pop_newest_frame_times(state(-1), 0.0) is None
    passed = passage.pop_newest_frame_times(state(4), 7.5)
    assert passed is not None
    assert (passed.tracking_sequence, passed.simulated_s) == (4, 7.5)
    assert passed.received_s <= passed.sent_s
    assert passage.pop_newest_frame_times(state(4), 7.5) is None


def test_frames_that_no_state_follows_are_forgotten() -> None:
    passage = FrameLatencyTracker()
    for sequence in range(3 * MAX_STORED_FRAME_TIMES):
        passage.record_arrival(sequence)
    assert passage.pop_newest_frame_times(state(0), 0.0) is None
    assert passage.pop_newest_frame_times(state(3 * MAX_STORED_FRAME_TIMES - 1), 0.0) is not None
    assert len(passage._received_s) < MAX_STORED_FRAME_TIMES


def test_the_total_is_the_sum_of_the_stages() -> None:
    percentiles = compute_percentiles_ms([told(9, draw_ms=45.0), told(1, draw_ms=95.0)])
    assert percentiles["total_ms"]["p50"] == pytest.approx(50.0)
    assert percentiles["draw_ms"]["p50"] == 45.0
    assert percentiles["draw_ms"]["p99"] > 90.0
    assert compute_percentiles_ms([]) == compute_percentiles_ms([told(0)]) == {}


def test_latency_is_in_the_status_and_the_recording(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan(trial_steps=5))
    visit.go_to("trial")
    visit.send(told(10, draw_ms=45.0))
    visit.tick(25)
    shown = {each.stage: each for each in visit.received(SessionStatus)[-1].latency}
    assert shown["total_ms"].p50 == pytest.approx(50.0)
    assert shown["draw_ms"].p99 == pytest.approx(45.0)
    visit.leave()
    (recording,) = visit.recordings()
    assert [record for _, record in recording.messages_by_topic["/latency"]] == [
        Latency(*(getattr(told(10, draw_ms=45.0), name) for name in Latency.__struct_fields__))
    ]


def test_latency_with_gaps_is_refused_in_words_and_nothing_else_happens(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan(trial_steps=5))
    visit.go_to("trial")
    visit.send(msgspec.structs.replace(told(10), up_ms=[1.0]))
    visit.tick(25)
    assert visit.phase == "trial"
    assert visit.problems == [
        "the latency message is incomplete; it needs one entry per frame for each stage"
    ]
    assert visit.received(SessionStatus)[-1].latency == []


@pytest.mark.parametrize("wrong", [-1.0, math.nan, math.inf, MAX_LATENCY_MS + 1.0])
def test_latencies_are_positive_and_limited(wrong: float) -> None:
    with pytest.raises(msgspec.DecodeError):
        messages.decode_participant_message(messages.encode_message(told(1, up_ms=wrong)))


def test_too_many_frames_are_rejected() -> None:
    messages.decode_participant_message(messages.encode_message(told(MAX_LATENCY_FRAMES)))
    with pytest.raises(msgspec.DecodeError):
        messages.decode_participant_message(messages.encode_message(told(MAX_LATENCY_FRAMES + 1)))
