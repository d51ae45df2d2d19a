"""Triangle surfaces that carry what a skinned mesh needs at each vertex, and how to cut and shift them."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray


@dataclass(frozen=True)
class Surface:
    """Per vertex: place (V, 3) in metres, normal (V, 3), texture place (V, 2), weight of each body (V, B) and how
    the place changes when the mouth opens (V, 3). ``faces`` (F, 3) are counter-clockwise seen from outside."""

    vertices: FloatArray
    normals: FloatArray
    uv: FloatArray
    weights: FloatArray
    opening: FloatArray
    faces: NDArray[np.int64]


PER_VERTEX = [f.name for f in fields(Surface) if f.name != "faces"]


def join(surfaces: list[Surface]) -> Surface:
    """All of them as one."""
    starts = np.cumsum([0, *(len(s.vertices) for s in surfaces[:-1])])
    faces = np.concatenate([s.faces + start for s, start in zip(surfaces, starts, strict=True)])
    return Surface(faces=faces, **{n: np.concatenate([getattr(s, n) for s in surfaces]) for n in PER_VERTEX})


def take(surface: Surface, faces: NDArray[np.int64]) -> Surface:
    """Only these faces, and the vertices that they use."""
    used, renumbered = np.unique(faces, return_inverse=True)
    kept = {name: getattr(surface, name)[used] for name in PER_VERTEX}
    return Surface(faces=renumbered.reshape(-1, 3), **kept)


def clip(surface: Surface, field: FloatArray) -> Surface:
    """The part where ``field`` (V,) is positive; crossing triangles are cut along its zero line."""
    inside = field > 0.0
    count = inside[surface.faces].sum(axis=1)
    crossing = surface.faces[(count == 1) | (count == 2)]
    cutter = _Cutter(surface, field)
    made = [triangle for face in crossing for triangle in cutter.cut(face, inside[face])]
    faces = np.concatenate([surface.faces[count == 3], np.array(made, int).reshape(-1, 3)])
    return take(cutter.extended(), faces)


class _Cutter:
    """Makes one new vertex on each edge that the field's zero line crosses."""

    def __init__(self, surface: Surface, field: FloatArray) -> None:
        self._surface, self._field = surface, field
        self._edges: dict[tuple[int, int], int] = {}

    def cut(self, face: FloatArray, inside: FloatArray) -> list[tuple[int, int, int]]:
        lone = int(np.argmax(inside) if inside.sum() == 1 else np.argmin(inside))
        a, b, c = (int(face[(lone + k) % 3]) for k in range(3))
        ab, ac = self._on_edge(a, b), self._on_edge(a, c)
        return [(a, ab, ac)] if inside.sum() == 1 else [(ab, b, c), (ab, c, ac)]

    def _on_edge(self, a: int, b: int) -> int:
        new = len(self._field) + len(self._edges)
        return self._edges.setdefault((min(a, b), max(a, b)), new)

    def extended(self) -> Surface:
        if not self._edges:
            return self._surface
        a, b = np.array(list(self._edges)).T
        share = (self._field[a] / (self._field[a] - self._field[b]))[:, None]
        added = {}
        for name in PER_VERTEX:
            old = getattr(self._surface, name)
            added[name] = np.concatenate([old, old[a] * (1.0 - share) + old[b] * share])
        return replace(self._surface, **added)


def neighbours(surface: Surface) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The edges of the surface, both ways: (E,) from and (E,) to."""
    a, b, c = surface.faces.T
    edges = np.unique(
        np.stack([np.concatenate([a, b, c, b, c, a]), np.concatenate([b, c, a, a, b, c])]), axis=1
    )
    return edges[0], edges[1]


def smooth(surface: Surface, rounds: int, share: float = 0.5) -> Surface:
    """Each vertex moved by ``share`` towards the mean of its neighbours, ``rounds`` times; new normals."""
    begin, end = neighbours(surface)
    degree = np.bincount(begin, minlength=len(surface.vertices))[:, None]
    vertices = surface.vertices
    for _ in range(rounds):
        mean = np.zeros_like(vertices)
        np.add.at(mean, begin, vertices[end])
        vertices = (1.0 - share) * vertices + share * mean / np.maximum(degree, 1)
    return replace(surface, vertices=vertices, normals=normals_of(vertices, surface.faces))


def shift(surface: Surface, distance_m: FloatArray | float) -> Surface:
    """Moved along the normals."""
    moved = surface.vertices + np.reshape(distance_m, (-1, 1)) * surface.normals
    return replace(surface, vertices=moved, normals=normals_of(moved, surface.faces))


def hem(surface: Surface, depth_m: float) -> Surface:
    """The surface with its open edges turned inwards, so that cloth seems to have a thickness."""
    a, b, c = surface.faces.T
    directed = np.stack([np.concatenate([a, b, c]), np.concatenate([b, c, a])], axis=1)
    known = {(int(i), int(j)) for i, j in directed}
    rim = np.array([(i, j) for i, j in known if (j, i) not in known])
    around = np.unique(rim)
    inner = {int(v): len(surface.vertices) + k for k, v in enumerate(around)}
    grown = {
        name: np.concatenate([getattr(surface, name), getattr(surface, name)[around]]) for name in PER_VERTEX
    }
    grown["vertices"][-len(around) :] -= depth_m * surface.normals[around]
    walls = [[(j, i, inner[int(i)]), (j, inner[int(i)], inner[int(j)])] for i, j in rim]
    return Surface(faces=np.concatenate([surface.faces, np.array(walls, int).reshape(-1, 3)]), **grown)


def normals_of(vertices: FloatArray, faces: NDArray[np.int64]) -> FloatArray:
    """Normals (V, 3) of a surface: the mean of its triangles', weighted by their areas."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], areas)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
