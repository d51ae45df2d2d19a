"""Closed triangle meshes for rendering: lofts, tubes and rings. They do not collide."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray

DEFAULT_LOFT_SEGMENTS = 28
"""Default number of vertices around each cross-section of a loft."""


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: vertices (V, 3) in metres, and triangles (F, 3), counter-clockwise when seen from outside."""

    vertices: FloatArray
    faces: NDArray[np.integer[Any]]


@dataclass(frozen=True)
class CrossSection:
    """Cross-section of a loft at height ``height_z_m``: a superellipse with half axes ``half_axis_x_m`` (x) and
    ``half_axis_y_m`` (y), in metres.

    Its centre is at ``centre_x_m`` and ``centre_y_m``. ``exponent`` 2 is an ellipse; larger exponents are closer to a
    rectangle.
    """

    height_z_m: float
    half_axis_x_m: float
    half_axis_y_m: float
    centre_x_m: float = 0.0
    centre_y_m: float = 0.0
    exponent: float = 2.0


def make_loft(sections: Sequence[CrossSection], segments: int = DEFAULT_LOFT_SEGMENTS) -> Mesh:
    """Returns a surface through cross-sections in the given order, closed at both ends.

    For a shell, list the sections of the outside upwards, then the sections of the inside downwards.
    """
    return _close_at_centres(np.stack([_ring(section, segments) for section in sections]))


def make_tube(points: FloatArray, radius_m: float, segments: int = 10) -> Mesh:
    """Returns a round tube along a polyline (P, 3), closed at both ends."""
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    helper = np.where(np.abs(tangents[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    u = np.cross(helper, tangents)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(tangents, u)
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)[None, :, None]
    rings = points[:, None] + radius_m * (np.cos(angle) * u[:, None] + np.sin(angle) * v[:, None])
    return _close_at_centres(rings)


def make_torus(radius_m: float, tube_radius_m: float, segments: int = 48, tube_segments: int = 12) -> Mesh:
    """Returns a torus around the x axis, centred at the origin."""
    turn = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)[:, None]
    roll = np.linspace(0.0, 2.0 * np.pi, tube_segments, endpoint=False)[None, :]
    distance = radius_m + tube_radius_m * np.cos(roll)
    vertices = np.stack(
        [
            np.broadcast_to(tube_radius_m * np.sin(roll), (segments, tube_segments)),
            distance * np.cos(turn),
            distance * np.sin(turn),
        ],
        axis=-1,
    )
    vertices = vertices.reshape(-1, 3)
    return Mesh(vertices, _outward(vertices, _band_faces(segments, tube_segments, closed=True)))


def revolve(profile: Sequence[tuple[float, float]], segments: int = 40) -> Mesh:
    """Returns a solid of revolution about z. The profile (radius, z) begins and ends on the axis."""
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    rings = np.stack(
        [
            np.stack([r * np.cos(angle), r * np.sin(angle), np.full(segments, z)], axis=-1)
            for r, z in profile[1:-1]
        ]
    )
    return _close(rings, np.array([0.0, 0.0, profile[0][1]]), np.array([0.0, 0.0, profile[-1][1]]))


def _ring(section: CrossSection, segments: int) -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)
    power = 2.0 / section.exponent
    x = section.centre_x_m + section.half_axis_x_m * np.sign(c) * np.abs(c) ** power
    y = section.centre_y_m + section.half_axis_y_m * np.sign(s) * np.abs(s) ** power
    return np.stack([x, y, np.full(segments, section.height_z_m)], axis=-1)


def _close_at_centres(rings: FloatArray) -> Mesh:
    return _close(rings, rings[0].mean(axis=0), rings[-1].mean(axis=0))


def _close(rings: FloatArray, first: FloatArray, last: FloatArray) -> Mesh:
    """Returns a mesh of rings (R, S, 3), closed by a point (3,) at each end."""
    count, segments = len(rings), len(rings[0])
    vertices = np.concatenate([rings.reshape(-1, 3), first[None], last[None]])
    start, end = count * segments, count * segments + 1
    around = np.arange(segments)
    following = (around + 1) % segments
    top = (count - 1) * segments
    caps = [
        np.stack([np.full(segments, start), following, around], axis=-1),
        np.stack([np.full(segments, end), top + around, top + following], axis=-1),
    ]
    faces = np.concatenate([_band_faces(count, segments, closed=False), *caps])
    return Mesh(vertices, _outward(vertices, faces))


def _band_faces(rings: int, segments: int, closed: bool) -> NDArray[np.int32]:
    i, j = np.meshgrid(np.arange(rings if closed else rings - 1), np.arange(segments), indexing="ij")
    below, above = i * segments, ((i + 1) % rings) * segments
    right = (j + 1) % segments
    first = np.stack([below + j, below + right, above + right], axis=-1).reshape(-1, 3)
    second = np.stack([below + j, above + right, above + j], axis=-1).reshape(-1, 3)
    return np.concatenate([first, second]).astype(np.int32)


def _outward(vertices: FloatArray, faces: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum()
    return (faces if volume > 0.0 else faces[:, ::-1]).astype(np.int32)


def round_polyline_corners(points: list[list[float]], per_corner: int = 6) -> FloatArray:
    """Returns a polyline (P, 3) in which arcs of ``per_corner`` points replace the corners."""
    p = np.asarray(points, float)
    pieces = [p[:1]]
    for before, corner, after in zip(p[:-2], p[1:-1], p[2:], strict=True):
        reach = 0.35 * min(np.linalg.norm(corner - before), np.linalg.norm(after - corner))
        start = corner + reach * (before - corner) / np.linalg.norm(before - corner)
        end = corner + reach * (after - corner) / np.linalg.norm(after - corner)
        t = np.linspace(0.0, 1.0, per_corner)[:, None]
        pieces.append((1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * end)
    return np.concatenate([*pieces, p[-1:]])
