"""Single rotations as matrices (3, 3). The columns of a matrix are the axes of the rotated frame.

The module ``transforms`` computes with arrays of rotations. For a single rotation, the functions here are ten times
faster.
"""

from math import atan2, cos, hypot, sin

import mujoco
import numpy as np

from avrgym.array_types import FloatArray


def from_quaternion(q: FloatArray) -> FloatArray:
    """Returns the rotation matrix (3, 3) of a unit quaternion (4,)."""
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, q)
    return axes.reshape(3, 3)


def from_euler_xyz(x_rad: float, y_rad: float, z_rad: float) -> FloatArray:
    """Returns the rotation matrix Rx Ry Rz (3, 3) of intrinsic Euler angles in radians."""
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
    """Returns the Euler angles x, y, z of a rotation matrix in radians, the inverse of ``from_euler_xyz``.

    At gimbal lock (y = ±90°) the matrix determines only x ± z. The result is then one of many solutions.
    """
    (m00, m01, m02), (_, _, m12), (_, _, m22) = axes.tolist()
    return atan2(-m12, m22), atan2(m02, hypot(m12, m22)), atan2(-m01, m00)
