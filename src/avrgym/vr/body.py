"""From where head and hands are to the 20 joint angles of the simulated body."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.models import human
from avrgym.models.human import JOINT_INDEX, LOWER_RAD, PROPORTIONS, SEATED, UPPER_RAD, Person, Posture
from avrgym.vr.webxr import Pose

Array = NDArray[np.float64]

WAIST_YAW_SHARE = 0.3
"""The share of the head's yaw that the waist takes over (paper, section III)."""

_WAIST = [JOINT_INDEX[f"waist_{axis}"] for axis in "xyz"]
_HEAD = [JOINT_INDEX[f"head_{axis}"] for axis in "xyz"]
ARM_PARTS = ("shoulder_y", "shoulder_x", "shoulder_z", "elbow_x", "forearm_z", "wrist_x", "wrist_y")
_ARMS = {side: [JOINT_INDEX[f"{side}_{part}"] for part in ARM_PARTS] for side in ("right", "left")}


@dataclass(frozen=True)
class BodyPose:
    """Where the participant's head and hands are; a hand that is not tracked is ``None``."""

    head: Pose
    left: Pose | None
    right: Pose | None


def seated_head_centre(person: Person, posture: Posture = SEATED) -> Array:
    """The centre of the head (3,) of a person who sits upright, or lies with their back on the bed; world frame."""
    pos_w, q_w = hips_frame(person, posture)
    return pos_w + transforms.rotate(q_w, [0.0, 0.0, person.torso_height_m])


def hips_frame(person: Person, posture: Posture) -> tuple[Array, Array]:
    """Where the hips are in the world: position (3,) and quaternion (4,)."""
    tilt = transforms.from_axis_angle(human.X, np.radians(posture.hips_deg))
    return posture.hips(PROPORTIONS[person.sex]), tilt


def torso_height(sex: human.Sex, head_height_m: float) -> float:
    """Torso height from the height of the head's centre above the floor, sitting upright in our wheelchair.

    Raises:
        ValueError: for a height that no seated adult has, naming the heights that are allowed.
    """
    hips = PROPORTIONS[sex].seated_hips_height
    low, high = (hips + limit for limit in human.TORSO_HEIGHT_RANGE_M)
    if not low <= head_height_m <= high:
        raise ValueError(
            f"the headset is {head_height_m:.2f} m above the floor; of a seated person it must be "
            f"{low:.2f} to {high:.2f} m: sit upright, and check the floor height of the headset"
        )
    return head_height_m - hips


def torso_angles(person: Person, head: Pose, posture: Posture = SEATED) -> Array:
    """Angles (6,) within their ranges of waist x, y, z and head x, y, z that bring the head to its pose.

    The waist tilts so that the head joints lie on the line to where the headset puts them: with joints in the
    order x, y, z the torso points along (sin b, −sin a cos b, cos a cos b), so a = −atan2(ψy, ψz) and
    b = atan2(ψx cos a, ψz), ψ from waist to head joints in the hips' frame (paper, section III, which takes the
    head's centre). Head and waist share the yaw. The head turns by what the waist leaves over, so that its
    orientation is exact wherever its own joints allow, even where the waist is at an end of its range.
    """
    p = PROPORTIONS[person.sex]
    scale = person.torso_height_m / p.torso_height
    pos, q = transforms.compose(*transforms.invert(*hips_frame(person, posture)), head.pos_w, head.q_w)
    neck = pos - transforms.rotate(q, [0.0, 0.0, p.head_centre_rise * scale])
    psi = neck - np.array([0.0, 0.0, p.waist_rise * scale])
    a = -np.arctan2(psi[1], psi[2])
    b = np.arctan2(psi[0] * np.cos(a), psi[2])
    tilt = _limited(_WAIST, np.array([a, b, 0.0]))
    yaw = WAIST_YAW_SHARE * _seen_from(tilt, q)[2]
    waist = _limited(_WAIST, np.array([*tilt[:2], yaw]))
    return np.concatenate([waist, _limited(_HEAD, _seen_from(waist, q))])


def _seen_from(waist_rad: Array, q: Array) -> Array:
    """The angles (3,) x, y, z of the head's joints for a rotation (4,) in the hips' frame."""
    x, y, z = (
        transforms.from_axis_angle(axis, waist_rad[i]) for i, axis in enumerate((human.X, human.Y, human.Z))
    )
    torso = transforms.multiply(transforms.multiply(x, y), z)
    return transforms.euler_xyz(transforms.multiply(transforms.conjugate(torso), q))


def _limited(joints: list[int], angles_rad: Array) -> Array:
    return np.clip(angles_rad, LOWER_RAD[joints], UPPER_RAD[joints])


DAMPING = 0.08
MAX_TURN_RAD = 0.033
METRES_PER_RADIAN = 0.15
POSTURE_GAIN = 0.02
ITERATIONS = 3


class BodySolver:
    """The inverse kinematics of one person: call ``solve`` with every tracking frame.

    The result depends only on the pose and the angles it starts from.
    """

    def __init__(self, person: Person, posture: Posture = SEATED) -> None:
        self.person, self.posture = person, posture
        self._model = human.person_model(person, posture, moving=True)
        self._data = mujoco.MjData(self._model)
        self._sites = {side: self._model.site(f"{human.PREFIX}{side}_hand_centre").id for side in _ARMS}
        self._jacobian = np.zeros((6, self._model.nv))

    def solve(self, pose: BodyPose, start_rad: Array) -> Array:
        """Joint angles (20,) within their ranges that bring head and hands to ``pose``.

        Waist and head follow at once; arms turn at most 0.1 rad per joint, from ``start_rad`` (20,), so that
        no single frame makes them jump.
        """
        angles = np.array(start_rad, float)
        angles[_WAIST + _HEAD] = torso_angles(self.person, pose.head, self.posture)
        hands = {
            side: hand for side, hand in (("left", pose.left), ("right", pose.right)) if hand is not None
        }
        for _ in range(ITERATIONS if hands else 0):
            self._data.qpos[:] = angles
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_comPos(self._model, self._data)
            for side, hand in hands.items():
                angles[_ARMS[side]] += self._arm_step(side, hand, angles)
            angles = np.clip(angles, LOWER_RAD, UPPER_RAD)
        return angles

    def _arm_step(self, side: str, hand: Pose, angles: Array) -> Array:
        """One damped least-squares step of an arm, with a pull of its null space towards the relaxed pose."""
        columns, site = _ARMS[side], self._sites[side]
        mujoco.mj_jacSite(self._model, self._data, self._jacobian[:3], self._jacobian[3:], site)
        j = self._jacobian[:, columns]
        j[3:] *= METRES_PER_RADIAN
        error = np.concatenate(
            [hand.pos_w - self._data.site_xpos[site], METRES_PER_RADIAN * self._turn(hand, site)]
        )
        posture = POSTURE_GAIN * (RELAXED_RAD[columns] - angles[columns])
        step = posture + j.T @ np.linalg.solve(j @ j.T + _DAMPING_MATRIX, error - j @ posture)
        return step * min(1.0, MAX_TURN_RAD / max(float(np.abs(step).max()), 1e-12))

    def _turn(self, hand: Pose, site: int) -> Array:
        """The rotation vector (3,), world frame, from the hand's site to its target."""
        q, turn, vector = np.empty(4), np.empty(4), np.empty(3)
        mujoco.mju_mat2Quat(q, self._data.site_xmat[site])
        mujoco.mju_negQuat(q, q)
        mujoco.mju_mulQuat(turn, hand.q_w, q)
        mujoco.mju_quat2Vel(vector, turn, 1.0)
        return vector


_DAMPING_MATRIX = DAMPING**2 * np.eye(6)

RELAXED_RAD = human.joint_angles(
    right_shoulder_x=-15.0, left_shoulder_x=-15.0, right_shoulder_y=8.0, left_shoulder_y=-8.0
)
"""Arms hanging a little forward and outward, elbows bent."""
