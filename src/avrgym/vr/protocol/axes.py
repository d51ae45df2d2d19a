"""Single rotations as matrices (3, 3), whose columns are a frame's axes.

For one rotation at a time these take a tenth of the time of ``transforms``, which serves many at once.
"""

from math import atan2, cos, hypot, sin

import mujoco
import numpy as np

from avrgym.array_types import FloatArray


def of_quaternion(q: FloatArray) -> FloatArray:
    """The axes of a unit quaternion (4,)."""
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, q)
    return axes.reshape(3, 3)


def of_xyz(x_rad: float, y_rad: float, z_rad: float) -> FloatArray:
    """The axes after hinges about x, y and z, the first outermost: Rx Ry Rz."""
    cx, cy, cz = cos(x_rad), cos(y_rad), cos(z_rad)
    sx, sy, sz = sin(x_rad), sin(y_rad), sin(z_rad)
    return np.array(
        [
            [cy * cz, -cy * sz, sy],
            [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
            [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
        ]
    )


def xyz_of(axes: FloatArray) -> tuple[float, float, float]:
    """The inverse of ``of_xyz``; where y is a quarter turn only x ± z is determined, and any such x, z are given."""
    (m00, m01, m02), (_, _, m12), (_, _, m22) = axes.tolist()
    return atan2(-m12, m22), atan2(m02, hypot(m12, m22)), atan2(-m01, m00)
