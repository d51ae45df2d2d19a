"""Inverse kinematics of a person's right arm with a natural elbow position.

The arm model has a ball joint (shoulder), a hinge (elbow) and three intersecting hinges (wrist). A hand pose leaves one
degree of freedom: the swivel angle of the elbow about the line from shoulder to wrist. Each swivel angle determines the
joint angles in closed form. The solver selects a comfortable swivel angle near the current angle. Joint ranges and
speed limits may leave an error of the hand. Damped least squares then reduce this error with all joints. Source:
Tolani, Goswami and Badler, "Real-time inverse kinematics techniques for anthropomorphic limbs", Graphical Models 62,
2000.

All quantities are in the shoulder's frame, which has the torso's axes. The left arm is solved as the mirror image of a
right arm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, atan2, cos, pi, sin, sqrt
from statistics import median
from time import process_time

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.rotation_matrices import from_euler_xyz
from avrgym.models import human
from avrgym.models.human import BODY_DIMENSIONS, JOINT_INDEX, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, Person

ARM_JOINTS = ("shoulder_y", "shoulder_x", "shoulder_z", "elbow_x", "forearm_z", "wrist_x", "wrist_y")
_RIGHT = [JOINT_INDEX[f"right_{part}"] for part in ARM_JOINTS]
ARM_LOWER_LIMITS_RAD, ARM_UPPER_LIMITS_RAD = LOWER_LIMITS_RAD[_RIGHT], UPPER_LIMITS_RAD[_RIGHT]
_FIRST, _LAST = (
    extreme(ARM_LOWER_LIMITS_RAD + np.pi, ARM_UPPER_LIMITS_RAD - np.pi)
    for extreme in (np.minimum, np.maximum)
)
"""Bounds (7,) of the centre of the interval to which an angle is reduced, centre ± π. The interval is in the joint's
range or contains it."""

MAX_TICK_ROTATION_RAD = 0.0999
"""Maximum rotation of a joint in one tick, in radians."""
MAX_ACCURATE_ROTATION_RAD = 1.2
"""If a joint must rotate by more radians, no motion can avoid a pose error of the hand. The solver then accepts this
error."""
MAX_REACH_FRACTION = 1.0 - 1e-9
"""Maximum distance of the wrist, as a share of the arm's length. At full length, rounding errors would bend the
elbow."""
SINGULARITY_ANGLE_RAD = 0.006
"""If the upper arm is within this angle (in radians) of the forward direction, the solver approximates the arm's
direction. For an arm of 0.5 m, the position error is at most 3 mm."""
SWIVEL_STEP_RAD = np.radians(5.0)

OUT_OF_RANGE_COST_WEIGHT, MOTION_COST_WEIGHT = 1500.0, 1.0
"""Costs of a swivel angle per squared radian: outside a joint's range, and difference from the current joint angles."""
SHOULDER_Y_COMFORT_WEIGHT, SHOULDER_Z_COMFORT_WEIGHT, FOREARM_COMFORT_WEIGHT, WRIST_COMFORT_WEIGHT = (
    0.006,
    0.012,
    0.006,
    0.012,
)
"""Costs per squared radian from the comfortable angles of these joints. With small costs, elbows drift slowly and do
not jump. All costs are tuned on poses of free movement."""
RAISED_ELBOW_COST_WEIGHT = 0.025
"""Half of the cost difference between an elbow opposite to its rest direction and an elbow at rest."""
ELBOW_REST_DIRECTION = transforms.normalize([-0.26, -0.1, -1.0])
"""The direction from the shoulder to an elbow at rest: down, slightly outwards and forwards."""
COMFORTABLE_ANGLES_RAD = np.radians([10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class ArmLengths:
    """Lengths in metres from shoulder to elbow, from elbow to wrist, and from wrist to the hand's centre."""

    upper_arm_m: float
    forearm_m: float
    wrist_to_hand_length_m: float

    @classmethod
    def from_person(cls, person: Person) -> "ArmLengths":
        """Returns the lengths of a person's arm in metres."""
        p = BODY_DIMENSIONS[person.sex]
        scale = person.arm_scale * (person.torso_height_m / p.torso_height_m)
        return cls(
            p.upper_arm_length_m * scale, p.forearm_radius_m + p.forearm_length_m * scale, p.hand_radius_m
        )


class ArmSolver:
    """Inverse kinematics for the right arm of one person. The result depends only on the arguments (stateless)."""

    def __init__(self, person: Person) -> None:
        self._lengths = ArmLengths.from_person(person)
        self._model = human.compile_person_model(person, moving=True)
        self._data = mujoco.MjData(self._model)
        self._shoulder = self._model.body(f"{human.PERSON_NAME_PREFIX}right_upper_arm").id
        self._hand = self._model.site(f"{human.PERSON_NAME_PREFIX}right_hand_centre").id
        self._jacobian = np.zeros((6, self._model.nv))

    def solve(
        self,
        hand_pos: FloatArray,
        hand_axes: FloatArray,
        start_rad: FloatArray,
        max_rotation_rad: float = MAX_TICK_ROTATION_RAD,
    ) -> FloatArray:
        """Returns the angles (A, 7) of the joints ``ARM_JOINTS`` that bring the hands of A arms to their poses.

        Args:
            hand_pos: the hands' centres (A, 3), metres. If a position is out of reach, the arm stretches towards it.
            hand_axes: the hands' axes (A, 3, 3) as columns.
            start_rad: the current joint angles (A, 7), radians.
            max_rotation_rad: maximum rotation of a joint from its current angle, radians.
        """
        hand_pos = _within_reach(self._lengths, hand_pos, hand_axes)
        aim = solve_comfortable_angles(self._lengths, hand_pos, hand_axes, start_rad)
        lower, upper = (
            np.maximum(ARM_LOWER_LIMITS_RAD, start_rad - max_rotation_rad),
            np.minimum(ARM_UPPER_LIMITS_RAD, start_rad + max_rotation_rad),
        )
        angles = _clipped(aim, lower, upper)
        way = np.abs(_clipped(aim, ARM_LOWER_LIMITS_RAD, ARM_UPPER_LIMITS_RAD) - start_rad).max(axis=1)
        short = (way < MAX_ACCURATE_ROTATION_RAD) & (
            np.abs(angles - aim).max(axis=1) > CLIPPING_TOLERANCE_RAD
        )
        for arm in np.flatnonzero(short):
            for _ in range(NUM_LEAST_SQUARES_STEPS):
                step = self._step(hand_pos[arm], hand_axes[arm], angles[arm], (lower[arm], upper[arm]))
                angles[arm] = _clipped(angles[arm] + step, lower[arm], upper[arm])
        return angles

    def _step(
        self,
        hand_pos: FloatArray,
        hand_axes: FloatArray,
        angles: FloatArray,
        limits: tuple[FloatArray, FloatArray],
    ) -> FloatArray:
        """Returns a damped least-squares step of the joint angles (7,) in radians. No joint exceeds its limits."""
        data = self._data
        data.qpos[_RIGHT] = angles
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_jacSite(self._model, data, self._jacobian[:3], self._jacobian[3:], self._hand)
        jacobian = self._jacobian[:, _RIGHT]
        jacobian[3:] *= CHARACTERISTIC_LENGTH_M
        error = np.empty(6)
        error[:3] = hand_pos + data.xpos[self._shoulder] - data.site_xpos[self._hand]
        error[3:] = CHARACTERISTIC_LENGTH_M * _turn(data.site_xmat[self._hand], hand_axes)
        pull = error @ jacobian
        stuck = ((angles <= limits[0]) & (pull < 0.0)) | ((angles >= limits[1]) & (pull > 0.0))
        jacobian[:, stuck] = 0.0
        return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING, error)


NUM_LEAST_SQUARES_STEPS = 2
CHARACTERISTIC_LENGTH_M = 0.15
"""Length that converts a rotation error (rad) to a position error (m)."""
CLIPPING_TOLERANCE_RAD = 1e-6
LEAST_SQUARES_DAMPING_M = 0.02
_DAMPING = LEAST_SQUARES_DAMPING_M**2 * np.eye(6)


def _turn(from_axes: FloatArray, target_axes: FloatArray) -> FloatArray:
    """Returns the rotation vector (3,) in radians from a rotation matrix (9,), flattened by rows, to a target matrix
    (3, 3)."""
    difference, q, vector = np.empty(9), np.empty(4), np.empty(3)
    mujoco.mju_mulMatMatT(difference.reshape(3, 3), target_axes, from_axes.reshape(3, 3))
    mujoco.mju_mat2Quat(q, difference)
    mujoco.mju_quat2Vel(vector, q, 1.0)
    return vector


def _within_reach(lengths: ArmLengths, hand_pos: FloatArray, hand_axes: FloatArray) -> FloatArray:
    """Returns the hands' centres (A, 3) in metres. Centres out of reach are moved along the line from shoulder to
    wrist."""
    to_wrist = lengths.wrist_to_hand_length_m * hand_axes[:, :, 2]
    wrist = hand_pos + to_wrist
    distance_m = np.maximum(transforms.norm(wrist), 1e-6)
    upper, fore = lengths.upper_arm_m, lengths.forearm_m
    nearest_m = sqrt(upper**2 + fore**2 + 2.0 * upper * fore * _COS_MOST_BENT)
    within_m = _clipped(distance_m, nearest_m / MAX_REACH_FRACTION, MAX_REACH_FRACTION * (upper + fore))
    return wrist * (within_m / distance_m)[:, None] - to_wrist


_COS_MOST_BENT = cos(ARM_LOWER_LIMITS_RAD[ARM_JOINTS.index("elbow_x")])


def solve_comfortable_angles(
    lengths: ArmLengths, hand_pos: FloatArray, hand_axes: FloatArray, start_rad: FloatArray
) -> FloatArray:
    """Returns the most comfortable joint angles (A, 7), in radians, that bring hands to poses within reach.

    The result may exceed the joint ranges of shoulder and wrist. The arguments are those of ``ArmSolver.solve``.
    Several arms need little more computing time than one arm.
    """
    elbow, coefficients = _swivelling(
        lengths, hand_pos + lengths.wrist_to_hand_length_m * hand_axes[:, :, 2], hand_axes, start_rad
    )
    entries = coefficients @ _SWIVELS
    costs = _costs(_solutions(entries, elbow, start_rad), entries[:, -1], start_rad)
    branches, swivels = zip(*(divmod(int(of_arm.argmin()), of_arm.shape[1]) for of_arm in costs), strict=True)
    best = [s + _vertex(of_arm[b], s) for of_arm, b, s in zip(costs, branches, swivels, strict=True)]
    finest = np.array([_harmonics([SWIVEL_STEP_RAD * swivel]) for swivel in best])
    return _solutions(coefficients @ finest, elbow, start_rad)[:, branches, range(len(best)), 0].T


def _swivelling(
    lengths: ArmLengths, wrist: FloatArray, hand_axes: FloatArray, start_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns elbow angles (A,) of A arms, and coefficients (A, 11, 3) of the swivel angle for ``_harmonics``.

    The swivel angle changes the upper arm's axes in the shoulder's frame. It also changes the forearm's axes in the
    hand's frame, before the joint forearm_z is applied. Row i of the coefficients belongs to row i of ``_ENTRIES``.
    """
    wrists = wrist.tolist()
    bends = [_elbow(lengths, sqrt(x * x + y * y + z * z)) for x, y, z in wrists]
    towards = np.array([_towards(*arm) for arm in zip(wrists, start_rad.tolist(), strict=True)])
    frames = np.concatenate([towards, hand_axes.transpose(0, 2, 1) @ towards], axis=1)
    turning = np.array([[_turning_axes(below), _turning_axes(below + elbow)] for elbow, below in bends])
    coefficients = frames.reshape(-1, 2, 3, 3) @ turning
    return np.array([elbow for elbow, _ in bends]), _ENTRIES @ coefficients.reshape(-1, 18, 3)


def _entries() -> FloatArray:
    """Returns a matrix (11, 18). It maps frames of upper arm and forearm to inputs of ``_solutions`` and ``_costs``.

    Rows 0–3 are sines and rows 4–7 cosines of the unlimited angles, multiplied by a positive number. Rows 8–9 are the
    sines of the bending angles. Row 10 is the component of the elbow's direction along its rest direction.
    """
    upper_arm, forearm = np.eye(18).reshape(2, 3, 3, 18)
    sines = upper_arm[0, 2], upper_arm[1, 0], -forearm[1, 0], -forearm[0, 2]
    cosines = upper_arm[2, 2], upper_arm[1, 1], forearm[1, 1], forearm[2, 2]
    return np.array(
        [*sines, *cosines, -upper_arm[1, 2], forearm[1, 2], ELBOW_REST_DIRECTION @ upper_arm[:, 2]]
    )


_ENTRIES = _entries()


def _elbow(lengths: ArmLengths, distance_m: float) -> tuple[float, float]:
    """Returns the angle of the elbow joint, in radians, for a distance between shoulder and wrist.

    The second result is the angle in radians between the upper arm and the line from shoulder to wrist.
    """
    upper, fore = lengths.upper_arm_m, lengths.forearm_m
    cosine = (distance_m**2 - upper**2 - fore**2) / (2.0 * upper * fore)
    angle = -acos(min(max(cosine, -1.0), 1.0))
    return angle, atan2(-fore * sin(angle), upper + fore * cos(angle))


def _towards(wrist: list[float], start_rad: list[float]) -> list[list[float]]:
    """Returns axes (3, 3) as columns: −z points towards the wrist, x is close to the elbow's hinge.

    If the hinge axis points to the wrist, x is the hinge axis after a rotation of the upper arm by 90°.
    """
    x, y, z = wrist
    scale = -1.0 / max(sqrt(x * x + y * y + z * z), 1e-6)
    zx, zy, zz = scale * x, scale * y, scale * z
    x, y, z = _upper_arm_x(start_rad)
    along = x * zx + y * zy + z * zz
    x, y, z = x - along * zx, y - along * zy, z - along * zz
    across = sqrt(x * x + y * y + z * z)
    if across < 1e-6:
        return _towards(wrist, [*start_rad[:2], start_rad[2] + 0.5 * pi])
    x, y, z = x / across, y / across, z / across
    return [[x, zy * z - zz * y, zx], [y, zz * x - zx * z, zy], [z, zx * y - zy * x, zz]]


def _upper_arm_x(angles_rad: list[float]) -> tuple[float, float, float]:
    """Returns the axis of the elbow's hinge, which is the x axis of the upper arm."""
    y, x, z = angles_rad[:3]
    across, along = sin(x) * sin(z), cos(z)
    return cos(y) * along + sin(y) * across, cos(x) * sin(z), cos(y) * across - sin(y) * along


def _turning_axes(below: float) -> list[list[float]]:
    """Returns coefficients (3, 9) for the axes x, y, z of a frame.

    The frame rotates about z by the swivel angle, then about its x axis by the angle ``below``. Each axis has three
    columns: the coefficients of the swivel angle's cosine and sine, and the constant.
    """
    c, s = cos(below), sin(below)
    return [
        [1.0, 0.0, 0.0, 0.0, -c, 0.0, 0.0, s, 0.0],
        [0.0, 1.0, 0.0, c, 0.0, 0.0, -s, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, s, 0.0, 0.0, c],
    ]


def _harmonics(swivels_rad: Sequence[float]) -> FloatArray:
    """Returns factors (3, K) for the coefficients of ``_turning_axes``: cosine, sine and 1 of K swivel angles."""
    return np.array(
        [
            [cos(swivel) for swivel in swivels_rad],
            [sin(swivel) for swivel in swivels_rad],
            [1.0] * len(swivels_rad),
        ]
    )


_SWIVELS = _harmonics(np.arange(0.0, 2.0 * np.pi - 1e-9, SWIVEL_STEP_RAD).tolist())


def _solutions(entries: FloatArray, elbow: FloatArray, start_rad: FloatArray) -> FloatArray:
    """Returns joint angles (7, 2, A, K) for K swivel angles of A arms. The second axis has both shoulder solutions.

    ``entries`` (A, 11, K) are products of ``_ENTRIES`` and the frames of upper arm and forearm.
    """
    read = entries.transpose(1, 0, 2)
    angles = np.empty((7, 2, *read.shape[1:]))
    angles[::2] = np.arctan2(read[:4], read[4:8])[:, None]
    angles[1::4] = np.arcsin(_clipped(read[8:10], -1.0, 1.0))[:, None]
    angles[3] = elbow[:, None]
    angles[:3, 1] = _OTHER_WAY[0] + _OTHER_WAY[1] * angles[:3, 0]
    around = _per_arm(_clipped(start_rad, _FIRST, _LAST))
    angles -= 2.0 * np.pi * np.rint((angles - around) / (2.0 * np.pi))
    _rest_near_pole(angles, read[8], start_rad[:, :1])
    return angles


def _per_arm(angles: FloatArray) -> FloatArray:
    """Reshape angles (A, 7) to broadcast with solutions (7, 2, A, K)."""
    return angles.T[:, None, :, None]


_OTHER_WAY = np.pi, np.array([1.0, -1.0, 1.0])[:, None, None]


def _rest_near_pole(angles: FloatArray, forward: FloatArray, start_y_rad: FloatArray) -> None:
    """Do not change the angle of shoulder y if the upper arm points nearly forward. The hand's error is small.

    In this direction, y and z rotate about the same axis. Exact solutions would rotate both joints fast while the arm
    passes the direction. ``forward`` (A, K) is the forward component of the upper arm's direction, −1 to 1.
    """
    slack = np.pi * np.minimum(SINGULARITY_ANGLE_RAD**2 / (1.0 + 1e-12 - forward * forward), 1.0)
    rest = _clipped(start_y_rad - angles[0], -slack, slack)
    angles[0] += rest
    angles[2] -= rest


def _costs(angles: FloatArray, rests: FloatArray, start_rad: FloatArray) -> FloatArray:
    """Returns the costs (A, 2, K) of the solutions. ``rests`` (A, K) is the last row of the ``_ENTRIES``.

    The cost of motion is the squared difference of each joint from its current angle. The cost of discomfort is the
    squared difference from its comfortable angle. Except for a constant and a factor, the sum is the squared difference
    from the weighted mean of both angles.
    """
    outside = angles - _clipped(
        angles, _per_arm(ARM_LOWER_LIMITS_RAD[None]), _per_arm(ARM_UPPER_LIMITS_RAD[None])
    )
    away = angles - _per_arm(
        (MOTION_COST_WEIGHT * start_rad + COMFORT_COST_WEIGHTS * COMFORTABLE_ANGLES_RAD)
        / (MOTION_COST_WEIGHT + COMFORT_COST_WEIGHTS)
    )
    squares = OUT_OF_RANGE_COST_WEIGHT * (outside * outside) + _per_arm(
        (MOTION_COST_WEIGHT + COMFORT_COST_WEIGHTS)[None]
    ) * (away * away)
    return squares.sum(axis=0).transpose(1, 0, 2) + RAISED_ELBOW_COST_WEIGHT * rests[:, None]


COMFORT_COST_WEIGHTS = np.array(
    [
        SHOULDER_Y_COMFORT_WEIGHT,
        0.0,
        SHOULDER_Z_COMFORT_WEIGHT,
        0.0,
        FOREARM_COMFORT_WEIGHT,
        WRIST_COMFORT_WEIGHT,
        WRIST_COMFORT_WEIGHT,
    ]
)


def _vertex(costs: FloatArray, lowest: int) -> float:
    """Returns the offset in steps, −0.5 to 0.5, from the lowest cost to the minimum of a parabola.

    The parabola passes through the lowest cost and its two neighbours.
    """
    before, here, after = costs[lowest - 1], costs[lowest], costs[(lowest + 1) % len(costs)]
    curvature = before - 2.0 * here + after
    return float(0.5 * (before - after) / curvature) if curvature > 1e-12 else 0.0


def _clipped(x: FloatArray, lower: FloatArray | float, upper: FloatArray | float) -> FloatArray:
    """Returns ``x``, clipped to a range. For a few numbers, ``numpy.clip`` takes several times longer."""
    return np.minimum(np.maximum(x, lower), upper)


def measure_solve_time_ms(calls: int = 1000) -> float:
    """Returns the median processor time in milliseconds to solve one arm. The hand moves on a circle in front of the
    chest."""
    solver, angles = ArmSolver(Person()), ARM_REST_ANGLES_RAD[None]
    times: list[float] = []
    for angle in np.linspace(0.0, 2.0 * np.pi, calls):
        hand_pos = np.array([[0.05 + 0.1 * cos(angle), -0.3, -0.1 + 0.1 * sin(angle)]])
        began_s = process_time()
        angles = solver.solve(hand_pos, _FORWARD_AXES[None], angles)
        times.append(1e3 * (process_time() - began_s))
    return median(times)


_FORWARD_AXES = from_euler_xyz(-0.5 * np.pi, 0.0, 0.0)
ARM_REST_ANGLES_RAD = np.radians([8.0, -15.0, 0.0, -90.0, 0.0, 0.0, 0.0])
"""Joint angles (7,) in radians of an arm that hangs slightly forwards and outwards, with a bent elbow."""
