"""Skins of a model for glTF: four bones and weights per vertex, and swing bones without twist.

The bones in MuJoCo are the bodies. With these bones alone, the twist of a forearm would deform the skin at the elbow
too much. Each upper arm and forearm therefore has a second bone, its *swing*. The swing follows the body without the
twist about the body's z axis (swing-twist decomposition). Along the limb, the weights change gradually from the swing
to the body.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import BoolArray, FloatArray, NumpyArray
from avrgym.models.colours import compute_skin_colours
from avrgym.vr.scene.geom_meshes import make_pose_matrix

BONES_PER_VERTEX = 4
SWING_BONE_BODY_SUFFIXES = ("upper_arm", "forearm")
"""Endings of the names of bodies that have a swing bone."""
WELD_DISTANCE_M = 1e-5
"""Vertices of two skins are considered the same if their distance is below this value in metres."""


@dataclass(frozen=True)
class Bone:
    """A bone of a skin. It follows a body; if ``is_swing`` is true, it follows only the swing of this body.

    ``inverse_bind_matrix`` (4, 4) transforms the skin at rest into the frame of the bone.
    """

    body_name: str
    is_swing: bool
    inverse_bind_matrix: FloatArray


@dataclass(frozen=True)
class Skin:
    """A skin in the rest pose: ``vertices`` and ``normals`` (V, 3), ``rgba`` (V, 4), ``uv`` (V, 2), ``faces`` (F, 3).

    ``bone_indices`` and ``bone_weights`` (V, 4): for each vertex, the indices of four ``bones`` and their weights.
    ``material_id`` is the id of a material in the model, or −1.
    """

    name: str
    material_id: int
    rgba: FloatArray
    vertices: FloatArray
    normals: FloatArray
    uv: FloatArray
    faces: NDArray[np.int32]
    bones: tuple[Bone, ...]
    bone_indices: NDArray[np.int64]
    bone_weights: FloatArray

    @property
    def main_body_name(self) -> str:
        """Name of the body with the largest total weight."""
        shares = [self.bone_weights[self.bone_indices == number].sum() for number in range(len(self.bones))]
        return self.bones[int(np.argmax(shares))].body_name


def read_skins(model: mujoco.MjModel) -> Iterator[Skin]:
    """Yields all skins of a model. Adjacent skins of one material have the same normals at their border."""
    normals, colours = _normals(model), compute_skin_colours(model)
    for skin in range(model.nskin):
        count: int = model.skin_vertnum[skin]
        bones, weights = _bones(model, skin)
        weights = np.pad(weights, ((0, 0), (0, max(0, BONES_PER_VERTEX - len(bones)))))
        bone_of = np.argsort(-weights, axis=1, kind="stable")[:, :BONES_PER_VERTEX]
        weight_of = np.take_along_axis(weights, bone_of, axis=1)
        bone_of = np.where(weight_of > 0.0, bone_of, 0)
        yield Skin(
            name=model.skin(skin).name,
            material_id=int(model.skin_matid[skin]),
            rgba=np.tile(colours[skin], (count, 1)),
            vertices=_rows(model.skin_vert, model.skin_vertadr, model.skin_vertnum, skin),
            normals=normals[skin],
            uv=_uv(model, skin),
            faces=_rows(model.skin_face, model.skin_faceadr, model.skin_facenum, skin),
            bones=bones,
            bone_indices=bone_of,
            bone_weights=weight_of / weight_of.sum(axis=1, keepdims=True),
        )


def merge_skins(skins: Sequence[Skin]) -> Skin:
    """Merges skins. Returns one skin with the name and material of the first skin."""
    bones = list({(bone.body_name, bone.is_swing): bone for skin in skins for bone in skin.bones}.values())
    numbers = {(bone.body_name, bone.is_swing): number for number, bone in enumerate(bones)}
    bone_of = [
        np.array([numbers[b.body_name, b.is_swing] for b in skin.bones])[skin.bone_indices] for skin in skins
    ]
    starts = np.cumsum([0, *(len(skin.vertices) for skin in skins)])
    return Skin(
        name=skins[0].name,
        material_id=skins[0].material_id,
        rgba=np.concatenate([skin.rgba for skin in skins]),
        vertices=np.concatenate([skin.vertices for skin in skins]),
        normals=np.concatenate([skin.normals for skin in skins]),
        uv=np.concatenate([skin.uv for skin in skins]),
        faces=np.concatenate([skin.faces + start for skin, start in zip(skins, starts, strict=False)]),
        bones=tuple(bones),
        bone_indices=np.concatenate(bone_of),
        bone_weights=np.concatenate([skin.bone_weights for skin in skins]),
    )


def add_cap(skin: Skin, other: Skin) -> Skin:
    """Returns the skin with a cap at its border to another skin, for views that hide the other skin."""
    rim = _rim(skin, other)
    if not len(rim):
        return skin
    centre, first = len(skin.vertices) + len(rim), rim[:, 0]
    copies = {vertex: len(skin.vertices) + number for number, vertex in enumerate(first.tolist())}
    ends = [copies[vertex] for vertex in rim[:, 1].tolist()]
    lid = np.stack([ends, list(copies.values()), np.full(len(rim), centre)], axis=1)
    vertices = np.concatenate([skin.vertices, skin.vertices[first], skin.vertices[first].mean(axis=0)[None]])
    corners = vertices[lid]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    grown = np.append(first, first[0])
    return replace(
        skin,
        rgba=np.concatenate([skin.rgba, skin.rgba[grown]]),
        vertices=vertices,
        normals=np.concatenate([skin.normals, np.tile(normal / np.linalg.norm(normal), (len(grown), 1))]),
        uv=np.concatenate([skin.uv, skin.uv[grown]]),
        faces=np.concatenate([skin.faces, lid]),
        bone_indices=np.concatenate([skin.bone_indices, skin.bone_indices[grown]]),
        bone_weights=np.concatenate([skin.bone_weights, skin.bone_weights[grown]]),
    )


def _rim(skin: Skin, other: Skin) -> NDArray[np.int64]:
    """Returns the edges (E, 2) between a skin and an adjacent skin, as vertex indices in the order of the skin's
    triangles."""
    near, others_near = _near(skin.vertices, other.vertices), _near(other.vertices, skin.vertices)
    if not near.any() or not others_near.any():
        return np.zeros((0, 2), np.int64)
    together = np.concatenate([skin.vertices[near], other.vertices[others_near]])
    own_place, other_place = np.split(_places(together), [np.count_nonzero(near)])
    places, first = np.unique(own_place, return_index=True)
    own, others = own_place[_edges(skin.faces, near)], other_place[_edges(other.faces, others_near)]
    turned = _edge_numbers(own[:, ::-1], len(together))
    goes_on = np.isin(turned, _edge_numbers(others, len(together)))
    ends = ~np.isin(turned, _edge_numbers(own, len(together)))
    rim = np.unique(own[goes_on & ends], axis=0)
    return np.flatnonzero(near)[first[np.searchsorted(places, rim)]]


def _near(points: FloatArray, others: FloatArray) -> BoolArray:
    """Returns a boolean mask (V,): ``points`` (V, 3) that are in the bounding box of ``others`` (W, 3)."""
    low, high = others.min(axis=0) - WELD_DISTANCE_M, others.max(axis=0) + WELD_DISTANCE_M
    return ((points >= low) & (points <= high)).all(axis=1)


def _places(points: FloatArray) -> NDArray[np.int64]:
    """Returns a number (V,) for each point (V, 3); coinciding points have the same number."""
    steps = np.round(points / WELD_DISTANCE_M).astype(np.int64)
    steps -= steps.min(axis=0)
    cells = np.ravel_multi_index(tuple(steps.T), tuple(steps.max(axis=0) + 1))
    return np.unique(cells, return_inverse=True)[1]


def _edges(faces: NDArray[np.integer[Any]], chosen: BoolArray) -> NDArray[np.int64]:
    """Returns the directed edges (E, 2) of triangles between the vertices in the mask ``chosen``. Indices count only
    these vertices."""
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    return (np.cumsum(chosen) - 1)[edges[chosen[edges].all(axis=1)]]


def _edge_numbers(edges: NDArray[np.int64], places: int) -> NDArray[np.int64]:
    """Returns a unique number (E,) for each edge (E, 2) between ``places`` numbered points."""
    return edges[:, 0] * places + edges[:, 1]


def _rows(values: NumpyArray, starts: NumpyArray, counts: NumpyArray, index: int) -> NumpyArray:
    return values[starts[index] : starts[index] + counts[index]]


def _uv(model: mujoco.MjModel, skin: int) -> FloatArray:
    start, count = model.skin_texcoordadr[skin], model.skin_vertnum[skin]
    return np.zeros((count, 2)) if start < 0 else model.skin_texcoord[start : start + count]


def _bones(model: mujoco.MjModel, skin: int) -> tuple[tuple[Bone, ...], FloatArray]:
    """Returns the bones of a skin and the weights (V, B) of its vertices."""
    vertices = _rows(model.skin_vert, model.skin_vertadr, model.skin_vertnum, skin)
    bones: list[Bone] = []
    weights: list[FloatArray] = []
    first = model.skin_boneadr[skin]
    for bone in range(first, first + model.skin_bonenum[skin]):
        body = model.body(model.skin_bonebodyid[bone])
        bind = make_pose_matrix(model.skin_bonebindpos[bone], model.skin_bonebindquat[bone])
        inverse_bind = np.linalg.inv(bind).astype(float)
        weight = np.zeros(len(vertices))
        held = _rows(model.skin_bonevertid, model.skin_bonevertadr, model.skin_bonevertnum, bone)
        weight[held] = _rows(model.skin_bonevertweight, model.skin_bonevertadr, model.skin_bonevertnum, bone)
        if body.name.endswith(SWING_BONE_BODY_SUFFIXES):
            down = vertices @ inverse_bind[2, :3] + inverse_bind[2, 3]
            share = np.clip(down / _end_z(model, body.id), 0.0, 1.0)
            bones.append(Bone(body.name, True, inverse_bind))
            weights.append((1.0 - share) * weight)
            weight = share * weight
        bones.append(Bone(body.name, False, inverse_bind))
        weights.append(weight)
    return tuple(bones), np.stack(weights, axis=1)


def _end_z(model: mujoco.MjModel, body: int) -> float:
    """Returns the z coordinate of a body's child in metres, in the frame of the body."""
    child = int(np.flatnonzero(model.body_parentid == body)[0])
    return float(model.body_pos[child, 2])


def _normals(model: mujoco.MjModel) -> list[FloatArray]:
    """Returns area-weighted normals (V, 3) of each skin, averaged over coinciding vertices of one material."""
    found: list[FloatArray] = [np.zeros((0, 3))] * model.nskin
    for material in np.unique(model.skin_matid):
        members = np.flatnonzero(model.skin_matid == material).tolist()
        parts = [_rows(model.skin_vert, model.skin_vertadr, model.skin_vertnum, skin) for skin in members]
        faces = [_rows(model.skin_face, model.skin_faceadr, model.skin_facenum, skin) for skin in members]
        starts = np.cumsum([0, *map(len, parts)])
        merged = np.concatenate([part + start for part, start in zip(faces, starts, strict=False)])
        normals = _welded_normals(np.concatenate(parts), merged)
        for skin, part in zip(members, np.split(normals, starts[1:-1]), strict=True):
            found[skin] = part
    return found


def _welded_normals(vertices: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    _, place = np.unique(vertices.round(5), axis=0, return_inverse=True)
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros((place.max() + 1, 3))
    for corner in range(3):
        np.add.at(total, place.ravel()[faces[:, corner]], areas)
    normals = total[place.ravel()]
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
