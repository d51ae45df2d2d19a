"""Conversion of WebXR poses to the simulation's world frame and back. No other module of the server converts poses.

WebXR's ``local-floor`` space: y up, x right, −z forward, quaternions x, y, z, w. World frame: z up, quaternions
w, x, y, z; the person sits at its origin and faces −y.
"""

from dataclasses import dataclass
from functools import cached_property
from math import hypot

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.body_names import Side
from avrgym.models.human import DEVICE_TO_BODY_QUAT, HEADSET_OFFSET_M
from avrgym.vr.protocol.messages import XRPose

MAX_ORIGIN_DISTANCE_M = 10.0
UNIT_QUATERNION_TOLERANCE = 1e-2

Z_UP_FROM_Y_UP = transforms.from_axis_angle([1.0, 0.0, 0.0], np.asarray(0.5 * np.pi))
WRIST_TO_HAND_DISTANCE_M = 0.08
"""Distance in metres from a tracked wrist to the centre of the hand (Assistive VR Gym, 2020)."""


@dataclass(frozen=True)
class Pose:
    """A pose in the world frame: position (3,) in metres, quaternion (4,) w, x, y, z."""

    pos_w: FloatArray
    q_w: FloatArray


@dataclass(frozen=True)
class Registration:
    """The pose of WebXR's ``local-floor`` space in the world frame: its origin (3,) and the yaw of its axes."""

    origin_w: FloatArray
    yaw_rad: float

    @cached_property
    def q_w(self) -> FloatArray:
        """The rotation from ``local-floor`` axes to world axes, as a quaternion (4,) w, x, y, z."""
        yaw = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(self.yaw_rad))
        return transforms.multiply(yaw, Z_UP_FROM_Y_UP)

    def to_world(self, pose: XRPose) -> Pose:
        """Returns a device's pose in the world frame. The device's own axes are those of WebXR: y up, −z forward."""
        x, y, z, w = pose.orientation
        return _compose(Pose(self.origin_w, self.q_w), np.array(pose.position), np.array([w, x, y, z]))

    def from_world(self, pose: Pose) -> XRPose:
        """Returns a world pose in the ``local-floor`` space; the inverse of ``to_world``."""
        local = _compose(self._inverse, pose.pos_w, pose.q_w)
        w, x, y, z = local.q_w.tolist()
        return XRPose(tuple(local.pos_w.tolist()), (x, y, z, w))

    @cached_property
    def _inverse(self) -> Pose:
        return Pose(*transforms.invert(self.origin_w, self.q_w))

    def xr_from_world(self) -> XRPose:
        """Returns the pose of the world frame in ``local-floor``. A client places the scene at this pose."""
        return self.from_world(Pose(np.zeros(3), transforms.IDENTITY_QUATERNION))


def compute_registration(head: XRPose, head_centre_w: FloatArray) -> Registration:
    """Returns the registration that places the participant's head at ``head_centre_w``, with the nose towards −y.

    The real and the simulated head then coincide, and also the real and the simulated seat. If the seats have different
    heights, the real floor is above or below the simulated floor.
    """
    upright = compute_head_pose(Registration(np.zeros(3), 0.0), head)
    ahead = transforms.rotate(upright.q_w, [0.0, -1.0, 0.0])
    yaw = -0.5 * np.pi - np.arctan2(ahead[1], ahead[0])
    turned = transforms.rotate(transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(yaw)), upright.pos_w)
    return Registration(head_centre_w - turned, float(yaw))


def compute_head_pose(registration: Registration, head: XRPose) -> Pose:
    """Returns the head's pose in the world frame (its centre and axes), computed from the headset's pose."""
    return _compose(registration.to_world(head), HEAD_CENTRE_FROM_HEADSET, DEVICE_TO_BODY_QUAT)


HEAD_CENTRE_FROM_HEADSET = transforms.rotate(DEVICE_TO_BODY_QUAT, [0.0, HEADSET_OFFSET_M, 0.0])


def compute_hand_pose(registration: Registration, grip: XRPose) -> Pose:
    """Returns the hand's pose in the world frame (centre of the fist, and axes), computed from a controller's grip
    pose.

    The origin of WebXR's grip space is the centre of the fist. The position therefore needs no offset.
    """
    return _compose(registration.to_world(grip), np.zeros(3), DEVICE_TO_BODY_QUAT)


def compute_hand_pose_from_wrist(registration: Registration, wrist: XRPose, side: Side) -> Pose:
    """Returns the hand's pose in the world frame (centre and axes), computed from the wrist pose of a bare hand.

    Axes of the WebXR wrist (WebXR Hand Input): −z points to the fingers, y points out of the back of the hand. Axes of
    the simulated hand: −z points to the fingers too, x points out of the back of a left hand.
    """
    return _compose(registration.to_world(wrist), HAND_CENTRE_FROM_WRIST, HAND_FROM_WRIST_AXES[side])


HAND_CENTRE_FROM_WRIST = np.array([0.0, 0.0, -WRIST_TO_HAND_DISTANCE_M])

HAND_FROM_WRIST_AXES = {
    side: transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(turn))
    for side, turn in (("left", 0.5 * np.pi), ("right", -0.5 * np.pi))
}


def convert_wrist_to_grip(wrist: XRPose, side: Side) -> XRPose:
    """Returns the grip pose that results in the same hand pose as a wrist pose."""
    x, y, z, w = wrist.orientation
    seen = Pose(np.array(wrist.position), np.array([w, x, y, z]))
    grip = _compose(seen, HAND_CENTRE_FROM_WRIST, GRIP_FROM_WRIST_AXES[side])
    w, x, y, z = grip.q_w.tolist()
    return XRPose(tuple(grip.pos_w.tolist()), (x, y, z, w))


def convert_head_to_headset(registration: Registration, head: Pose) -> XRPose:
    """Returns the headset's pose, computed from the pose of the head; the inverse of ``compute_head_pose``."""
    return registration.from_world(_compose(head, _HEADSET_FROM_HEAD_CENTRE, _DEVICE_FROM_BODY_AXES))


_HEADSET_FROM_HEAD_CENTRE = np.array([0.0, -HEADSET_OFFSET_M, 0.0])


def convert_hand_to_grip(registration: Registration, hand: Pose) -> XRPose:
    """Returns the grip pose, computed from the pose of the hand; the inverse of ``compute_hand_pose``."""
    return registration.from_world(_compose(hand, np.zeros(3), _DEVICE_FROM_BODY_AXES))


_DEVICE_FROM_BODY_AXES = transforms.conjugate(DEVICE_TO_BODY_QUAT)
GRIP_FROM_WRIST_AXES = {
    side: transforms.multiply(turn, _DEVICE_FROM_BODY_AXES) for side, turn in HAND_FROM_WRIST_AXES.items()
}


def _compose(outer: Pose, pos: FloatArray, q: FloatArray) -> Pose:
    """Returns the world pose of position ``pos`` (3,) and quaternion ``q`` (4,) in the frame ``outer``.

    This function is faster than ``transforms.compose``.
    """
    pos_w, q_w = np.empty(3), np.empty(4)
    mujoco.mju_mulPose(pos_w, q_w, outer.pos_w, outer.q_w, pos, q)
    return Pose(pos_w, q_w)


def compute_controller_pose(grip: XRPose, xr_from_world: XRPose) -> Pose | None:
    """Returns the pose of a controller's grip in the world frame; ``None`` if one of the poses is invalid.

    ``xr_from_world``: pose of the world frame in the ``local-floor`` space of the grip's owner.
    """
    if not (is_valid_pose(grip) and is_valid_pose(xr_from_world)):
        return None
    (x, y, z, w), (vx, vy, vz, vw) = grip.orientation, xr_from_world.orientation
    world_from_xr = transforms.invert(np.array(xr_from_world.position), np.array([vw, vx, vy, vz]))
    return _compose(Pose(*world_from_xr), np.array(grip.position), np.array([w, x, y, z]))


def is_valid_pose(pose: XRPose) -> bool:
    """Returns whether a pose is finite, within 10 m of the origin, and has a unit quaternion."""
    within = all(abs(number) <= MAX_ORIGIN_DISTANCE_M for number in (*pose.position, *pose.orientation))
    return within and abs(hypot(*pose.orientation) - 1.0) < UNIT_QUATERNION_TOLERANCE
