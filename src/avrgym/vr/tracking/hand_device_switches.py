"""Smooth switches between tracking devices of a hand: controller and bare hand.

The estimates of two devices for the same hand differ by some centimetres and tens of degrees. A resting hand must not
move at a switch. The pose of every hand is therefore converted to a grip pose. After a switch, the new device's poses
are corrected by the difference of both estimates. While the hand moves, the correction decreases. The decrease is too
slow to be noticed.

``client/src/tracking/modality-switch.ts`` implements the same rule for the arms that the client draws.
"""

from dataclasses import dataclass

import msgspec
import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.body_names import Side
from avrgym.vr.protocol.messages import Modality, TrackingFrameMessage, XRPose
from avrgym.vr.protocol.webxr import convert_wrist_to_grip

MAX_DEVICE_OFFSET_M, MAX_DEVICE_OFFSET_RAD = 0.15, float(np.radians(75.0))
"""Maximum position and rotation difference between two devices that track the same resting hand."""
MAX_SWITCH_GAP_S = 2.0
"""Maximum time in seconds between the last pose of the old device and the first pose of the new device. Within this
time, a resting hand is assumed not to move."""
MAX_REST_DISPLACEMENT_M = 0.02
"""Maximum displacement in metres of a hand that is considered at rest."""
CORRECTION_DECAY_PER_M = 0.1
"""Decrease of the correction, in metres, per metre of the hand's motion."""
CHARACTERISTIC_LENGTH_M = 0.15
"""Length in metres: a rotation in radians times this length is treated as a displacement in metres."""


@dataclass(frozen=True)
class GripCorrection:
    """The transform from the current device's grip to the corrected grip: position (3,), rotation vector (3,)."""

    translation: FloatArray
    rotation_rad: FloatArray

    @property
    def size_m(self) -> float:
        """The size of the correction in metres, including its rotation."""
        return max(float(np.linalg.norm(self.translation)), CHARACTERISTIC_LENGTH_M * self.angle_rad)

    @property
    def angle_rad(self) -> float:
        """The rotation angle of the correction in radians."""
        return float(np.linalg.norm(self.rotation_rad))

    @property
    def is_plausible(self) -> bool:
        """Whether the correction is within the maximum difference of two devices that track the same hand."""
        return (
            float(np.linalg.norm(self.translation)) <= MAX_DEVICE_OFFSET_M
            and self.angle_rad <= MAX_DEVICE_OFFSET_RAD
        )

    def reduce_by_motion(self, way_m: float) -> "GripCorrection | None":
        """Returns the remaining correction after the hand has moved by ``way_m`` metres; ``None`` if the correction is
        zero."""
        left = 1.0 - CORRECTION_DECAY_PER_M * way_m / self.size_m if self.size_m > 0.0 else 0.0
        return GripCorrection(left * self.translation, left * self.rotation_rad) if left > 0.0 else None

    def apply(self, grip: XRPose) -> XRPose:
        """Returns the grip pose, with this correction applied."""
        pos, q, turn = np.empty(3), np.empty(4), np.empty(4)
        angle_rad = self.angle_rad
        axis = self.rotation_rad / angle_rad if angle_rad > 0.0 else np.array([1.0, 0.0, 0.0])
        mujoco.mju_axisAngle2Quat(turn, axis, angle_rad)
        mujoco.mju_mulPose(pos, q, *_arrays(grip), self.translation, turn)
        return _pose(pos, q)


def compute_grip_correction(grip: XRPose, followed: XRPose) -> GripCorrection:
    """Returns the correction that transforms the pose ``grip`` to the pose ``followed``."""
    there, there_q = transforms.invert(*_arrays(grip))
    pos, q, turn_rad = np.empty(3), np.empty(4), np.empty(3)
    mujoco.mju_mulPose(pos, q, there, there_q, *_arrays(followed))
    mujoco.mju_quat2Vel(turn_rad, q, 1.0)
    return GripCorrection(pos, turn_rad)


class HandDevice:
    """The current tracking device of one hand, and the correction after a switch."""

    def __init__(self, side: Side) -> None:
        self._side: Side = side
        self._modality: Modality = "none"
        self._followed: XRPose | None = None
        self._seen_s = 0.0
        self._correction: GripCorrection | None = None
        self._rested = np.zeros(3)

    def correct_grip(self, pose: XRPose, modality: Modality, captured_s: float) -> XRPose:
        """Returns the grip pose, corrected after a switch between controller and hand tracking.

        Before the first switch, a controller's pose is returned unchanged.
        """
        grip = convert_wrist_to_grip(pose, self._side) if modality == "hand" else pose
        if modality != self._modality and self._followed is not None:
            self._switch(grip, self._followed, captured_s - self._seen_s)
        elif self._correction is not None:
            self._fade(grip, self._correction)
        self._modality, self._seen_s = modality, captured_s
        self._followed = grip if self._correction is None else self._correction.apply(grip)
        return self._followed

    def _switch(self, grip: XRPose, followed: XRPose, gap_s: float) -> None:
        found = compute_grip_correction(grip, followed)
        self._correction = found if found.is_plausible and gap_s <= MAX_SWITCH_GAP_S else None
        self._rested = np.array(grip.position)

    def _fade(self, grip: XRPose, correction: GripCorrection) -> None:
        way_m = float(np.linalg.norm(np.array(grip.position) - self._rested))
        if way_m > MAX_REST_DISPLACEMENT_M:
            self._correction, self._rested = correction.reduce_by_motion(way_m), np.array(grip.position)


class HandDevices:
    """The devices and corrections of both hands, from entering VR until leaving it."""

    def __init__(self) -> None:
        self._left, self._right = HandDevice("left"), HandDevice("right")

    def correct_frame(self, tracking: TrackingFrameMessage, captured_s: float) -> TrackingFrameMessage:
        """Returns the frame, with its hand poses replaced by the corrected grips."""
        return msgspec.structs.replace(
            tracking,
            left=_grip(self._left, tracking.left, tracking.left_modality, captured_s),
            right=_grip(self._right, tracking.right, tracking.right_modality, captured_s),
            left_modality=_held(tracking.left_modality),
            right_modality=_held(tracking.right_modality),
        )


def _grip(hand: HandDevice, pose: XRPose | None, modality: Modality, captured_s: float) -> XRPose | None:
    return None if pose is None else hand.correct_grip(pose, modality, captured_s)


def _held(modality: Modality) -> Modality:
    """Returns the modality of a hand after its pose was converted to a grip pose: a bare hand becomes a controller."""
    return "controller" if modality == "hand" else modality


def _arrays(pose: XRPose) -> tuple[FloatArray, FloatArray]:
    x, y, z, w = pose.orientation
    return np.array(pose.position), transforms.normalize([w, x, y, z])


def _pose(pos: FloatArray, q: FloatArray) -> XRPose:
    (px, py, pz), (w, x, y, z) = pos.tolist(), q.tolist()
    return XRPose((px, py, pz), (x, y, z, w))
