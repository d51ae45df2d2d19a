"""Detects untracked parts of the body: missing and repeated poses are not measurements.

Sensor noise changes every measured pose. If a device sleeps or no longer tracks the part, it repeats identical poses. A
mouse has no noise, so its repeated poses are measurements.
"""

from math import inf

from avrgym.models.body_names import TRACKED_BODY_PARTS, TrackedBodyPart
from avrgym.vr.protocol.messages import TrackingFrameMessage, XRPose

STALE_POSE_AGE_S = 0.2
"""Age in seconds above which a pose is stale."""


class MeasurementTimes:
    """The time of the latest measurement of each tracked part of the body."""

    def __init__(self) -> None:
        self._begun = False
        self._poses: dict[TrackedBodyPart, XRPose] = {}
        self._measured_s: dict[TrackedBodyPart, float] = {}

    def update(self, frame: TrackingFrameMessage, now_s: float) -> None:
        """Add a usable frame that arrives now. Its changed poses are new measurements."""
        self._begun = True
        for part in TRACKED_BODY_PARTS:
            pose: XRPose | None = getattr(frame, part)
            if pose is None:
                continue
            if is_moved_by_mouse(frame, part) or pose != self._poses.get(part):
                self._measured_s[part] = now_s
            self._poses[part] = pose

    def compute_pose_age_s(self, part: TrackedBodyPart, now_s: float) -> float:
        """Returns the time in seconds since the part's latest measurement; infinite without a measurement."""
        return now_s - self._measured_s.get(part, -inf)

    def find_stale_parts(self, now_s: float) -> tuple[TrackedBodyPart, ...]:
        """Returns the parts without a measurement for ``STALE_POSE_AGE_S``; empty before the first frame."""
        return tuple(
            part
            for part in TRACKED_BODY_PARTS
            if self._begun and self.compute_pose_age_s(part, now_s) > STALE_POSE_AGE_S
        )


def is_moved_by_mouse(frame: TrackingFrameMessage, part: TrackedBodyPart) -> bool:
    """Returns whether a mouse moves a body part: a hand with the modality ``mouse``, or the head if it moves a hand."""
    modalities = {"left": frame.left_modality, "right": frame.right_modality}
    return modalities[part] == "mouse" if part != "head" else "mouse" in modalities.values()
