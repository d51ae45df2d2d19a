"""Inverse kinematics: from the poses of head and hands to the 20 joint angles of the simulated body."""

from dataclasses import dataclass
from functools import lru_cache
from math import atan2, cos, radians, sin

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.rotation_matrices import from_euler_xyz, from_quaternion, to_euler_xyz
from avrgym.models import human
from avrgym.models.human import (
    BODY_DIMENSIONS,
    JOINT_INDEX,
    LOWER_LIMITS_RAD,
    SEATED_POSTURE,
    UPPER_LIMITS_RAD,
    Person,
    Posture,
    Sex,
)
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.webxr import Pose
from avrgym.vr.tracking.arm import ARM_JOINTS, MAX_TICK_ROTATION_RAD, ArmLengths, ArmSolver

WAIST_YAW_FRACTION = 0.3
"""Share of the head's yaw that the waist performs (paper, section III)."""

WAIST_JOINT_INDICES = [JOINT_INDEX[f"waist_{axis}"] for axis in "xyz"]
HEAD_JOINT_INDICES = [JOINT_INDEX[f"head_{axis}"] for axis in "xyz"]
WAIST_RANGES_RAD, HEAD_RANGES_RAD = (
    list(zip(LOWER_LIMITS_RAD[joints].tolist(), UPPER_LIMITS_RAD[joints].tolist(), strict=True))
    for joints in (WAIST_JOINT_INDICES, HEAD_JOINT_INDICES)
)
ARM_JOINT_INDICES = {
    side: [JOINT_INDEX[f"{side}_{part}"] for part in ARM_JOINTS] for side in ("right", "left")
}


@dataclass(frozen=True)
class BodyPose:
    """The poses of the participant's head and hands; an untracked hand is ``None``."""

    head_pose: Pose
    left: Pose | None
    right: Pose | None


def compute_resting_head_centre(person: Person, posture: Posture) -> FloatArray:
    """Returns the head's centre (3,) at rest, in metres in the world frame.

    The person sits upright, or lies with the back on the bed.
    """
    pos_w, axes_w = compute_hips_frame(person, posture)
    return pos_w + person.torso_height_m * axes_w[:, 2]


def compute_hips_frame(person: Person, posture: Posture) -> tuple[FloatArray, FloatArray]:
    """Returns the frame of the hips in the world: their origin (3,) and their axes (3, 3) as columns."""
    return _hips_frame(person.sex, posture)


def make_skeleton(person: Person, posture: Posture) -> messages.Skeleton:
    """Returns the body dimensions with which a client computes the same inverse kinematics as ``BodySolver``."""
    frames = human.compute_body_layout(
        np.array([person.sex == "woman"]), np.array([person.torso_height_m]), posture
    )
    lengths = ArmLengths.from_person(person)
    hips, waist, neck, shoulder = (
        (float(x), float(y), float(z))
        for x, y, z in (frames.body_pos[name][0] for name in ("hips", "torso", "head", "right_upper_arm"))
    )
    half_turn = 0.5 * radians(posture.hips_deg)
    return messages.Skeleton(
        hips_pos_w=hips,
        hips_q_w=(cos(half_turn), sin(half_turn), 0.0, 0.0),
        waist=waist,
        neck=neck,
        head_centre_m=float(frames.site_pos["head_centre"][0, 2]),
        right_shoulder=shoulder,
        upper_arm_m=lengths.upper_arm_m,
        forearm_m=lengths.forearm_m,
        hand_m=lengths.wrist_to_hand_length_m,
    )


@lru_cache
def _hips_frame(sex: Sex, posture: Posture) -> tuple[FloatArray, FloatArray]:
    return posture.compute_hips_origin(BODY_DIMENSIONS[sex]), from_euler_xyz(
        radians(posture.hips_deg), 0.0, 0.0
    )


def solve_torso_angles(person: Person, head: Pose, posture: Posture = SEATED_POSTURE) -> FloatArray:
    """Returns joint angles (6,) in radians that bring the head to its pose: waist x, y, z, head x, y, z.

    All angles are within the joint ranges.

    The waist bends until the head joints are on the line from the waist to their tracked position. With joints in the
    order x, y, z the torso points along (sin b, −sin a cos b, cos a cos b). Let ψ be the vector from waist to head
    joints in the hips' frame; then a = −atan2(ψy, ψz) and b = atan2(ψx cos a, ψz) (paper, section III, which uses the
    head's centre). The yaw is divided between waist and head. The head joints perform the rest of the rotation. The
    head's orientation is therefore exact within the ranges of its joints, even if the waist is at a limit.

    The torso is rigid between waist and head joints. The head's position error is therefore the difference between the
    torso's length and the tracked distance. No other angles with this head direction have a smaller error.
    """
    p = BODY_DIMENSIONS[person.sex]
    scale = person.torso_height_m / p.torso_height_m
    hips_w, hips_axes_w = compute_hips_frame(person, posture)
    head_axes = hips_axes_w.T @ from_quaternion(head.q_w)
    psi = hips_axes_w.T @ (head.pos_w - hips_w) - p.head_centre_offset_z_m * scale * head_axes[:, 2]
    x, y, z = psi.tolist()
    z -= p.waist_offset_z_m * scale
    a = -atan2(y, z)
    b = atan2(x * cos(a), z)
    a, b, _ = _limited(WAIST_RANGES_RAD, (a, b, 0.0))
    yaw = WAIST_YAW_FRACTION * to_euler_xyz(from_euler_xyz(a, b, 0.0).T @ head_axes)[2]
    waist = _limited(WAIST_RANGES_RAD, (a, b, yaw))
    return np.array([*waist, *_limited(HEAD_RANGES_RAD, to_euler_xyz(from_euler_xyz(*waist).T @ head_axes))])


def _limited(
    ranges_rad: list[tuple[float, float]], angles_rad: tuple[float, float, float]
) -> tuple[float, float, float]:
    x, y, z = (min(max(a, lower), upper) for a, (lower, upper) in zip(angles_rad, ranges_rad, strict=True))
    return x, y, z


@dataclass(frozen=True, eq=False)
class _Aim:
    """The targets of the inverse kinematics: the torso's angles (6,), and the hand poses of A arms.

    ``arms`` (A, 7) are indices of the arms' joints; ``hand_pos`` (A, 3) and ``hand_axes`` (A, 3, 3) are in the frame of
    the right shoulder; a left hand is reflected. ``reflect`` (A, 7): signs of the joint angles of a reflected arm.
    """

    torso_rad: FloatArray
    arms: list[list[int]]
    hand_pos: FloatArray
    hand_axes: FloatArray
    reflect: FloatArray


class BodySolver:
    """The inverse kinematics of one person.

    Call ``solve`` with every tracking frame. The result depends only on the arguments (stateless).
    """

    def __init__(self, person: Person, posture: Posture = SEATED_POSTURE) -> None:
        self.person, self.posture = person, posture
        frames = human.compute_body_layout(
            np.array([person.sex == "woman"]), np.array([person.torso_height_m])
        )
        self._waist_h, self._shoulder_t = frames.body_pos["torso"][0], frames.body_pos["right_upper_arm"][0]
        self._arm = ArmSolver(person)
        self._known: tuple[BodyPose, _Aim] | None = None

    def solve(
        self, pose: BodyPose, start_rad: FloatArray, max_rotation_rad: float = MAX_TICK_ROTATION_RAD
    ) -> FloatArray:
        """Returns joint angles (20,) in radians, within their ranges, that bring head and hands to ``pose``.

        Waist and head follow immediately. Joints of arms rotate from ``start_rad`` (20,) by at most
        ``max_rotation_rad``, so they cannot jump. The arm of an untracked hand does not move. A second call with the
        same pose takes less time.
        """
        if self._known is None or self._known[0] is not pose:
            self._known = pose, self._aim(pose)
        aim = self._known[1]
        angles = np.array(start_rad, float)
        angles[WAIST_JOINT_INDICES + HEAD_JOINT_INDICES] = aim.torso_rad
        if aim.arms:
            start = aim.reflect * angles[aim.arms]
            angles[aim.arms] = aim.reflect * self._arm.solve(
                aim.hand_pos, aim.hand_axes, start, max_rotation_rad
            )
        return angles

    def _aim(self, pose: BodyPose) -> _Aim:
        """Returns the targets for a pose. A left hand is treated as the right hand of the mirrored person."""
        torso_rad = solve_torso_angles(self.person, pose.head_pose, self.posture)
        waist_w, torso_axes_w = self._torso_frame(torso_rad[:3])
        hands = {
            side: hand for side, hand in (("right", pose.right), ("left", pose.left)) if hand is not None
        }
        pos_t = np.array([hand.pos_w - waist_w for hand in hands.values()]).reshape(-1, 3) @ torso_axes_w
        axes_w = np.array([from_quaternion(hand.q_w) for hand in hands.values()]).reshape(-1, 3, 3)
        reflect = np.array([_REFLECT[side] for side in hands]).reshape(-1, 3)
        return _Aim(
            torso_rad,
            [ARM_JOINT_INDICES[side] for side in hands],
            reflect * pos_t - self._shoulder_t,
            reflect[:, :, None] * reflect[:, None] * (torso_axes_w.T @ axes_w),
            np.where(_ABOUT_X, 1.0, reflect[:, :1]),
        )

    def _torso_frame(self, waist_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the position (3,) of the waist in metres and the torso's axes (3, 3) as columns, in the world
        frame."""
        hips_w, hips_axes_w = compute_hips_frame(self.person, self.posture)
        return hips_w + hips_axes_w @ self._waist_h, hips_axes_w @ from_euler_xyz(*waist_rad.tolist())


_REFLECT = {"right": (1.0, 1.0, 1.0), "left": (-1.0, 1.0, 1.0)}
"""Signs of a vector's coordinates that reflect a left hand at the plane x = 0."""
_ABOUT_X = np.array([part.endswith("x") for part in ARM_JOINTS])
"""Boolean mask (7,) of an arm's joints: angles with the same sign in the mirrored arm."""

RELAXED_JOINT_ANGLES_RAD = human.make_seated_joint_angles(
    right_shoulder_x=-15.0, left_shoulder_x=-15.0, right_shoulder_y=8.0, left_shoulder_y=-8.0
)
"""Joint angles (20,) in radians with arms that hang slightly forwards and outwards, with bent elbows."""
