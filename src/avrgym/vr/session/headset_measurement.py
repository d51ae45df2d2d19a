"""Measurements of a headset check, from the client's messages: rendered frames, latency, and tracked poses."""

from collections.abc import Callable, Collection, Sequence
from typing import Literal

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models.body_names import PERSON_ARM_SIDES, Side
from avrgym.recording.configuration import HeadsetCheck, TrackingQuality
from avrgym.recording.schema import Latency
from avrgym.vr.latency import compute_percentiles_ms
from avrgym.vr.protocol.messages import FrameIntervals, StopMethod, TrackingFrameMessage, XRPose

PoseGetter = Callable[[TrackingFrameMessage], XRPose | None]

RESTING_ARM_MODALITY = "rests"
"""The value of ``TrackingQuality.modality`` for an arm that the participant's input profile does not use."""
JITTER_WINDOW_S = 0.5
MIN_JITTER_FRAMES = 5
DROPPED_FRAME_THRESHOLD_PERIODS = 1.5
"""If an interval between frames exceeds this number of display periods, frames were dropped."""
_HEAD: PoseGetter = lambda frame: frame.head  # noqa: E731
_LEFT: PoseGetter = lambda frame: frame.left  # noqa: E731
_RIGHT: PoseGetter = lambda frame: frame.right  # noqa: E731


class HeadsetMeasurement:
    """Collects the client's messages during a headset check, and computes the result."""

    def __init__(self) -> None:
        self._seconds = 0.0
        self._tracked: list[TrackingFrameMessage] = []
        self._at_rest: list[TrackingFrameMessage] = []
        self._stretched: list[TrackingFrameMessage] = []
        self._drawn: list[FrameIntervals] = []
        self._latencies: list[Latency] = []
        self._stop: str | None = None
        self._stop_after_s: float | None = None

    def add_tracking(self, tracking: TrackingFrameMessage, *, is_at_rest: bool, stretching: bool) -> None:
        """Add a tracking frame. ``is_at_rest``: whether the participant rests. ``stretching``: whether the arms are
        stretched."""
        self._tracked.append(tracking)
        if is_at_rest:
            self._at_rest.append(tracking)
        if stretching:
            self._stretched.append(tracking)

    def add_latency(self, latency: Latency) -> None:
        """Add the latencies of the frames in one message."""
        self._latencies.append(latency)

    def add_frame_intervals(self, drawn: FrameIntervals) -> None:
        """Add the intervals between the rendered frames in one message, and the description of the device."""
        self._drawn.append(drawn)

    def add_test_stop(
        self, method: StopMethod | Literal["experimenter", "none"], after_s: float | None = None
    ) -> None:
        """Add the method of the test stop, and its delay after the request. ``none``: no stop within the time limit."""
        self._stop, self._stop_after_s = method, after_s

    @property
    def has_controller(self) -> bool:
        """Whether a hand holds a controller. Haptic feedback needs a controller."""
        newest = self._tracked[-1] if self._tracked else None
        return newest is not None and "controller" in (newest.left_modality, newest.right_modality)

    def compute_result(
        self, *, haptics: bool | None, sound: bool | None, used_arms: Collection[Side] = PERSON_ARM_SIDES
    ) -> HeadsetCheck:
        """Returns all measurements and answers. Arms that are not in ``used_arms`` are not measured.

        ``haptics``, ``sound``: whether the participant noticed the signal; ``None`` if this was not tested.
        """
        newest = self._tracked[-1] if self._tracked else None
        latest = self._drawn[-1] if self._drawn else None
        intervals_ms = np.array([ms for each in self._drawn for ms in each.intervals_ms])
        display_hz = latest.display_hz if latest else None

        def hand(arm: Side, modality: str, take: PoseGetter) -> TrackingQuality:
            return self._part(modality if arm in used_arms else RESTING_ARM_MODALITY, take, hand=True)

        return HeadsetCheck(
            device=latest.device if latest else "",
            emulated=latest.emulated if latest else False,
            profiles=latest.profiles if latest else [],
            display_hz=display_hz,
            duration_s=float(intervals_ms.sum()) / 1000.0,
            num_frames=len(intervals_ms),
            frame_rate_hz=1000.0 / float(intervals_ms.mean()) if len(intervals_ms) else 0.0,
            dropped_share=compute_dropped_frame_fraction(intervals_ms, display_hz),
            latency_ms=compute_percentiles_ms(self._latencies),
            head=self._part("headset" if newest and newest.head else "none", _HEAD),
            left=hand("left", newest.left_modality if newest else "none", _LEFT),
            right=hand("right", newest.right_modality if newest else "none", _RIGHT),
            vibration_felt=haptics,
            sound_heard=sound,
            stop_method=self._stop,
            stop_delay_s=self._stop_after_s,
        )

    def _part(self, modality: str, take: PoseGetter, *, hand: bool = False) -> TrackingQuality:
        tracked = sum(take(frame) is not None for frame in self._tracked)
        return TrackingQuality(
            modality=modality,
            tracked_share=tracked / len(self._tracked) if self._tracked else 0.0,
            jitter_mm=compute_jitter_mm(self._at_rest, take),
            reach_m=_reach_m(self._stretched, take) if hand else None,
        )


def compute_dropped_frame_fraction(intervals_ms: FloatArray, display_hz: float | None) -> float:
    """Returns the share of display frames that were not rendered, from the intervals (N,) between rendered frames.

    If the headset does not report its refresh rate, the median interval is used as the display period.
    """
    if not len(intervals_ms):
        return 0.0
    period_ms = 1000.0 / display_hz if display_hz else float(np.median(intervals_ms))
    shown = np.where(
        intervals_ms > DROPPED_FRAME_THRESHOLD_PERIODS * period_ms, np.rint(intervals_ms / period_ms), 1.0
    ).sum()
    return float(1.0 - len(intervals_ms) / shown)


def compute_jitter_mm(frames: Sequence[TrackingFrameMessage], take: PoseGetter) -> float | None:
    """Returns the jitter of a tracked part at rest in mm.

    It is the root mean square distance from a fitted parabola, as the median over periods of half a second.

    The parabola removes slow sway. Returns ``None`` if no period has enough frames.
    """
    poses = [(frame.client_time_ms / 1000.0, take(frame)) for frame in frames]
    seen = [(time_s, pose.position) for time_s, pose in poses if pose is not None]
    if not seen:
        return None
    times_s = np.array([time_s for time_s, _ in seen])
    positions = np.array([position for _, position in seen])
    windows = np.floor((times_s - times_s[0]) / JITTER_WINDOW_S)
    strays = [
        _stray_m(times_s[windows == window], positions[windows == window])
        for window in np.unique(windows)
        if (windows == window).sum() >= MIN_JITTER_FRAMES
    ]
    return 1000.0 * float(np.median(strays)) if strays else None


def _stray_m(times_s: FloatArray, positions: FloatArray) -> float:
    """Returns the root mean square distance in metres of positions (N, 3) from a parabola that is fitted over time."""
    design = np.vander(times_s - times_s.mean(), 3)
    left = positions - design @ np.linalg.lstsq(design, positions, rcond=None)[0]
    return float(np.sqrt((left * left).sum() / (len(times_s) - design.shape[1])))


def _reach_m(frames: Sequence[TrackingFrameMessage], take: PoseGetter) -> float | None:
    """Returns the maximum distance in metres of a tracked part from the head; ``None`` without tracked poses."""
    distances = [
        float(np.linalg.norm(np.subtract(pose.position, frame.head.position)))
        for frame in frames
        if (pose := take(frame)) is not None and frame.head is not None
    ]
    return max(distances, default=None)
