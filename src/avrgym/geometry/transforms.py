"""Rotations and poses as plain arrays.

Quaternions are (..., 4) in the order w, x, y, z and of unit length; positions are (..., 3) in metres.
``R_ab`` takes vectors of frame b to frame a. Every function broadcasts over the leading axes.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrgym.geometry import elementary

Array = NDArray[np.float64]

IDENTITY_QUATERNION = np.array([1.0, 0.0, 0.0, 0.0])


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """The product a ⊗ b: the rotation b followed by a. Shapes (..., 4)."""
    aw, ax, ay, az = _components(a)
    bw, bx, by, bz = _components(b)
    return _joined(
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: ArrayLike) -> Array:
    """The inverse rotation of a unit quaternion (..., 4)."""
    return np.asarray(q, float) * np.array([1.0, -1.0, -1.0, -1.0])


def normalize(q: ArrayLike) -> Array:
    """Scale quaternions or vectors (..., n) to unit length; zero length gives non-finite values."""
    q = np.asarray(q, float)
    return q / np.sqrt((q * q).sum(axis=-1, keepdims=True))


def norm(v: ArrayLike) -> Array:
    """The length (...) of vectors (..., n)."""
    v = np.asarray(v, float)
    return np.sqrt((v * v).sum(axis=-1))


def rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Rotate vectors v (..., 3) by unit quaternions q (..., 4)."""
    q, v = np.asarray(q, float), np.asarray(v, float)
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * cross(u, v)
    return v + w * t + cross(u, t)


def cross(a: ArrayLike, b: ArrayLike) -> Array:
    """The cross product of vectors (..., 3); ``numpy.cross`` takes several times as long on a few vectors."""
    ax, ay, az = _components(a)
    bx, by, bz = _components(b)
    return _joined(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def from_axis_angle(axis: ArrayLike, angle_rad: ArrayLike) -> Array:
    """The rotation by ``angle_rad`` (...) about the unit vector ``axis`` (..., 3), as (..., 4)."""
    return from_rotation_vector(np.asarray(axis, float) * np.asarray(angle_rad, float)[..., None])


def from_rotation_vector(v: ArrayLike) -> Array:
    """The exponential map: rotation vectors (..., 3) in radians to quaternions (..., 4)."""
    v = np.asarray(v, float)
    angle = np.sqrt((v * v).sum(axis=-1, keepdims=True))
    half = np.pi * np.where(angle == 0.0, 1e-20, 0.5 * angle / np.pi)
    sine, cosine = elementary.sine_and_cosine(half)
    return np.concatenate([cosine, 0.5 * v * (sine / half)], axis=-1)


def to_rotation_vector(q: ArrayLike) -> Array:
    """The logarithm of unit quaternions (..., 4): rotation vectors (..., 3) of length at most π."""
    q = np.asarray(q, float)
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.sqrt((q[..., 1:] ** 2).sum(axis=-1, keepdims=True))
    angle = 2.0 * elementary.arctan2(sine, q[..., :1])
    scale = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return scale * q[..., 1:]


def to_matrix(q: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
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


def from_matrix(matrix: ArrayLike) -> Array:
    """Unit quaternions (..., 4), w ≥ 0, of rotation matrices (..., 3, 3).

    Shepperd's choice: the largest of the four squared components is the pivot, so no division is
    ill-conditioned.
    """
    m = np.asarray(matrix, float)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    columns = [
        np.stack([1 + xx + yy + zz, wx, wy, wz], axis=-1),
        np.stack([wx, 1 + xx - yy - zz, xy, xz], axis=-1),
        np.stack([wy, xy, 1 - xx + yy - zz, yz], axis=-1),
        np.stack([wz, xz, yz, 1 - xx - yy + zz], axis=-1),
    ]
    candidates = np.stack(columns, axis=-2)
    pivot = np.argmax(np.stack([candidates[..., i, i] for i in range(4)], axis=-1), axis=-1)
    q = normalize(np.take_along_axis(candidates, pivot[..., None, None], axis=-2)[..., 0, :])
    return np.where(q[..., :1] < 0.0, -q, q)


def angle_between(a: ArrayLike, b: ArrayLike) -> Array:
    """The angle in radians (...) of the rotation that takes a to b; both (..., 4)."""
    return norm(to_rotation_vector(multiply(conjugate(a), b)))


def compose(pos_ab: ArrayLike, q_ab: ArrayLike, pos_bc: ArrayLike, q_bc: ArrayLike) -> tuple[Array, Array]:
    """Chain two poses: T_ac = T_ab · T_bc, as (position, quaternion)."""
    return np.asarray(pos_ab, float) + rotate(q_ab, pos_bc), multiply(q_ab, q_bc)


def invert(pos_ab: ArrayLike, q_ab: ArrayLike) -> tuple[Array, Array]:
    """The inverse pose T_ba of T_ab."""
    q_ba = conjugate(q_ab)
    return -rotate(q_ba, pos_ab), q_ba


def euler_xyz(q: ArrayLike) -> Array:
    """Angles (..., 3) a, b, c with q = Rx(a) Ry(b) Rz(c): hinges about x, y, z, the first outermost.

    b lies in −π/2..π/2; at its ends only a ± c is determined and c is chosen as 0.
    """
    m = to_matrix(q)
    b = elementary.arctan2(m[..., 0, 2], np.hypot(m[..., 1, 2], m[..., 2, 2]))
    locked = np.hypot(m[..., 1, 2], m[..., 2, 2]) < 1e-9
    above = np.where(locked, m[..., 2, 1], -m[..., 1, 2])
    a = elementary.arctan2(above, np.where(locked, m[..., 1, 1], m[..., 2, 2]))
    # Rx(−a) q = Ry(b) Rz(c), whose second row is (sin c, cos c, 0): precise however close to the lock.
    sine, cosine = elementary.sine_and_cosine(a)
    row = cosine[..., None] * m[..., 1, :] + sine[..., None] * m[..., 2, :]
    return np.stack([a, b, np.where(locked, 0.0, elementary.arctan2(row[..., 0], row[..., 1]))], axis=-1)


def _components(v: ArrayLike) -> tuple[Array, ...]:
    v = np.asarray(v, float)
    return tuple([v[..., i] for i in range(v.shape[-1])])


def _joined(*components: Array) -> Array:
    """The inverse of ``_components``; ``numpy.stack`` takes several times as long on a few vectors."""
    v = np.empty((*np.shape(components[0]), len(components)))
    for i, component in enumerate(components):
        v[..., i] = component
    return v
