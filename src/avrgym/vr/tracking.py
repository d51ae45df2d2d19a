"""The stream of tracking frames: which of them count, which is the newest, and whether it is fresh."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from avrgym.models.human import Sex
from avrgym.vr.body import BodyPose, torso_height
from avrgym.vr.messages import Tracking, XRPose
from avrgym.vr.webxr import Registration, hand_pose, head_pose, is_valid, register

STALE_S = 0.2
"""A frame older than this no longer moves the person."""
CALIBRATION_S = 0.5
CALIBRATION_FRAMES = 5
STEADY_M = 0.03


@dataclass(frozen=True)
class Frame:
    """A tracking frame and when it arrived; ``usable``: it may move the person."""

    tracking: Tracking
    received_s: float
    usable: bool


class TrackingFeed:
    """The frames of one stay in VR. ``newest`` is the last usable one."""

    def __init__(self) -> None:
        self.newest: Frame | None = None
        self._arrived: list[Frame] = []
        self._recent: deque[Frame] = deque()

    def add(self, tracking: Tracking, now_s: float) -> Frame:
        """Take a frame that arrives now."""
        frame = Frame(tracking, now_s, self._is_usable(tracking))
        self._arrived.append(frame)
        if frame.usable:
            self.newest = frame
            self._recent.append(frame)
            self._forget(now_s - CALIBRATION_S)
        return frame

    def take_arrived(self) -> list[Frame]:
        """The frames that arrived since this was last asked."""
        arrived, self._arrived = self._arrived, []
        return arrived

    def is_stale(self, now_s: float) -> bool:
        """Whether frames came, but none for 200 ms."""
        return self.newest is not None and now_s - self.newest.received_s > STALE_S

    def steady_heads(self, now_s: float) -> list[XRPose]:
        """The headset's poses over the last half second.

        Raises:
            ValueError: when they are too few or moved too much, in words for the participant.
        """
        self._forget(now_s - CALIBRATION_S)
        heads = [f.tracking.head for f in self._recent if f.tracking.head is not None]
        if len(heads) < CALIBRATION_FRAMES:
            raise ValueError(
                "the headset is not tracked: look around for a moment, then press the trigger again"
            )
        spread = np.ptp([head.position for head in heads], axis=0).max()
        if spread > STEADY_M:
            raise ValueError(
                f"your head moved by {100 * spread:.0f} cm; keep it within {100 * STEADY_M:.0f} cm"
            )
        return heads

    def _forget(self, until_s: float) -> None:
        while self._recent and self._recent[0].received_s <= until_s:
            self._recent.popleft()

    def _is_usable(self, frame: Tracking) -> bool:
        """Whether a frame shows where a head is, is sound in every number, and comes after those before."""
        replayed = self.newest is not None and frame.sequence <= self.newest.tracking.sequence
        poses = [pose for pose in (frame.head, frame.left, frame.right) if pose is not None]
        return frame.head is not None and not replayed and all(is_valid(pose) for pose in poses)


def measure_torso_height(sex: Sex, heads: list[XRPose]) -> float:
    """Torso height in metres from poses of the headset of somebody who sits upright.

    Raises:
        ValueError: for a height that no seated adult has, naming what is allowed.
    """
    centres = [head_pose(register(head, np.zeros(3)), head).pos_w for head in heads]
    return torso_height(sex, float(np.median([centre[2] for centre in centres])))


def body_pose(registration: Registration, frame: Tracking) -> BodyPose:
    """Where a usable frame puts head and hands in the world."""
    assert frame.head is not None
    return BodyPose(
        head_pose(registration, frame.head),
        None if frame.left is None else hand_pose(registration, frame.left),
        None if frame.right is None else hand_pose(registration, frame.right),
    )
