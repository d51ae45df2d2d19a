"""Filters jumps of tracked poses. The body does not follow a head or hand that is faster than the maximum speeds.

After a jump, the limb holds its pose until tracking has had no jump for some time. It then moves slowly to the tracked
pose. The same applies after tracking was lost, or repeated a pose, if the tracked limb is then at another position.
"""

from math import acos, dist, hypot

import msgspec

from avrgym.models.body_names import TRACKED_BODY_PARTS, TrackedBodyPart
from avrgym.vr.protocol.messages import TICK_S, TrackingFrameMessage, XRPose
from avrgym.vr.tracking.pose_freshness import is_moved_by_mouse

MAX_LINEAR_SPEED_M_S, MAX_ANGULAR_SPEED_RAD_S = 10.0, 30.0
"""Maximum speeds of head and hands. People who receive assistance move more slowly."""
JUMP_RECOVERY_S = 0.1
"""Time in seconds without a jump after which tracked poses are valid again."""
MAX_UNTRACKED_DURATION_S = 0.2
"""Time in seconds without tracking after which a limb may be at any position."""
RETURN_SPEED_FRACTION = 0.025
"""Share of the maximum speeds with which the body returns to the tracked pose: 0.25 m/s, 0.75 rad/s."""


def compute_min_travel_time_s(one: XRPose, other: XRPose) -> float:
    """Returns the minimum duration in seconds of a motion between two poses, at the maximum speeds."""
    turned = abs(sum(a * b for a, b in zip(one.orientation, other.orientation, strict=True)))
    cosine = turned / (hypot(*one.orientation) * hypot(*other.orientation))
    angle_rad = 2.0 * acos(min(cosine, 1.0))
    return max(dist(one.position, other.position) / MAX_LINEAR_SPEED_M_S, angle_rad / MAX_ANGULAR_SPEED_RAD_S)


def interpolate_poses(one: XRPose, other: XRPose, share: float) -> XRPose:
    """Returns an interpolated pose: the first pose for ``share`` 0, the second pose for ``share`` 1."""
    nearer = (
        1.0 if sum(a * b for a, b in zip(one.orientation, other.orientation, strict=True)) >= 0.0 else -1.0
    )
    x, y, z = (a + share * (b - a) for a, b in zip(one.position, other.position, strict=True))
    turn = [a + share * (nearer * b - a) for a, b in zip(one.orientation, other.orientation, strict=True)]
    length = hypot(*turn)
    qx, qy, qz, qw = (number / length for number in turn)
    return XRPose((x, y, z), (qx, qy, qz, qw))


class PoseFilter:
    """Filters the pose of the head or a hand. ``is_deviating``: whether the filtered pose differs from the tracked
    pose.
    """

    def __init__(self) -> None:
        self.is_deviating = False
        self._tracked: XRPose | None = None
        self._followed: XRPose | None = None
        self._captured_s = self._measured_s = self._valid_from_s = 0.0

    def update(self, tracked: XRPose, captured_s: float, now_s: float, *, may_repeat: bool = False) -> None:
        """Add the pose of a new frame. Its capture time is never after ``now_s``.

        ``may_repeat``: whether an identical pose is a new measurement.
        """
        measured = may_repeat or tracked != self._tracked
        if self._tracked is not None:
            passed_s = captured_s - self._captured_s
            jumped = compute_min_travel_time_s(self._tracked, tracked) > passed_s + ROUNDING_TOLERANCE_S
            absent = measured and captured_s - self._measured_s > MAX_UNTRACKED_DURATION_S
            self._valid_from_s = now_s + JUMP_RECOVERY_S if jumped else self._valid_from_s
            self.is_deviating = self.is_deviating or jumped or absent
        self._tracked, self._captured_s = tracked, captured_s
        self._measured_s = captured_s if measured else self._measured_s

    def compute_filtered_pose(self, now_s: float) -> XRPose:
        """Returns the filtered pose for this tick. Call it once per tick, after the first frame."""
        assert self._tracked is not None
        if self._followed is None or not self.is_deviating:
            self._followed = self._tracked
        elif now_s >= self._valid_from_s:
            share = (
                RETURN_SPEED_FRACTION
                * TICK_S
                / max(compute_min_travel_time_s(self._followed, self._tracked), ROUNDING_TOLERANCE_S)
            )
            self.is_deviating = share < 1.0
            self._followed = (
                interpolate_poses(self._followed, self._tracked, share)
                if self.is_deviating
                else self._tracked
            )
        return self._followed


class PoseFilters:
    """Filters the poses of head and hands, from entering VR until leaving it."""

    def __init__(self) -> None:
        self._limbs: dict[TrackedBodyPart, PoseFilter] = {part: PoseFilter() for part in TRACKED_BODY_PARTS}

    @property
    def deviating_parts(self) -> tuple[TrackedBodyPart, ...]:
        """The parts that are not at their tracked poses."""
        return tuple(part for part, limb in self._limbs.items() if limb.is_deviating)

    def update(self, tracking: TrackingFrameMessage, captured_s: float, now_s: float) -> None:
        """Add a new frame, see ``PoseFilter.update``."""
        for part, pose in _tracked(tracking).items():
            may_repeat = is_moved_by_mouse(tracking, part)
            self._limbs[part].update(pose, captured_s, now_s, may_repeat=may_repeat)

    def compute_filtered_frame(self, tracking: TrackingFrameMessage, now_s: float) -> TrackingFrameMessage:
        """Returns the newest frame, with its poses replaced by the filtered poses for this tick."""
        followed = {part: self._limbs[part].compute_filtered_pose(now_s) for part in _tracked(tracking)}
        return msgspec.structs.replace(tracking, **followed)


def _tracked(tracking: TrackingFrameMessage) -> dict[TrackedBodyPart, XRPose]:
    poses: tuple[tuple[TrackedBodyPart, XRPose | None], ...] = (
        ("head", tracking.head),
        ("left", tracking.left),
        ("right", tracking.right),
    )
    return {part: pose for part, pose in poses if pose is not None}


ROUNDING_TOLERANCE_S = 1e-6
