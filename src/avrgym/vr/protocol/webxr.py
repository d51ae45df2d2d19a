"""WebXR poses to the simulation's world and back: the only place where conventions change on the server.

WebXR's ``local-floor`` space is y up, x right, −z ahead, quaternions x, y, z, w. The world is z up,
quaternions w, x, y, z; the person sits at its origin and faces −y.
"""

from dataclasses import dataclass
from functools import cached_property
from math import hypot
from typing import Literal

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.human import BODY_FROM_DEVICE_AXES, HEADSET_AHEAD_M
from avrgym.vr.protocol.messages import XRPose

MAX_DISTANCE_M = 10.0
UNIT_TOLERANCE = 1e-2

Z_UP_FROM_Y_UP = transforms.from_axis_angle([1.0, 0.0, 0.0], np.asarray(0.5 * np.pi))
WRIST_TO_HAND_M = 0.08
"""The hand's centre lies about 8 cm from a tracked wrist (2020 reference)."""


@dataclass(frozen=True)
class Pose:
    """A pose in the world: position (3,) in metres, quaternion (4,) w, x, y, z."""

    pos_w: FloatArray
    q_w: FloatArray


@dataclass(frozen=True)
class Registration:
    """Where ``local-floor`` lies in the world: its origin (3,) and the yaw of its axes."""

    origin_w: FloatArray
    yaw_rad: float

    @cached_property
    def q_w(self) -> FloatArray:
        """The rotation (4,) from ``local-floor`` axes to world axes."""
        yaw = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(self.yaw_rad))
        return transforms.multiply(yaw, Z_UP_FROM_Y_UP)

    def to_world(self, pose: XRPose) -> Pose:
        """A device's pose in the world, in the device's own axes."""
        x, y, z, w = pose.orientation
        return _compose(Pose(self.origin_w, self.q_w), np.array(pose.position), np.array([w, x, y, z]))

    def from_world(self, pose: Pose) -> XRPose:
        """The inverse of ``to_world``."""
        local = _compose(self._inverse, pose.pos_w, pose.q_w)
        w, x, y, z = local.q_w.tolist()
        return XRPose(tuple(local.pos_w.tolist()), (x, y, z, w))

    @cached_property
    def _inverse(self) -> Pose:
        return Pose(*transforms.invert(self.origin_w, self.q_w))

    def xr_from_world(self) -> XRPose:
        """The world's origin as a pose in ``local-floor``: where a client places the scene."""
        return self.from_world(Pose(np.zeros(3), transforms.IDENTITY_QUATERNION))


def register(head: XRPose, head_centre_w: FloatArray) -> Registration:
    """Put the participant's head at ``head_centre_w`` with their gaze along −y.

    The heads agree, and so do the seats: the floors then lie apart by as much as the seats' heights differ.
    """
    upright = head_pose(Registration(np.zeros(3), 0.0), head)
    ahead = transforms.rotate(upright.q_w, [0.0, -1.0, 0.0])
    yaw = -0.5 * np.pi - np.arctan2(ahead[1], ahead[0])
    turned = transforms.rotate(transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(yaw)), upright.pos_w)
    return Registration(head_centre_w - turned, float(yaw))


def head_pose(registration: Registration, head: XRPose) -> Pose:
    """The centre of the head and the head's axes from the headset's pose."""
    return _compose(registration.to_world(head), HEAD_CENTRE_FROM_HEADSET, BODY_FROM_DEVICE_AXES)


HEAD_CENTRE_FROM_HEADSET = transforms.rotate(BODY_FROM_DEVICE_AXES, [0.0, HEADSET_AHEAD_M, 0.0])


def hand_pose(registration: Registration, grip: XRPose) -> Pose:
    """The centre of the fist and the hand's axes from a grip pose.

    The grip's origin is where a rod would be held, in the middle of the fist, so nothing is added; the 8 cm of the
    2020 reference lead there from the pose of its trackers.
    """
    return _compose(registration.to_world(grip), np.zeros(3), BODY_FROM_DEVICE_AXES)


def hand_pose_from_wrist(registration: Registration, wrist: XRPose, side: Literal["left", "right"]) -> Pose:
    """The centre of the hand and its axes from the wrist of a tracked hand.

    Of a wrist −z points to the fingers and y out of the hand's back (WebXR Hand Input); our hand's −z points to the
    fingers too, and its x to the person's left, which is out of a hanging left hand's back.
    """
    return _compose(registration.to_world(wrist), HAND_CENTRE_FROM_WRIST, HAND_FROM_WRIST_AXES[side])


HAND_CENTRE_FROM_WRIST = np.array([0.0, 0.0, -WRIST_TO_HAND_M])

HAND_FROM_WRIST_AXES = {
    side: transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(turn))
    for side, turn in (("left", 0.5 * np.pi), ("right", -0.5 * np.pi))
}


def grip_from_wrist(wrist: XRPose, side: Literal["left", "right"]) -> XRPose:
    """The grip pose of which ``hand_pose`` makes the hand that ``hand_pose_from_wrist`` makes of a wrist."""
    x, y, z, w = wrist.orientation
    seen = Pose(np.array(wrist.position), np.array([w, x, y, z]))
    grip = _compose(seen, HAND_CENTRE_FROM_WRIST, GRIP_FROM_WRIST_AXES[side])
    w, x, y, z = grip.q_w.tolist()
    return XRPose(tuple(grip.pos_w.tolist()), (x, y, z, w))


def headset_from_head(registration: Registration, head: Pose) -> XRPose:
    """The inverse of ``head_pose``."""
    return registration.from_world(_compose(head, _HEADSET_FROM_HEAD_CENTRE, _DEVICE_FROM_BODY_AXES))


_HEADSET_FROM_HEAD_CENTRE = np.array([0.0, -HEADSET_AHEAD_M, 0.0])


def grip_from_hand(registration: Registration, hand: Pose) -> XRPose:
    """The inverse of ``hand_pose``."""
    return registration.from_world(_compose(hand, np.zeros(3), _DEVICE_FROM_BODY_AXES))


_DEVICE_FROM_BODY_AXES = transforms.conjugate(BODY_FROM_DEVICE_AXES)
GRIP_FROM_WRIST_AXES = {
    side: transforms.multiply(turn, _DEVICE_FROM_BODY_AXES) for side, turn in HAND_FROM_WRIST_AXES.items()
}


def _compose(outer: Pose, pos: FloatArray, q: FloatArray) -> Pose:
    """``transforms.compose`` of one pose, in a tenth of its time; ``pos`` (3,), ``q`` (4,) are in the outer frame."""
    pos_w, q_w = np.empty(3), np.empty(4)
    mujoco.mju_mulPose(pos_w, q_w, outer.pos_w, outer.q_w, pos, q)
    return Pose(pos_w, q_w)


def is_valid(pose: XRPose) -> bool:
    """Whether a pose can be one of a person in a room: finite, within 10 m, a unit quaternion."""
    within = all(abs(number) <= MAX_DISTANCE_M for number in (*pose.position, *pose.orientation))
    return within and abs(hypot(*pose.orientation) - 1.0) < UNIT_TOLERANCE
