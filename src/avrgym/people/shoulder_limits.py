"""Shoulder limits: the range of each shoulder rotation depends on the other rotations.

With abduction a, flexion f and external rotation of the humerus r, taken in this order, in degrees:

    −9 ≤ a ≤ 160
    −43 + a/3 ≤ f ≤ 153 − a/6
    −90 + 7a/9 − f/9 + 2af/810 ≤ r ≤ 60 + 4a/9 − 5f/9 + 5af/810

(Lenarčič and Umek, "Simple model of human arm reachable workspace", IEEE Trans. SMC 24(8), 1994). All angles are zero
if the upper arm hangs down and the bent forearm points forwards. The order of rotations is that of Klopčar, Tomšič and
Lenarčič, J. Biomechanics 40(1), 2007.

The coefficients could not be compared with the printed paper. Two checks support them. First, at f = 90° the axes of a
and r coincide. The formulas then limit r − a to −100…10 for every a. Second, with the arm at the side the formulas
agree with clinical tables: flexion 180°, extension 60°, external rotation 60–90°, internal rotation 70–90°. At 90° of
abduction the formulas allow only 20° of internal rotation; clinical tables list 70°.

The limits apply to the angles, not to the posture. The same posture has a second set of angles, in which a differs by
180°. These angles may violate the limits.
"""

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry.arrays import (
    RAD_PER_DEGREE,
    constant_like,
    copy_as_float,
    get_namespace,
    get_namespace_and_floats,
)
from avrgym.models.human import JOINT_INDEX, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD

ABDUCTION_RANGE_RAD = -9.0 * RAD_PER_DEGREE, 160.0 * RAD_PER_DEGREE

_SHOULDER_Y, _SHOULDER_X, _SHOULDER_Z = (
    np.array([JOINT_INDEX[f"{side}_shoulder_{axis}"] for side in ("right", "left")]) for axis in "yxz"
)
_SIDE = np.array([1.0, -1.0])
_PER_DEGREE = 180.0 / np.pi


def are_shoulders_within_limits(joint_angles_rad: FloatArray) -> BoolArray:
    """Returns a boolean mask (...) of poses (..., 20) in which both shoulders are within their limits."""
    abduction, flexion, rotation = _shoulders(joint_angles_rad)
    possible = (
        _lies_in(abduction, ABDUCTION_RANGE_RAD)
        & _lies_in(flexion, compute_flexion_range_rad(abduction))
        & _lies_in(rotation, compute_rotation_range_rad(abduction, flexion))
    )
    return possible[..., 0] & possible[..., 1]


def clip_shoulders(joint_angles_rad: FloatArray) -> FloatArray:
    """Returns poses (..., 20) with both shoulders clipped to their limits.

    Abduction is clipped first, then flexion for this abduction, then rotation for both. Other joints do not change.
    """
    abduction, flexion, rotation = _shoulders(joint_angles_rad)
    xp = get_namespace(abduction)
    abduction = xp.clip(abduction, *ABDUCTION_RANGE_RAD)
    flexion = xp.clip(flexion, *compute_flexion_range_rad(abduction))
    rotation = xp.clip(rotation, *compute_rotation_range_rad(abduction, flexion))
    clipped, side = copy_as_float(joint_angles_rad), constant_like(_SIDE, abduction)
    clipped[..., constant_like(_SHOULDER_Y, side)] = side * abduction
    clipped[..., constant_like(_SHOULDER_X, side)] = -flexion
    clipped[..., constant_like(_SHOULDER_Z, side)] = -side * rotation
    return clipped


def compute_flexion_range_rad(abduction_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns the lower and the upper limit of shoulder flexion for abductions of any shape."""
    return -43.0 * RAD_PER_DEGREE + abduction_rad / 3.0, 153.0 * RAD_PER_DEGREE - abduction_rad / 6.0


def compute_rotation_range_rad(
    abduction_rad: FloatArray, flexion_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns the lower and the upper limit of external rotation, within the joint's range, for angles of any shape."""
    a, f = abduction_rad, flexion_rad
    product = _PER_DEGREE * a * f / 810.0
    internal = -90.0 * RAD_PER_DEGREE + 7.0 * a / 9.0 - f / 9.0 + 2.0 * product
    external = 60.0 * RAD_PER_DEGREE + 4.0 * a / 9.0 - 5.0 * f / 9.0 + 5.0 * product
    lower, upper = float(LOWER_LIMITS_RAD[_SHOULDER_Z[0]]), float(UPPER_LIMITS_RAD[_SHOULDER_Z[0]])
    xp = get_namespace(internal)
    return xp.maximum(internal, lower), xp.minimum(external, upper)


def _shoulders(joint_angles_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns abduction, flexion and external rotation, each (..., 2) for the right and the left shoulder.

    Rotation about y lifts the right arm outwards and the left arm inwards. Rotation about x moves both backwards.
    Rotation about z moves the right hand inwards and the left hand outwards.
    """
    _, angles = get_namespace_and_floats(joint_angles_rad)
    y, x, z = (
        angles[..., constant_like(joints, angles)] for joints in (_SHOULDER_Y, _SHOULDER_X, _SHOULDER_Z)
    )
    side = constant_like(_SIDE, angles)
    return side * y, -x, -side * z


def _lies_in(angle: FloatArray, limits: tuple[FloatArray, FloatArray] | tuple[float, float]) -> BoolArray:
    return (angle >= limits[0]) & (angle <= limits[1])
