"""Laws of the headset check: measurements, their times, and their use in a session."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from msgspec.structs import replace as replace_frame

from avrgym.array_types import FloatArray
from avrgym.vr.headset_check import format_faults, format_measurements, format_result, is_headset_ready
from avrgym.vr.latency import LATENCY_STAGES
from avrgym.vr.protocol.messages import (
    Answer,
    ExperimenterCommand,
    FrameIntervals,
    HapticAndAudioFeedback,
    Latency,
    OriginReset,
    ParticipantReady,
    PhaseDescription,
    Question,
    Stop,
    StopMethod,
    TrackingFrameMessage,
    VrEntered,
    XRPose,
)
from avrgym.vr.session import events
from avrgym.vr.session.headset_measurement import (
    HeadsetMeasurement,
    compute_dropped_frame_fraction,
    compute_jitter_mm,
)
from avrgym.vr.session.phases import list_phase_names_with_flag
from avrgym.vr.session.plan import HeadsetCheckPlan
from helpers.vr.visit import Visit, plan

CHECKED = replace(
    plan(), headset_check=HeadsetCheckPlan(rest_duration_s=1.2, stretch_duration_s=0.3, motion_duration_s=0.4)
)
FRAMES = FrameIntervals("a browser", True, ["a-controller"], 90.0, [1000.0 / 90.0] * 90)
LATENCY = Latency([1, 2], *[[2.0, 3.0]] * len(LATENCY_STAGES))


def head(frame: TrackingFrameMessage) -> XRPose | None:
    return frame.head


def tracked(positions: FloatArray, rate_hz: float = 90.0) -> list[TrackingFrameMessage]:
    """Frames of a head at these places (N, 3)."""
    return [
        TrackingFrameMessage(
            i, 1000.0 * i / rate_hz, XRPose((x, y, z), (0.0, 0.0, 0.0, 1.0)), None, None, "none", "none"
        )
        for i, (x, y, z) in enumerate(positions.tolist())
    ]


# What is measured ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise_mm", [0.1, 1.0, 5.0])
def test_jitter_is_the_tracking_s_noise_whatever_the_head_sways(noise_mm: float) -> None:
    random, times_s = np.random.default_rng(1), np.arange(900) / 90.0
    sway = np.stack([0.02 * np.sin(2.0 * np.pi * 0.2 * times_s), 0.01 * times_s, 0.0 * times_s], axis=1)
    noise = random.normal(0.0, noise_mm / 1000.0 / np.sqrt(3.0), (900, 3))
    assert compute_jitter_mm(tracked(sway + noise), head) == pytest.approx(noise_mm, rel=0.25)


def test_nothing_seen_has_no_jitter() -> None:
    assert compute_jitter_mm([], head) is None
    assert compute_jitter_mm(tracked(np.zeros((3, 3))), head) is None


@pytest.mark.parametrize("display_hz", [90.0, None])
def test_a_frame_that_takes_as_long_as_three_has_dropped_two(display_hz: float | None) -> None:
    period_ms = 1000.0 / 90.0
    early_or_late = np.array([0.9, 1.1] * 48)
    assert compute_dropped_frame_fraction(period_ms * early_or_late, display_hz) == 0.0
    assert compute_dropped_frame_fraction(
        period_ms * np.append(early_or_late, [3.0, 1.0]), display_hz
    ) == pytest.approx(0.02)
    assert compute_dropped_frame_fraction(np.array([]), display_hz) == 0.0


# What a session makes of it -------------------------------------------------------------------------------------


def measure(visit: Visit) -> None:
    """From entering VR, or from a failed check, until the stop is to be tried."""
    visit.tick(5)
    visit.send(ParticipantReady())
    while visit.phase == "headset_check":
        visit.tick()
        visit.send(FRAMES, LATENCY)
    assert visit.phase == "headset_stop"


def check(visit: Visit, haptics: int = 1, sound: int = 1) -> None:
    """From entering VR, or from a failed check, to its result."""
    measure(visit)
    visit.send(Stop(method="palm"))
    answer(visit, haptics, sound)


def answer(visit: Visit, haptics: int = 1, sound: int = 1) -> None:
    """Say what is felt and heard."""
    for value in (haptics, sound):
        visit.tick(110)
        visit.send(Answer(visit.received(Question)[-1].item, value, 1.0))
    assert visit.phase == "headset"


def test_a_ready_headset_leads_to_calibration_and_into_every_recording(tmp_path: Path) -> None:
    visit = Visit(tmp_path, CHECKED)
    visit.send(VrEntered())
    check(visit)
    result = next(each for each in visit.observed if isinstance(each, events.HeadsetChecked)).check
    assert is_headset_ready(result), format_result(result)
    assert result.emulated
    assert result.frame_rate_hz == pytest.approx(90.0)
    assert result.left.reach_m is not None
    assert result.head.tracked_share == 1.0
    assert result.stop_method == "palm"
    assert result.latency_ms["total_ms"]["p50"] == pytest.approx(2.5 * len(LATENCY_STAGES))
    assert "ready" in visit.received(PhaseDescription)[-1].text
    visit.send(ParticipantReady())
    assert visit.phase == "calibration"
    visit.tick(20)
    visit.send(ParticipantReady())
    visit.run_until("trial")
    visit.leave()
    (recording,) = visit.recordings()
    recorded = recording.configuration.headset_check
    assert recorded is not None
    assert (recorded.display_hz, recorded.stop_method) == (90.0, "palm")


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("way", get_args(StopMethod))
def test_the_check_goes_on_by_itself_once_the_stop_was_tried(tmp_path: Path, way: StopMethod) -> None:
    visit = Visit(tmp_path, CHECKED)
    visit.send(VrEntered())
    measure(visit)
    assert "headset_stop" in list_phase_names_with_flag("can_be_stopped")
    visit.send(ExperimenterCommand("stop"))
    assert visit.phase == "headset_stop"
    visit.tick(25)
    visit.send(Stop(method=way))
    assert visit.phase == "headset_check"
    answer(visit)
    (result,) = [each.check for each in visit.observed if isinstance(each, events.HeadsetChecked)]
    assert (result.stop_method, result.stop_delay_s) == (way, pytest.approx(0.25, abs=0.02))
    assert f"{way} after 0." in format_measurements(result)
    assert is_headset_ready(result), format_result(result)


@pytest.mark.slow
def test_a_stop_that_was_not_tried_is_told_and_may_be_skipped(tmp_path: Path) -> None:
    visit = Visit(
        tmp_path, replace(CHECKED, headset_check=HeadsetCheckPlan(1.2, 0.3, 0.4, test_stop_limit_s=0.5))
    )
    visit.send(VrEntered())
    measure(visit)
    visit.tick(60)
    answer(visit)
    (result,) = [each.check for each in visit.observed if isinstance(each, events.HeadsetChecked)]
    assert result.stop_method == "none"
    assert not is_headset_ready(result)
    assert "did not try the stop" in visit.received(PhaseDescription)[-1].text
    visit.send(ParticipantReady())
    measure(visit)
    visit.send(ExperimenterCommand("skip"))
    assert visit.phase == "calibration"


def test_a_check_of_earlier_versions_lacks_no_stop() -> None:
    check = HeadsetMeasurement().compute_result(haptics=None, sound=None)
    assert check.stop_method is None
    assert "stop" not in format_faults(check)


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("way", [None, *get_args(StopMethod)])
def test_every_way_stops_a_trial_at_once_and_is_stored(tmp_path: Path, way: StopMethod | None) -> None:
    visit = Visit(tmp_path, plan())
    visit.go_to("trial")
    visit.send(Stop(method=way))
    assert visit.phase == "paused"
    assert [each.way for each in visit.observed if isinstance(each, events.Stopped)] == [way]


def test_who_plays_with_a_mouse_stretches_no_arms(tmp_path: Path) -> None:
    visit = Visit(tmp_path, CHECKED)
    visit.frame = lambda of=visit.frame: replace_frame(of(), left_modality="mouse", right_modality="mouse")
    visit.send(VrEntered())
    measure(visit)
    shown = [phase.text for phase in visit.received(PhaseDescription)]
    assert any("hold still" in text for text in shown)
    assert not any("Stretch" in text for text in shown)


def test_who_feels_no_buzz_is_told_and_checks_again(tmp_path: Path) -> None:
    visit = Visit(tmp_path, CHECKED)
    visit.send(VrEntered())
    check(visit, haptics=2)
    assert "not felt" in visit.received(PhaseDescription)[-1].text
    visit.send(ParticipantReady())
    assert visit.phase == "headset"
    assert not any(isinstance(each, events.Calibrated) for each in visit.observed)
    visit.send(ExperimenterCommand("skip"))
    assert visit.phase == "calibration"
    visit.send(OriginReset())
    assert visit.phase == "calibration"


def test_hands_buzz_then_a_chime_sounds(tmp_path: Path) -> None:
    visit = Visit(tmp_path, CHECKED)
    visit.send(VrEntered())
    check(visit)
    felt = visit.received(HapticAndAudioFeedback)
    assert [each.left_touched and each.right_touched for each in felt] == [True, False, False]
    assert [each.events for each in felt] == [0, 0, 1]


def test_the_experimenter_may_skip_the_check_at_any_time(tmp_path: Path) -> None:
    for ticks in (0, 150):
        visit = Visit(tmp_path / str(ticks), CHECKED)
        visit.send(VrEntered())
        visit.tick(5)
        visit.send(ParticipantReady())
        visit.tick(ticks)
        visit.send(ExperimenterCommand("skip"))
        assert visit.phase == "calibration"
        assert any(isinstance(each, events.HeadsetCheckSkipped) for each in visit.observed)


def test_without_a_check_nothing_is_checked_and_nothing_recorded(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan())
    visit.go_to("trial")
    visit.leave()
    assert not {"headset", "headset_check"} & set(visit.phases)
    assert visit.recordings()[0].configuration.headset_check is None


def test_the_check_waits_for_the_scene_that_it_measures_with(tmp_path: Path) -> None:
    visit = Visit(tmp_path, CHECKED)
    visit.loads_scenes = False
    visit.send(VrEntered())
    visit.tick(5)
    visit.send(ParticipantReady())
    assert visit.phase == "headset"
    assert "scene" in visit.problems[-1]
