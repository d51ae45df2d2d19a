"""The stream of tracking frames: valid frames, the newest frame, and its age."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from avrgym.geometry import transforms
from avrgym.models.body_names import Side
from avrgym.texts.interface_texts import ParticipantActionError, ParticipantText
from avrgym.vr.protocol.messages import Modality, TrackingFrameMessage, XRPose
from avrgym.vr.protocol.webxr import (
    Pose,
    Registration,
    compute_hand_pose,
    compute_hand_pose_from_wrist,
    compute_head_pose,
    is_valid_pose,
)
from avrgym.vr.tracking.body import BodyPose
from avrgym.vr.tracking.pose_freshness import STALE_POSE_AGE_S, MeasurementTimes

CALIBRATION_WINDOW_S = 0.5
MIN_CALIBRATION_FRAMES = 3
"""Minimum number of frames for the median of a pose. A page that renders in software sends few frames."""
STEADY_HEAD_RANGE_M = 0.03
MAX_HEAD_PITCH_SINE = 0.85
"""Sine of the steepest pitch at which a headset's yaw is reliable."""


MAX_SEQUENCE_GAP = 1000
"""Maximum increase of the frame number from one frame to the next: ten seconds of a headset's frames."""
MIN_RESTART_FRAMES = 10
"""Number of consecutively numbered frames after which a stream with other numbers is accepted as restarted."""


class SequenceFilter:
    """Accepts the frames that continue a stream, by their numbers.

    Frames that are repeated, late, or far ahead are rejected and do not affect later frames. If a client restarts its
    numbering, its frames are accepted from the tenth frame on.
    """

    def __init__(self) -> None:
        self._newest: int | None = None
        self._stray: int | None = None
        self._strays = 0

    def accepts(self, number: int) -> bool:
        """Returns whether the frame with this number continues the stream. Call it for every valid frame."""
        if self._newest is None or _continues(number, self._newest):
            self._go_on(number)
            return True
        in_row = self._stray is not None and _continues(number, self._stray)
        self._stray, self._strays = number, self._strays + 1 if in_row else 1
        if self._strays == MIN_RESTART_FRAMES:
            self._go_on(number)
            return True
        return False

    def _go_on(self, number: int) -> None:
        self._newest, self._stray, self._strays = number, None, 0


def _continues(number: int, before: int) -> bool:
    return 0 < number - before <= MAX_SEQUENCE_GAP


@dataclass(frozen=True)
class ReceivedFrame:
    """A tracking frame with its arrival time. ``is_usable``: whether it is valid and may move the simulated person.

    ``captured_s`` is the capture time, computed from the client's clock. It is at most the arrival time, and not far
    below it. Network delays do not change the intervals between capture times.
    """

    tracking: TrackingFrameMessage
    received_s: float
    captured_s: float
    is_usable: bool


class TrackingFeed:
    """The frames from entering VR until leaving it.

    ``newest_frame``: the latest usable frame. ``measurement_times``: the age of the poses of each part of the body.
    """

    def __init__(self) -> None:
        self.newest_frame: ReceivedFrame | None = None
        self.measurement_times = MeasurementTimes()
        self._numbering = SequenceFilter()
        self._arrived: list[ReceivedFrame] = []
        self._recent: deque[ReceivedFrame] = deque()

    def add(self, tracking: TrackingFrameMessage, now_s: float) -> ReceivedFrame:
        """Add a frame that arrives now. Returns the frame with its times, and whether it is usable."""
        frame = ReceivedFrame(tracking, now_s, self._captured_s(tracking, now_s), self._is_usable(tracking))
        self._arrived.append(frame)
        if frame.is_usable:
            self.newest_frame = frame
            self.measurement_times.update(tracking, now_s)
            self._recent.append(frame)
            self._forget(now_s - CALIBRATION_WINDOW_S)
        return frame

    def pop_arrived_frames(self) -> list[ReceivedFrame]:
        """Returns the frames that arrived since the last call."""
        arrived, self._arrived = self._arrived, []
        return arrived

    def is_stale(self, now_s: float) -> bool:
        """Returns whether the newest usable frame is older than ``STALE_POSE_AGE_S``; false before the first frame."""
        return self.newest_frame is not None and now_s - self.newest_frame.received_s > STALE_POSE_AGE_S

    def find_steady_headset_pose(self, now_s: float) -> XRPose:
        """Returns the headset's pose at rest: the pose with the median height in the last half second.

        Raises:
            TextError: if there are too few poses, or the headset moved too much or looked too steeply up or down.
        """
        self._forget(now_s - CALIBRATION_WINDOW_S)
        heads = [f.tracking.head for f in self._recent if f.tracking.head is not None]
        if len(heads) < MIN_CALIBRATION_FRAMES:
            raise ParticipantActionError(ParticipantText("head_untracked"))
        spread = np.ptp([head.position for head in heads], axis=0).max()
        if spread > STEADY_HEAD_RANGE_M:
            moved_cm, most_cm = f"{100 * spread:.1f}", f"{100 * STEADY_HEAD_RANGE_M:.0f}"
            raise ParticipantActionError(
                ParticipantText("head_moved", {"moved_cm": moved_cm, "most_cm": most_cm})
            )
        head = sorted(heads, key=lambda head: head.position[1])[len(heads) // 2]
        q_w = compute_head_pose(Registration(np.zeros(3), 0.0), head).q_w
        if abs(transforms.rotate(q_w, [0.0, -1.0, 0.0])[2]) > MAX_HEAD_PITCH_SINE:
            raise ParticipantActionError(ParticipantText("head_steep"))
        return head

    def _captured_s(self, tracking: TrackingFrameMessage, now_s: float) -> float:
        """Returns the capture time of a frame, limited to the last ``STALE_POSE_AGE_S``."""
        if self.newest_frame is None:
            return now_s
        passed_s = (tracking.client_time_ms - self.newest_frame.tracking.client_time_ms) / 1000.0
        at_least_s = max(self.newest_frame.captured_s, now_s - STALE_POSE_AGE_S)
        return min(now_s, max(at_least_s, self.newest_frame.captured_s + passed_s))

    def _forget(self, until_s: float) -> None:
        while self._recent and self._recent[0].received_s <= until_s:
            self._recent.popleft()

    def _is_usable(self, frame: TrackingFrameMessage) -> bool:
        """Returns whether a frame is usable: it has a head pose and valid numbers, and continues the stream."""
        poses = [pose for pose in (frame.head, frame.left, frame.right) if pose is not None]
        sound = frame.head is not None and all(is_valid_pose(pose) for pose in poses)
        return sound and self._numbering.accepts(frame.sequence)


def compute_body_pose(registration: Registration, frame: TrackingFrameMessage) -> BodyPose:
    """Returns the world poses of head and hands in a usable frame. For bare hands, the frame contains wrist poses."""
    assert frame.head is not None

    def hand(side: Side, pose: XRPose | None, modality: Modality) -> Pose | None:
        if pose is None:
            return None
        if modality == "hand":
            return compute_hand_pose_from_wrist(registration, pose, side)
        return compute_hand_pose(registration, pose)

    left, right = (
        hand("left", frame.left, frame.left_modality),
        hand("right", frame.right, frame.right_modality),
    )
    return BodyPose(compute_head_pose(registration, frame.head), left, right)
