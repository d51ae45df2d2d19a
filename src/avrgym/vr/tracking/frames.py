"""The stream of tracking frames: valid frames, the newest frame, and its age."""

from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from avrgym.geometry import transforms
from avrgym.texts.interface_texts import Text, TextError
from avrgym.vr.protocol.messages import Modality, Tracking, XRPose
from avrgym.vr.protocol.webxr import Pose, Registration, hand_pose, hand_pose_from_wrist, head_pose, is_valid
from avrgym.vr.tracking.body import BodyPose
from avrgym.vr.tracking.freshness import STALE_S, Freshness

CALIBRATION_S = 0.5
CALIBRATION_FRAMES = 3
"""Minimum number of frames for a meaningful median. A page that renders in software sends few frames."""
STEADY_RADIUS_M = 0.03
MAX_GAZE_PITCH_SINE = 0.85
"""Sine of the steepest pitch at which a headset's yaw is reliable."""


MAX_GAP_FRAMES = 1000
"""Maximum increase of the frame number from one frame to the next: ten seconds of a headset's frames."""
RESTART_FRAMES = 10
"""After this number of consecutive frames that continue each other, but not the stream, the stream has restarted."""


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
        if self._strays == RESTART_FRAMES:
            self._go_on(number)
            return True
        return False

    def _go_on(self, number: int) -> None:
        self._newest, self._stray, self._strays = number, None, 0


def _continues(number: int, before: int) -> bool:
    return 0 < number - before <= MAX_GAP_FRAMES


@dataclass(frozen=True)
class Frame:
    """A tracking frame with its arrival time. ``usable``: the frame is valid and may move the simulated person.

    ``captured_s`` is the capture time, computed from the client's clock. It is never after the arrival and never far
    before it. Frames that were delayed in the network keep their original intervals.
    """

    tracking: Tracking
    received_s: float
    captured_s: float
    usable: bool


class TrackingFeed:
    """The frames from entering VR until leaving it.

    ``newest``: the latest usable frame. ``freshness``: the age of the poses of each part of the body.
    """

    def __init__(self) -> None:
        self.newest: Frame | None = None
        self.freshness = Freshness()
        self._numbering = SequenceFilter()
        self._arrived: list[Frame] = []
        self._recent: deque[Frame] = deque()

    def add(self, tracking: Tracking, now_s: float) -> Frame:
        """Add a frame that arrives now. Returns it with its times, and whether it is usable."""
        frame = Frame(tracking, now_s, self._captured_s(tracking, now_s), self._is_usable(tracking))
        self._arrived.append(frame)
        if frame.usable:
            self.newest = frame
            self.freshness.update(tracking, now_s)
            self._recent.append(frame)
            self._forget(now_s - CALIBRATION_S)
        return frame

    def take_arrived(self) -> list[Frame]:
        """Returns the frames that arrived since the last call."""
        arrived, self._arrived = self._arrived, []
        return arrived

    def is_stale(self, now_s: float) -> bool:
        """Returns whether the newest usable frame is older than ``STALE_S``; false before the first frame."""
        return self.newest is not None and now_s - self.newest.received_s > STALE_S

    def steady_head(self, now_s: float) -> XRPose:
        """Returns the headset's pose at rest: the pose with the median height in the last half second.

        Raises:
            TextError: if there are too few poses, or the headset moved too much or looked too steeply up or down.
        """
        self._forget(now_s - CALIBRATION_S)
        heads = [f.tracking.head for f in self._recent if f.tracking.head is not None]
        if len(heads) < CALIBRATION_FRAMES:
            raise TextError(Text("head_untracked"))
        spread = np.ptp([head.position for head in heads], axis=0).max()
        if spread > STEADY_RADIUS_M:
            moved_cm, most_cm = f"{100 * spread:.1f}", f"{100 * STEADY_RADIUS_M:.0f}"
            raise TextError(Text("head_moved", {"moved_cm": moved_cm, "most_cm": most_cm}))
        head = sorted(heads, key=lambda head: head.position[1])[len(heads) // 2]
        q_w = head_pose(Registration(np.zeros(3), 0.0), head).q_w
        if abs(transforms.rotate(q_w, [0.0, -1.0, 0.0])[2]) > MAX_GAZE_PITCH_SINE:
            raise TextError(Text("head_steep"))
        return head

    def _captured_s(self, tracking: Tracking, now_s: float) -> float:
        """Returns the capture time of a frame, limited to the last ``STALE_S``."""
        if self.newest is None:
            return now_s
        passed_s = (tracking.client_time_ms - self.newest.tracking.client_time_ms) / 1000.0
        at_least_s = max(self.newest.captured_s, now_s - STALE_S)
        return min(now_s, max(at_least_s, self.newest.captured_s + passed_s))

    def _forget(self, until_s: float) -> None:
        while self._recent and self._recent[0].received_s <= until_s:
            self._recent.popleft()

    def _is_usable(self, frame: Tracking) -> bool:
        """Returns whether a frame has a head pose, valid numbers, and continues the stream."""
        poses = [pose for pose in (frame.head, frame.left, frame.right) if pose is not None]
        sound = frame.head is not None and all(is_valid(pose) for pose in poses)
        return sound and self._numbering.accepts(frame.sequence)


def body_pose(registration: Registration, frame: Tracking) -> BodyPose:
    """Returns the world poses of head and hands in a usable frame. The frame contains wrist poses of bare hands."""
    assert frame.head is not None

    def hand(side: Literal["left", "right"], pose: XRPose | None, modality: Modality) -> Pose | None:
        if pose is None:
            return None
        if modality == "hand":
            return hand_pose_from_wrist(registration, pose, side)
        return hand_pose(registration, pose)

    left, right = (
        hand("left", frame.left, frame.left_modality),
        hand("right", frame.right, frame.right_modality),
    )
    return BodyPose(head_pose(registration, frame.head), left, right)
