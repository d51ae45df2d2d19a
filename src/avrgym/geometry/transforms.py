"""Rotations and poses as plain arrays.

Quaternions (..., 4) are in the order w, x, y, z and of unit length; positions (..., 3) are in metres. ``R_ab`` maps
vectors of frame b to frame a. Functions broadcast over leading axes. Arrays may be of any library, see ``arrays``.
"""

import numpy as np

from avrgym.array_types import AnyArray, FloatArray
from avrgym.geometry import elementary
from avrgym.geometry.arrays import constant_like, get_namespace, get_namespace_and_floats

IDENTITY_QUATERNION = np.array([1.0, 0.0, 0.0, 0.0])
_CONJUGATED = np.array([1.0, -1.0, -1.0, -1.0])


def multiply(a: AnyArray, b: AnyArray) -> FloatArray:
    """Returns the quaternion product a ⊗ b, (..., 4): rotation b, followed by rotation a."""
    _, a, b = get_namespace_and_floats(a, b)
    aw, ax, ay, az = _components(a)
    bw, bx, by, bz = _components(b)
    return _joined(
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: AnyArray) -> FloatArray:
    """Returns the conjugate of a unit quaternion (..., 4), which is its inverse rotation."""
    _, q = get_namespace_and_floats(q)
    return q * constant_like(_CONJUGATED, q)


def normalize(q: AnyArray) -> FloatArray:
    """Returns quaternions or vectors (..., n), scaled to unit length. Values are not finite for length zero."""
    xp, q = get_namespace_and_floats(q)
    return q / xp.sqrt((q * q).sum(axis=-1, keepdims=True))


def norm(v: AnyArray) -> FloatArray:
    """Returns the length (...) of vectors (..., n)."""
    xp, v = get_namespace_and_floats(v)
    if xp is np and v.ndim > 1 and v.shape[-1] == 3:  # the same sum, twice as fast
        x, y, z = _components(v)
        return np.sqrt(x * x + y * y + z * z)
    return xp.sqrt((v * v).sum(axis=-1))


def rotate(q: AnyArray, v: AnyArray) -> FloatArray:
    """Returns vectors v (..., 3), rotated by unit quaternions q (..., 4)."""
    _, q, v = get_namespace_and_floats(q, v)
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * cross(u, v)
    return v + w * t + cross(u, t)


def cross(a: AnyArray, b: AnyArray) -> FloatArray:
    """Returns the cross product of vectors (..., 3). For a few vectors this is faster than ``numpy.cross``."""
    _, a, b = get_namespace_and_floats(a, b)
    ax, ay, az = _components(a)
    bx, by, bz = _components(b)
    return _joined(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def from_axis_angle(axis: AnyArray, angle_rad: AnyArray) -> FloatArray:
    """Returns the quaternion (..., 4) of a rotation by ``angle_rad`` (...) about the unit vector ``axis`` (..., 3)."""
    _, axis, angle_rad = get_namespace_and_floats(axis, angle_rad)
    return from_rotation_vector(axis * angle_rad[..., None])


def from_rotation_vector(v: AnyArray) -> FloatArray:
    """Returns the quaternions (..., 4) of rotation vectors (..., 3) in radians (exponential map)."""
    xp, v = get_namespace_and_floats(v)
    angle = xp.sqrt((v * v).sum(axis=-1, keepdims=True))
    half = np.pi * xp.where(angle == 0.0, 1e-20, 0.5 * angle / np.pi)
    sine, cosine = elementary.sine_and_cosine(half)
    return xp.concat([cosine, 0.5 * v * (sine / half)], axis=-1)


def to_rotation_vector(q: AnyArray) -> FloatArray:
    """Returns the rotation vectors (..., 3) of unit quaternions (..., 4) (logarithm). Their length is at most π."""
    xp, q = get_namespace_and_floats(q)
    q = xp.where(q[..., :1] < 0.0, -q, q)
    sine = xp.sqrt((q[..., 1:] ** 2).sum(axis=-1, keepdims=True))
    angle = 2.0 * elementary.arctan2(sine, q[..., :1])
    scale = xp.where(sine > 1e-12, angle / xp.where(sine > 1e-12, sine, 1.0), 2.0)
    return scale * q[..., 1:]


def to_matrix(q: AnyArray) -> FloatArray:
    """Returns the rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    _, q = get_namespace_and_floats(q)
    w, x, y, z = _components(q)
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, yz, zx = x * y2, y * z2, z * x2
    wx, wy, wz = w * x2, w * y2, w * z2
    entries = _joined(
        *(1.0 - (yy + zz), xy - wz, zx + wy),
        *(xy + wz, 1.0 - (xx + zz), yz - wx),
        *(zx - wy, yz + wx, 1.0 - (xx + yy)),
    )
    return entries.reshape(*entries.shape[:-1], 3, 3)


def from_matrix(matrix: AnyArray) -> FloatArray:
    """Returns the unit quaternions (..., 4), w ≥ 0, of rotation matrices (..., 3, 3).

    The method is Shepperd's: it divides by the largest of the four components, which limits rounding errors.
    """
    xp, m = get_namespace_and_floats(matrix)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    columns = [
        xp.stack([1 + xx + yy + zz, wx, wy, wz], axis=-1),
        xp.stack([wx, 1 + xx - yy - zz, xy, xz], axis=-1),
        xp.stack([wy, xy, 1 - xx + yy - zz, yz], axis=-1),
        xp.stack([wz, xz, yz, 1 - xx - yy + zz], axis=-1),
    ]
    candidates = xp.stack(columns, axis=-2)
    pivot = xp.argmax(xp.stack([candidates[..., i, i] for i in range(4)], axis=-1), axis=-1)
    q = normalize(xp.take_along_axis(candidates, pivot[..., None, None], axis=-2)[..., 0, :])
    return xp.where(q[..., :1] < 0.0, -q, q)


def angle_between(a: AnyArray, b: AnyArray) -> FloatArray:
    """Returns the angle (...) in radians of the rotation from quaternion a to b, both (..., 4)."""
    return norm(to_rotation_vector(multiply(conjugate(a), b)))


def compose(
    pos_ab: AnyArray, q_ab: AnyArray, pos_bc: AnyArray, q_bc: AnyArray
) -> tuple[FloatArray, FloatArray]:
    """Returns the composition of two poses, T_ac = T_ab · T_bc, as (position, quaternion)."""
    _, pos_ab, turned = get_namespace_and_floats(pos_ab, rotate(q_ab, pos_bc))
    return pos_ab + turned, multiply(q_ab, q_bc)


def invert(pos_ab: AnyArray, q_ab: AnyArray) -> tuple[FloatArray, FloatArray]:
    """Returns the inverse pose T_ba of T_ab, as (position, quaternion)."""
    q_ba = conjugate(q_ab)
    return -rotate(q_ba, pos_ab), q_ba


def to_euler_xyz(q: AnyArray) -> FloatArray:
    """Returns intrinsic Euler angles (..., 3) in radians: a, b, c with q = Rx(a) Ry(b) Rz(c).

    b is in −π/2..π/2. At b = ±π/2 (gimbal lock) only a ± c is determined; c is then 0.
    """
    m = to_matrix(q)
    xp = get_namespace(m)
    across = xp.hypot(m[..., 1, 2], m[..., 2, 2])
    b, locked = elementary.arctan2(m[..., 0, 2], across), across < 1e-9
    above = xp.where(locked, m[..., 2, 1], -m[..., 1, 2])
    a = elementary.arctan2(above, xp.where(locked, m[..., 1, 1], m[..., 2, 2]))
    # The second row of Ry(b) Rz(c) = Rx(−a) q is (sin c, cos c, 0), which is precise close to gimbal lock.
    sine, cosine = elementary.sine_and_cosine(a)
    row = cosine[..., None] * m[..., 1, :] + sine[..., None] * m[..., 2, :]
    return xp.stack([a, b, xp.where(locked, 0.0, elementary.arctan2(row[..., 0], row[..., 1]))], axis=-1)


def _components(v: FloatArray) -> tuple[FloatArray, ...]:
    return tuple([v[..., i] for i in range(v.shape[-1])])


def _joined(*components: FloatArray) -> FloatArray:
    """Returns vectors with these components, the inverse of ``_components``.

    For a few vectors this is faster than ``numpy.stack``.
    """
    xp = get_namespace(*components)
    if xp is not np:
        return xp.stack(components, axis=-1)
    v = np.empty((*np.shape(components[0]), len(components)))
    for i, component in enumerate(components):
        v[..., i] = component
    return v
