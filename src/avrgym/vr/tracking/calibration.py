"""Calibration: a participant's torso height from the headset's height, and arm length from the reach of the wrists.

The torso leans back like the real backrest. The torso height is the distance from the hips to the centre of the head.
It is the head's height above the hips, divided by the sine of the backrest's angle (paper, section III, for an upright
back). The height of the hips above the seat or mattress is assumed to be that of the model.

Participants stretch their arms to the front and to the sides. The shoulders move when the arms reach to the front, but
not when they reach to the sides. The model's shoulders are fixed. The model's arms therefore have the mean of both
lengths.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import radians, sin
from statistics import fmean

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.rotation_matrices import from_euler_xyz, from_quaternion
from avrgym.models import human
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import BODY_DIMENSIONS, Person, Posture, Sex
from avrgym.models.human.person import check_arm_scale
from avrgym.texts.interface_texts import ParticipantActionError, ParticipantText
from avrgym.vr.protocol.messages import XRPose
from avrgym.vr.protocol.webxr import Pose, Registration, compute_head_pose
from avrgym.vr.tracking.arm import ArmLengths
from avrgym.vr.tracking.body import BodyPose, compute_hips_frame, make_skeleton, solve_torso_angles


def measure_torso_height(sex: Sex, posture: Posture, head: XRPose, furniture: RealFurniture) -> float:
    """Returns the torso height in metres, computed from the pose of a headset at rest.

    Args:
        sex: sex of the model.
        posture: posture of the participant.
        head: the headset's pose above the real floor.
        furniture: the real seat or bed.

    Raises:
        TextError: for a height outside the range of adults. The message contains the range.
    """
    height_m = float(compute_head_pose(Registration(np.zeros(3), 0.0), head).pos_w[2])
    hips_m = posture.compute_hips_origin(BODY_DIMENSIONS[sex])[2] + furniture.compute_height_offset_m(posture)
    hips_m += furniture.compute_head_rise_m(posture)
    upright = sin(radians(furniture.get_backrest_angle_deg(posture)))
    low, high = (hips_m + upright * limit for limit in human.TORSO_HEIGHT_RANGE_M)
    if not low <= height_m <= high:
        key, rests_m = (
            ("wrong_height_seated", furniture.seat_height_m)
            if posture.is_seated
            else ("wrong_height_lying", furniture.mattress_height_m)
        )
        heights = {"height_m": height_m, "low_m": low, "high_m": high}
        values = {name: f"{metres:.2f}" for name, metres in heights.items()}
        raise ParticipantActionError(ParticipantText(key, values | {"rests_cm": f"{100.0 * rests_m:.0f}"}))
    return float((height_m - hips_m) / upright)


def measure_arm_length_m(person: Person, posture: Posture, pose: BodyPose) -> float | None:
    """Returns the distance in metres of the farther wrist from its shoulder; ``None`` without a tracked hand."""
    measures = make_skeleton(person, posture)
    hips_w, hips_axes_w = compute_hips_frame(person, posture)
    torso_axes_w = hips_axes_w @ from_euler_xyz(
        *solve_torso_angles(person, pose.head_pose, posture)[:3].tolist()
    )
    waist_w = hips_w + hips_axes_w @ np.array(measures.waist)
    far_m = [
        float(np.linalg.norm(_wrist_w(hand, measures.hand_m) - waist_w - torso_axes_w @ (side * shoulder)))
        for hand, side in ((pose.right, _RIGHT), (pose.left, _LEFT))
        if hand is not None
        for shoulder in (np.array(measures.right_shoulder),)
    ]
    return max(far_m, default=None)


_RIGHT, _LEFT = np.array([1.0, 1.0, 1.0]), np.array([-1.0, 1.0, 1.0])


def _wrist_w(hand: Pose, hand_m: float) -> FloatArray:
    return hand.pos_w + hand_m * from_quaternion(hand.q_w)[:, 2]


def measure_arm_scale(person: Person, reached_m: Sequence[float]) -> float:
    """Returns the scale of a person's arms. ``reached_m``: the wrist's distance from the shoulder in each pose.

    Raises:
        ValueError: for arms outside the range of adults, or a missing pose. The message contains the allowed values.
    """
    most = ArmLengths.from_person(replace(person, arm_scale=1.0))
    fixed_m = BODY_DIMENSIONS[person.sex].forearm_radius_m
    scale = (fmean(reached_m) - fixed_m) / (most.upper_arm_m + most.forearm_m - fixed_m)
    check_arm_scale(scale)
    return scale
