"""How tall a participant's torso is, from the height of their headset, and how long their arms are, from their reach.

The torso leans back as the real back does that it rests against. So its height, from the hips to the centre of the
head, is what the head stands above the hips over the sine of the back's angle (paper, section III, for an upright
back). The hips rest as high above the real seat or mattress as the model's above the virtual one.

Arms are stretched to the front and out to the sides. To the front shoulders come along, to the sides they do not; the
mean of both is what the model's arms, whose shoulders stay, serve best with.
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
from avrgym.models.human import PROPORTIONS, SEATED, Person, Posture, Sex
from avrgym.models.human.person import check_arm_scale
from avrgym.texts.interface_texts import Text, TextError
from avrgym.vr.protocol.messages import XRPose
from avrgym.vr.protocol.webxr import Pose, Registration, head_pose
from avrgym.vr.tracking.arm import ArmLengths
from avrgym.vr.tracking.body import BodyPose, hips_frame, skeleton, torso_angles


def measure_torso_height(sex: Sex, posture: Posture, head: XRPose, furniture: RealFurniture) -> float:
    """Torso height in metres from a headset at rest.

    Args:
        sex: of the model.
        posture: how the participant rests.
        head: the headset's pose above the real floor.
        furniture: what they rest on.

    Raises:
        TextError: for a height that no adult has, naming what is allowed.
    """
    height_m = float(head_pose(Registration(np.zeros(3), 0.0), head).pos_w[2])
    hips_m = posture.hips(PROPORTIONS[sex])[2] + furniture.rise_m(posture)
    upright = sin(radians(furniture.back_deg(posture)))
    low, high = (hips_m + upright * limit for limit in human.TORSO_HEIGHT_RANGE_M)
    if not low <= height_m <= high:
        key, rests_m = (
            ("wrong_height_seated", furniture.seat_height_m)
            if posture is SEATED
            else ("wrong_height_lying", furniture.mattress_height_m)
        )
        heights = {"height_m": height_m, "low_m": low, "high_m": high}
        values = {name: f"{metres:.2f}" for name, metres in heights.items()}
        raise TextError(Text(key, values | {"rests_cm": f"{100.0 * rests_m:.0f}"}))
    return float((height_m - hips_m) / upright)


def arm_length_m(person: Person, posture: Posture, pose: BodyPose) -> float | None:
    """How far the farther of two wrists is from the shoulder of a person, metres; ``None`` where no hand is tracked."""
    measures = skeleton(person, posture)
    hips_w, hips_axes_w = hips_frame(person, posture)
    torso_axes_w = hips_axes_w @ from_euler_xyz(*torso_angles(person, pose.head, posture)[:3].tolist())
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
    """By how much a person's arms are longer than those of most, from wrists' distances to the shoulder in each pose.

    Raises:
        ValueError: for arms that no adult has, or where a pose lacks, naming what is allowed.
    """
    most = ArmLengths.of(replace(person, arm_scale=1.0))
    fixed_m = PROPORTIONS[person.sex].forearm_radius
    scale = (fmean(reached_m) - fixed_m) / (most.upper_m + most.fore_m - fixed_m)
    check_arm_scale(scale)
    return scale
