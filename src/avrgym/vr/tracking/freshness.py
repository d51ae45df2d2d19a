"""Which parts of the body are tracked: a pose that is missing or does not change measures nothing.

A sensor's noise changes every pose. A pose that stays the same to the last bit is one that the device repeats, because
it has lost the part, or sleeps. A mouse has no noise, so its poses count as they are.
"""

from math import inf

from avrgym.models.body_names import PARTS, Part
from avrgym.vr.protocol.messages import Tracking, XRPose

STALE_S = 0.2
"""A pose older than this is stale."""


class Freshness:
    """When each part was last measured."""

    def __init__(self) -> None:
        self._begun = False
        self._poses: dict[Part, XRPose] = {}
        self._measured_s: dict[Part, float] = {}

    def see(self, frame: Tracking, now_s: float) -> None:
        """Take a usable frame that arrives now."""
        self._begun = True
        for part in PARTS:
            pose: XRPose | None = getattr(frame, part)
            if pose is None:
                continue
            if moves_by_mouse(frame, part) or pose != self._poses.get(part):
                self._measured_s[part] = now_s
            self._poses[part] = pose

    def age_s(self, part: Part, now_s: float) -> float:
        """The time since a part was measured; infinite where it never was."""
        return now_s - self._measured_s.get(part, -inf)

    def stale(self, now_s: float) -> tuple[Part, ...]:
        """The parts that were not measured for ``STALE_S``; none before the first frame."""
        return tuple(part for part in PARTS if self._begun and self.age_s(part, now_s) > STALE_S)


def moves_by_mouse(frame: Tracking, part: Part) -> bool:
    """Whether a mouse moves a part: a hand by its modality, and the head together with either hand."""
    modalities = {"left": frame.left_modality, "right": frame.right_modality}
    return modalities[part] == "mouse" if part != "head" else "mouse" in modalities.values()
