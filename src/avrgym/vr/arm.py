"""The inverse kinematics of a person's right arm, with the elbow where people hold it.

The arm is a ball joint at the shoulder, a hinge at the elbow and three hinges that meet at the wrist. So a
hand's pose leaves one freedom, the swivel of the elbow about the line from shoulder to wrist (Tolani, Goswami
and Badler, "Real-time inverse kinematics techniques for anthropomorphic limbs", Graphical Models 62, 2000).
Each swivel gives the joint angles in closed form; the most comfortable one near the present is taken. What the
ranges or the speed of the joints keep from the hand, damped least squares distribute over all of them.

Everything is in the shoulder's frame: its origin, the torso's axes. The left arm is the mirror image.
"""

from dataclasses import dataclass
from math import acos, atan2, cos, sin, sqrt
from statistics import median
from time import process_time

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.models import human
from avrgym.models.human import JOINT_INDEX, LOWER_RAD, PROPORTIONS, UPPER_RAD, Person
from avrgym.vr import axes

Array = NDArray[np.float64]

ARM_PARTS = ("shoulder_y", "shoulder_x", "shoulder_z", "elbow_x", "forearm_z", "wrist_x", "wrist_y")
_RIGHT = [JOINT_INDEX[f"right_{part}"] for part in ARM_PARTS]
_LOWER, _UPPER = LOWER_RAD[_RIGHT], UPPER_RAD[_RIGHT]
_FIRST, _LAST = (extreme(_LOWER + np.pi, _UPPER - np.pi) for extreme in (np.minimum, np.maximum))
"""Around angles between these, half a turn either way lies in the joint's range or covers it."""

MAX_TURN_RAD = 0.0999
"""How far a joint turns at most in one solution."""
DETOUR_RAD = 1.2
"""From an aim farther than this the hand may stray on the way: none of the joints' ways there keeps it in place."""
POLE_RAD = 0.006
"""How near straight ahead an upper arm's direction need not be followed exactly: 3 mm for an arm of half a metre."""
SWIVEL_STEP_RAD = np.radians(5.0)

OUTSIDE, STAY = 1500.0, 1.0
"""What a swivel costs per squared radian outside a joint's range, and per squared radian from the present angles."""
SHOULDER_Y, SHOULDER_Z, FOREARM, WRIST = 0.006, 0.012, 0.006, 0.012
"""Per squared radian from where these joints are at ease. Small: comfort comes slowly, so that elbows drift and
never jump. All these numbers are ours, tuned on poses of free movement."""
LIFT = 0.025
"""To lift the elbow from where it rests to the other side of the shoulder costs twice this."""
ELBOW_RESTS = transforms.normalize([-0.26, -0.1, -1.0])
"""The direction from the shoulder to an elbow at rest: down, a little outward and to the front."""
AT_EASE_RAD = np.radians([10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class ArmLengths:
    """Metres from shoulder to elbow, from there to the wrist, and from there to the hand's centre."""

    upper_m: float
    fore_m: float
    hand_m: float

    @classmethod
    def of(cls, person: Person) -> "ArmLengths":
        """Those of a person."""
        p = PROPORTIONS[person.sex]
        scale = person.torso_height_m / p.torso_height
        return cls(p.upper_arm_length * scale, p.forearm_radius + p.forearm_length * scale, p.hand_radius)


class ArmSolver:
    """Solves for right arms of one person. The result depends only on what is asked and the angles at the start."""

    def __init__(self, person: Person) -> None:
        self._lengths = ArmLengths.of(person)
        self._model = human.person_model(person, moving=True)
        self._data = mujoco.MjData(self._model)
        self._shoulder = self._model.body(f"{human.PREFIX}right_upper_arm").id
        self._hand = self._model.site(f"{human.PREFIX}right_hand_centre").id
        self._jacobian = np.zeros((6, self._model.nv))

    def solve(self, hand_pos: Array, hand_axes: Array, start_rad: Array) -> Array:
        """Angles (A, 7) of the joints ``ARM_PARTS`` that bring the hands of A arms to their poses.

        Args:
            hand_pos: the hands' centres (A, 3), metres; what is out of reach is reached for.
            hand_axes: the hands' axes (A, 3, 3) as columns.
            start_rad: the present angles (A, 7); no joint turns by 0.1 rad from them.
        """
        hand_pos = _within_reach(self._lengths, hand_pos, hand_axes)
        aim = comfortable_angles(self._lengths, hand_pos, hand_axes, start_rad)
        lower, upper = (
            np.maximum(_LOWER, start_rad - MAX_TURN_RAD),
            np.minimum(_UPPER, start_rad + MAX_TURN_RAD),
        )
        angles = _clipped(aim, lower, upper)
        way = np.abs(_clipped(aim, _LOWER, _UPPER) - start_rad).max(axis=1)
        short = (way < DETOUR_RAD) & (np.abs(angles - aim).max(axis=1) > EXACT_RAD)
        for arm in np.flatnonzero(short):
            for _ in range(LEAST_SQUARES_STEPS):
                step = self._step(hand_pos[arm], hand_axes[arm], angles[arm], (lower[arm], upper[arm]))
                angles[arm] = _clipped(angles[arm] + step, lower[arm], upper[arm])
        return angles

    def _step(self, hand_pos: Array, hand_axes: Array, angles: Array, limits: tuple[Array, Array]) -> Array:
        """A damped least-squares step (7,); a joint at a limit that the error pushes outwards stays."""
        data = self._data
        data.qpos[_RIGHT] = angles
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_jacSite(self._model, data, self._jacobian[:3], self._jacobian[3:], self._hand)
        jacobian = self._jacobian[:, _RIGHT]
        jacobian[3:] *= METRES_PER_RADIAN
        error = np.empty(6)
        error[:3] = hand_pos + data.xpos[self._shoulder] - data.site_xpos[self._hand]
        error[3:] = METRES_PER_RADIAN * _turn(data.site_xmat[self._hand], hand_axes)
        pull = error @ jacobian
        stuck = ((angles <= limits[0]) & (pull < 0.0)) | ((angles >= limits[1]) & (pull > 0.0))
        jacobian[:, stuck] = 0.0
        return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING, error)


LEAST_SQUARES_STEPS = 2
METRES_PER_RADIAN = 0.15
EXACT_RAD = 1e-6
_DAMPING = 0.02**2 * np.eye(6)


def _turn(from_axes: Array, target_axes: Array) -> Array:
    """The rotation vector (3,) from axes (9,), row by row, to others (3, 3)."""
    difference, q, vector = np.empty(9), np.empty(4), np.empty(3)
    mujoco.mju_mulMatMatT(difference.reshape(3, 3), target_axes, from_axes.reshape(3, 3))
    mujoco.mju_mat2Quat(q, difference)
    mujoco.mju_quat2Vel(vector, q, 1.0)
    return vector


def _within_reach(lengths: ArmLengths, hand_pos: Array, hand_axes: Array) -> Array:
    """The hands' centres (A, 3), moved on the lines from shoulders to wrists to where elbows can bring the wrists."""
    to_wrist = lengths.hand_m * hand_axes[:, :, 2]
    wrist = hand_pos + to_wrist
    distance_m = np.maximum(transforms.norm(wrist), 1e-6)
    upper, fore = lengths.upper_m, lengths.fore_m
    nearest_m = sqrt(upper**2 + fore**2 + 2.0 * upper * fore * _COS_MOST_BENT)
    return wrist * (_clipped(distance_m, nearest_m, upper + fore) / distance_m)[:, None] - to_wrist


_COS_MOST_BENT = cos(_LOWER[ARM_PARTS.index("elbow_x")])


def comfortable_angles(lengths: ArmLengths, hand_pos: Array, hand_axes: Array, start_rad: Array) -> Array:
    """Angles (A, 7) that bring hands to poses they can reach, whether or not shoulder and wrist can turn so.

    The arguments are those of ``ArmSolver.solve``. A few arms take little longer than one.
    """
    wrist = hand_pos + lengths.hand_m * hand_axes[:, :, 2]
    arms = [_Swivel.of(lengths, *arm) for arm in zip(wrist, hand_axes, start_rad, strict=True)]
    elbow, coefficients = (
        np.array([arm.elbow_rad for arm in arms]),
        np.array([arm.coefficients for arm in arms]),
    )
    upper, angles = _solutions(coefficients, elbow, start_rad, _SWIVELS)
    costs = _costs(angles, upper, start_rad).transpose(1, 0, 2)
    branches, swivels = zip(*(divmod(int(of_arm.argmin()), of_arm.shape[1]) for of_arm in costs), strict=True)
    best = [s + _vertex(of_arm[b], s) for of_arm, b, s in zip(costs, branches, swivels, strict=True)]
    finest = _harmonics(SWIVEL_STEP_RAD * np.array(best)[:, None])
    return _solutions(coefficients, elbow, start_rad, finest)[1][:, branches, range(len(arms)), 0].T


@dataclass(frozen=True)
class _Swivel:
    """How one arm can swivel: its elbow's angle, and the coefficients (18, 3) of two frames; see ``_turning_axes``.

    The first nine are of the upper arm's axes, the others of the forearm's, before it turns, seen from the hand.
    """

    elbow_rad: float
    coefficients: Array

    @classmethod
    def of(cls, lengths: ArmLengths, wrist: Array, hand_axes: Array, start_rad: Array) -> "_Swivel":
        elbow, below = _elbow(lengths, sqrt(wrist @ wrist))
        frame = _towards(wrist, _upper_arm_x(start_rad))
        upper_arm, forearm = frame @ _turning_axes(below), frame @ _turning_axes(below + elbow)
        return cls(elbow, np.concatenate([upper_arm, hand_axes.T @ forearm]).reshape(18, 3))


def _elbow(lengths: ArmLengths, distance_m: float) -> tuple[float, float]:
    """The elbow's angle for a wrist at a distance, and by how much the upper arm then points below the wrist."""
    upper, fore = lengths.upper_m, lengths.fore_m
    cosine = (distance_m**2 - upper**2 - fore**2) / (2.0 * upper * fore)
    angle = -acos(min(max(cosine, -1.0), 1.0))
    return angle, atan2(-fore * sin(angle), upper + fore * cos(angle))


def _upper_arm_x(angles_rad: Array) -> tuple[float, float, float]:
    """The axis of the elbow's hinge, which is the x axis of the upper arm."""
    y, x, z = angles_rad[:3].tolist()
    across, along = sin(x) * sin(z), cos(z)
    return cos(y) * along + sin(y) * across, cos(x) * sin(z), cos(y) * across - sin(y) * along


def _towards(wrist: Array, x: tuple[float, float, float]) -> Array:
    """Axes (3, 3) as columns: −z towards the wrist, x as near as can be to a given one."""
    rows = np.empty((3, 3))
    rows[2] = wrist / -max(sqrt(wrist @ wrist), 1e-6)
    rows[0] = x - (rows[2] @ x) * rows[2]
    mujoco.mju_normalize3(rows[0])
    mujoco.mju_cross(rows[1], rows[2], rows[0])
    return rows.T


def _turning_axes(below: float) -> Array:
    """The axes x, y, z of a frame that swivels about z and then turns about its x: coefficients (3, 9).

    Of each axis those of the swivel's cosine, of its sine, and the constant ones.
    """
    c, s = cos(below), sin(below)
    return np.array([[1, 0, 0, 0, -c, 0, 0, s, 0], [0, 1, 0, c, 0, 0, -s, 0, 0], [0, 0, 0, 0, 0, s, 0, 0, c]])


def _harmonics(swivels_rad: Array) -> Array:
    """What the axes' coefficients are multiplied with, for swivels (..., K): (..., 3, K)."""
    return np.stack([np.cos(swivels_rad), np.sin(swivels_rad), np.ones_like(swivels_rad)], axis=-2)


_SWIVELS = _harmonics(np.arange(0.0, 2.0 * np.pi - 1e-9, SWIVEL_STEP_RAD))


def _solutions(coefficients: Array, elbow: Array, start_rad: Array, swivels: Array) -> tuple[Array, Array]:
    """The upper arms' axes (3, 3, A, K) and angles (7, 2, A, K) for K swivels, with both ways to turn the shoulder.

    ``upper`` has the axes as columns; ``hand`` (3, 3, A, K) are the hands' axes, row by row, seen from the forearm
    before it turns.
    """
    frames = coefficients @ swivels
    upper, hand = frames.reshape(len(elbow), 2, 3, 3, -1).transpose(1, 2, 3, 0, 4)
    angles = np.empty((7, 2, len(elbow), frames.shape[-1]))
    angles[0, 0] = np.arctan2(upper[0, 2], upper[2, 2])
    angles[1, 0] = np.arcsin(_clipped(-upper[1, 2], -1.0, 1.0))
    angles[2, 0] = np.arctan2(upper[1, 0], upper[1, 1])
    angles[:3, 1] = _OTHER_WAY[0] + _OTHER_WAY[1] * angles[:3, 0]
    angles[3] = elbow[:, None]
    angles[4] = np.arctan2(-hand[1, 0], hand[1, 1])
    angles[5] = np.arcsin(_clipped(hand[1, 2], -1.0, 1.0))
    angles[6] = np.arctan2(-hand[0, 2], hand[2, 2])
    around = _per_arm(_clipped(start_rad, _FIRST, _LAST))
    angles -= 2.0 * np.pi * np.rint((angles - around) / (2.0 * np.pi))
    _rest_near_pole(angles, upper[:, 2], start_rad[:, :1])
    return upper, angles


def _per_arm(angles: Array) -> Array:
    """Angles (A, 7) to be broadcast with those of solutions, (7, 2, A, K)."""
    return angles.T[:, None, :, None]


_OTHER_WAY = np.pi, np.array([1.0, -1.0, 1.0])[:, None, None]


def _rest_near_pole(angles: Array, upper_arm_z: Array, start_y_rad: Array) -> None:
    """Where the upper arm points nearly forward, let shoulder y stay where it is, as far as the hand hardly moves.

    There y and z turn about the same axis: exactly following a hand that passes by would whirl them about.
    """
    from_pole_squared = 1.0 - upper_arm_z[1] ** 2
    slack = np.pi * np.minimum(POLE_RAD**2 / (from_pole_squared + 1e-12), 1.0)
    rest = _clipped(start_y_rad - angles[0], -slack, slack)
    angles[0] += rest
    angles[2] -= rest


def _costs(angles: Array, upper: Array, start_rad: Array) -> Array:
    """What each of the solutions costs, (2, A, K).

    That it moves and that it is not at ease are both squares about a place for each joint. Together they are, but
    for a constant, one square about the mean of the two places.
    """
    outside = angles - _clipped(angles, _per_arm(_LOWER[None]), _per_arm(_UPPER[None]))
    away = angles - _per_arm((STAY * start_rad + _EASE * AT_EASE_RAD) / (STAY + _EASE))
    squares = OUTSIDE * (outside * outside) + _per_arm((STAY + _EASE)[None]) * (away * away)
    rests = ELBOW_RESTS @ upper[:, 2].reshape(3, -1)
    return squares.sum(axis=0) + LIFT * rests.reshape(upper.shape[2:])


_EASE = np.array([SHOULDER_Y, 0.0, SHOULDER_Z, 0.0, FOREARM, WRIST, WRIST])


def _vertex(costs: Array, lowest: int) -> float:
    """Where the parabola through the lowest cost and its neighbours is lowest, −0.5 to 0.5 from it."""
    before, here, after = costs[lowest - 1], costs[lowest], costs[(lowest + 1) % len(costs)]
    curvature = before - 2.0 * here + after
    return float(0.5 * (before - after) / curvature) if curvature > 1e-12 else 0.0


def _clipped(x: Array, lower: Array | float, upper: Array | float) -> Array:
    """``numpy.clip``, which takes several times as long on a few numbers."""
    return np.minimum(np.maximum(x, lower), upper)


def solution_ms(calls: int = 1000) -> float:
    """The median processor time of the solution for one arm, milliseconds, while a hand circles before the chest."""
    solver, angles, times = ArmSolver(Person()), AT_REST_RAD[None], []
    for angle in np.linspace(0.0, 2.0 * np.pi, calls):
        hand_pos = np.array([[0.05 + 0.1 * cos(angle), -0.3, -0.1 + 0.1 * sin(angle)]])
        began_s = process_time()
        angles = solver.solve(hand_pos, _FORWARD_AXES[None], angles)
        times.append(1e3 * (process_time() - began_s))
    return median(times)


_FORWARD_AXES = axes.of_xyz(-0.5 * np.pi, 0.0, 0.0)
AT_REST_RAD = np.radians([8.0, -15.0, 0.0, -90.0, 0.0, 0.0, 0.0])
"""Hanging a little forward and outward, the elbow bent."""
