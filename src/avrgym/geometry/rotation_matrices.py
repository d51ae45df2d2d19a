"""Single rotations as matrices (3, 3), whose columns are the axes of the rotated frame.

For a single rotation these functions take a tenth of the time of ``transforms``, which computes arrays of rotations.
"""

from math import atan2, cos, hypot, sin

import mujoco
import numpy as np

from avrgym.array_types import FloatArray


def from_quaternion(q: FloatArray) -> FloatArray:
    """The rotation matrix (3, 3) of a unit quaternion (4,)."""
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, q)
    return axes.reshape(3, 3)


def from_euler_xyz(x_rad: float, y_rad: float, z_rad: float) -> FloatArray:
    """The rotation matrix Rx Ry Rz (3, 3) of intrinsic Euler angles in radians."""
    cx, cy, cz = cos(x_rad), cos(y_rad), cos(z_rad)
    sx, sy, sz = sin(x_rad), sin(y_rad), sin(z_rad)
    return np.array(
        [
            [cy * cz, -cy * sz, sy],
            [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
            [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
        ]
    )


def to_euler_xyz(axes: FloatArray) -> tuple[float, float, float]:
    """Euler angles of a rotation matrix, the inverse of ``from_euler_xyz``.

    At gimbal lock (y = ±90°) only x ± z is determined. The result is then one of the solutions.
    """
    (m00, m01, m02), (_, _, m12), (_, _, m22) = axes.tolist()
    return atan2(-m12, m22), atan2(m02, hypot(m12, m22)), atan2(-m01, m00)
