"""Laws of the result of a headset check: a text and a remedy for each fault, and nothing else blocks a session."""

from collections.abc import Mapping
from typing import Any

import msgspec
import pytest

from avrgym.recording.configuration import HeadsetCheck, TrackingQuality
from avrgym.texts.interface_texts import list_included_languages, read_texts
from avrgym.vr.headset_check import (
    find_headset_faults,
    format_faults,
    format_measurements,
    format_result,
    is_headset_ready,
    make_result_message,
)
from avrgym.vr.latency import LATENCY_STAGES

READY = HeadsetCheck(
    device="test",
    emulated=False,
    profiles=["a-controller"],
    display_hz=90.0,
    duration_s=60.0,
    num_frames=5400,
    frame_rate_hz=90.0,
    dropped_share=0.001,
    latency_ms={stage: {"p50": 5.0, "p95": 8.0, "p99": 10.0} for stage in ("total_ms", *LATENCY_STAGES)},
    head=TrackingQuality("headset", 1.0, 0.2),
    left=TrackingQuality("controller", 1.0, 0.4, 0.62),
    right=TrackingQuality("hand", 0.97, 4.0, 0.6),
    vibration_felt=True,
    sound_heard=True,
)


def but(**changes: Any) -> HeadsetCheck:
    return msgspec.structs.replace(READY, **changes)


def late(stage: str) -> Mapping[str, Mapping[str, float]]:
    far = {
        stage: {"p50": 150.0, "p95": 190.0, "p99": 200.0},
        "total_ms": {"p50": 160.0, "p95": 200.0, "p99": 210.0},
    }
    return {**READY.latency_ms, **far}


def test_a_headset_without_faults_is_ready() -> None:
    assert is_headset_ready(READY)
    assert format_result(READY) == "Go: the headset is ready."
    for asked_nobody in (None, True):
        assert is_headset_ready(but(vibration_felt=asked_nobody, sound_heard=asked_nobody))


FAULTS = [
    (but(num_frames=0), "rendered no pictures", "put it on"),
    (but(display_hz=50.0), "50 Hz", "higher rate"),
    (but(display_hz=None, frame_rate_hz=45.0), "45 Hz", "higher rate"),
    (but(dropped_share=0.2), "20 % of the frames", "close other programs"),
    (but(latency_ms={}), "no picture for its poses", "connection"),
    (but(latency_ms=late("up_ms")), "is up to 200 ms", "USB cable"),
    (but(latency_ms=late("simulate_ms")), "is up to 200 ms", "server's computer"),
    (but(head=TrackingQuality("headset", 1.0, 3.0)), "head jitters at rest by 3.0 mm", "light the room"),
    (but(left=TrackingQuality("controller", 1.0, 4.0)), "left hand jitters at rest", "hold still"),
    (but(right=TrackingQuality("none", 0.0)), "right hand is tracked 0 %", "switch controllers on"),
    (but(right=TrackingQuality("mouse", 1.0)), "follows a mouse", "enter VR"),
    (but(vibration_felt=False), "not felt", "vibration"),
    (but(sound_heard=False), "not heard", "volume"),
]
ALL = [READY, *(check for check, *_ in FAULTS)]


@pytest.mark.parametrize(
    ("check", "what", "what_to_do"),
    FAULTS,
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_fault_is_told_alone_with_what_to_do(check: HeadsetCheck, what: str, what_to_do: str) -> None:
    assert len(find_headset_faults(check)) == 1
    assert not is_headset_ready(check)
    assert what in format_faults(check)
    assert what_to_do in format_faults(check)
    assert format_result(check) == f"No-go. {format_faults(check)}"


def test_who_reads_in_vr_is_told_the_first_faults_and_how_many_more_there_are() -> None:
    bad = but(vibration_felt=False, sound_heard=False, dropped_share=0.2)
    assert len(find_headset_faults(bad)) == 3
    for texts in map(read_texts, list_included_languages()):
        told, third = (
            texts.format_for_vr(make_result_message(bad, 2)),
            texts.format_for_vr(find_headset_faults(bad)[2]),
        )
        assert all(texts.format_for_vr(fault) in told for fault in find_headset_faults(bad)[:2])
        assert "1" in told
        assert third not in told
        assert third in texts.format_for_vr(make_result_message(bad, 3))
        assert all(texts.format_for_vr(make_result_message(each, 9)) for each in ALL)


def test_a_bare_hand_may_tremble_more_than_a_controller() -> None:
    assert is_headset_ready(but(left=TrackingQuality("hand", 1.0, 4.0)))
    assert not is_headset_ready(but(left=TrackingQuality("controller", 1.0, 4.0)))


def test_a_check_comes_back_from_where_it_is_stored_as_it_was() -> None:
    for check in (READY, but(display_hz=None, vibration_felt=None, latency_ms={})):
        assert msgspec.convert(msgspec.json.decode(msgspec.json.encode(check)), HeadsetCheck) == check
        assert format_measurements(check)
