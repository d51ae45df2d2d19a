"""Poses that jump. Where tracking says that a head or a hand moved as nobody can, the body does not follow.

It holds where it was until the pose has been tracked without a jump for a while, and then moves there at leisure. So
does a limb that was not tracked, or whose pose was repeated, and is found elsewhere.
"""

from math import acos, dist, hypot

import msgspec

from avrgym.models.body_names import PARTS, Part
from avrgym.vr.protocol.messages import TICK_S, Tracking, XRPose
from avrgym.vr.tracking.freshness import moves_by_mouse

FASTEST_M_S, FASTEST_RAD_S = 10.0, 30.0
"""What neither heads nor hands of people who are helped exceed."""
SETTLED_S = 0.1
"""So long without a jump, a pose is believed again."""
ABSENT_S = 0.2
"""Who was not tracked for so long may be anywhere."""
RETURN_SHARE = 0.025
"""The share of the fastest speeds at which the body returns to a pose that it did not follow: 0.25 m/s, 0.75 rad/s."""


def least_s(one: XRPose, other: XRPose) -> float:
    """How long it takes at the fastest speeds to get from one pose to another."""
    turned = abs(sum(a * b for a, b in zip(one.orientation, other.orientation, strict=True)))
    cosine = turned / (hypot(*one.orientation) * hypot(*other.orientation))
    angle_rad = 2.0 * acos(min(cosine, 1.0))
    return max(dist(one.position, other.position) / FASTEST_M_S, angle_rad / FASTEST_RAD_S)


def between(one: XRPose, other: XRPose, share: float) -> XRPose:
    """The pose a share of the way from one to another."""
    nearer = (
        1.0 if sum(a * b for a, b in zip(one.orientation, other.orientation, strict=True)) >= 0.0 else -1.0
    )
    x, y, z = (a + share * (b - a) for a, b in zip(one.position, other.position, strict=True))
    turn = [a + share * (nearer * b - a) for a, b in zip(one.orientation, other.orientation, strict=True)]
    length = hypot(*turn)
    qx, qy, qz, qw = (number / length for number in turn)
    return XRPose((x, y, z), (qx, qy, qz, qw))


class Limb:
    """A head or a hand as the body follows it. ``held``: it is not, or not yet, where it is tracked."""

    def __init__(self) -> None:
        self.held = False
        self._tracked: XRPose | None = None
        self._followed: XRPose | None = None
        self._captured_s = self._measured_s = self._believed_s = 0.0

    def see(self, tracked: XRPose, captured_s: float, now_s: float, *, may_repeat: bool = False) -> None:
        """Take the pose of a new frame, captured at a time that never runs ahead of the present.

        A pose that is the same to the last bit is no new measurement, unless it ``may_repeat``.
        """
        measured = may_repeat or tracked != self._tracked
        if self._tracked is not None:
            passed_s = captured_s - self._captured_s
            jumped = least_s(self._tracked, tracked) > passed_s + ROUNDING_S
            absent = measured and captured_s - self._measured_s > ABSENT_S
            self._believed_s = now_s + SETTLED_S if jumped else self._believed_s
            self.held = self.held or jumped or absent
        self._tracked, self._captured_s = tracked, captured_s
        self._measured_s = captured_s if measured else self._measured_s

    def follow(self, now_s: float) -> XRPose:
        """The pose that the body shall have at this tick; there must have been one."""
        assert self._tracked is not None
        if self._followed is None or not self.held:
            self._followed = self._tracked
        elif now_s >= self._believed_s:
            share = RETURN_SHARE * TICK_S / max(least_s(self._followed, self._tracked), ROUNDING_S)
            self.held = share < 1.0
            self._followed = between(self._followed, self._tracked, share) if self.held else self._tracked
        return self._followed


class Limbs:
    """Head and hands of one stay in VR."""

    def __init__(self) -> None:
        self._limbs: dict[Part, Limb] = {part: Limb() for part in PARTS}

    @property
    def held(self) -> tuple[Part, ...]:
        """Which are not where they are tracked."""
        return tuple(part for part, limb in self._limbs.items() if limb.held)

    def see(self, tracking: Tracking, captured_s: float, now_s: float) -> None:
        """Take a new frame; see ``Limb.see``."""
        for part, pose in _tracked(tracking).items():
            may_repeat = moves_by_mouse(tracking, part)
            self._limbs[part].see(pose, captured_s, now_s, may_repeat=may_repeat)

    def follow(self, tracking: Tracking, now_s: float) -> Tracking:
        """The newest frame with the poses that the body shall have at this tick."""
        followed = {part: self._limbs[part].follow(now_s) for part in _tracked(tracking)}
        return msgspec.structs.replace(tracking, **followed)


def _tracked(tracking: Tracking) -> dict[Part, XRPose]:
    poses: tuple[tuple[Part, XRPose | None], ...] = (
        ("head", tracking.head),
        ("left", tracking.left),
        ("right", tracking.right),
    )
    return {part: pose for part, pose in poses if pose is not None}


ROUNDING_S = 1e-6
