"""Triangle meshes of MuJoCo's visual geoms, with normals, simplified for headsets."""

# The types of trimesh are known only in part.
# pyright: reportUnknownMemberType=false

from functools import lru_cache
from typing import cast

import mujoco
import numpy as np
import trimesh

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry.transforms import to_matrix
from avrgym.models.collision_bits import VISUAL_GROUP

MAX_UNSIMPLIFIED_TRIANGLES = 2000
"""Meshes with more triangles are simplified. The result has this number, plus a share of the triangles above it."""
MAX_SMALL_PART_TRIANGLES = 100
MAX_SHOWN_RATIO = 1 / 6
MAX_MODEL_TRIANGLES = 66_000
"""Maximum number of triangles of all meshes of a model. In larger models, the share of shown triangles is lower."""
SIMPLIFICATION_AGGRESSION = 3
"""Speed of the simplification, 0 (best quality) to 10 (fastest). With the default of 7, small parts would disappear."""
WELD_DECIMALS = 5
"""Vertices are merged if their coordinates, rounded to this number of decimals in metres, are equal."""
SMOOTHING_ANGLE_RAD = np.radians(35.0)
"""If the angle between two faces is smaller, their edge is shaded smoothly."""
_simplified_meshes: dict[tuple[bytes, float], trimesh.Trimesh] = {}


def make_geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Returns the triangle mesh of a geom in the frame of its body, in metres."""
    mesh = _unplaced_mesh(model, geom).copy()
    mesh.apply_transform(make_pose_matrix(model.geom_pos[geom], model.geom_quat[geom]))
    return mesh


def make_pose_matrix(pos: FloatArray, q: FloatArray) -> FloatArray:
    """Returns the homogeneous matrix (4, 4) of a pose."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = to_matrix(q), pos
    return matrix


def _unplaced_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _asset_mesh(model, int(model.geom_dataid[geom]))
    return _shape(kind, *model.geom_size[geom].tolist())


@lru_cache(maxsize=512)
def _shape(kind: mujoco.mjtGeom, *size: float) -> trimesh.Trimesh:
    """Returns the mesh of a primitive geom type with these sizes; cached."""
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _flat(trimesh.creation.box(extents=2.0 * np.array(size)))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _cylinder(size[0], size[1])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return trimesh.creation.capsule(radius=size[0], height=2.0 * size[1], count=(10, 10))
    ball = trimesh.creation.icosphere(subdivisions=2)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return ball.apply_scale(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return ball.apply_scale(size)
    raise ValueError(
        f"geom type {kind.name} cannot be exported; allowed: box, cylinder, capsule, sphere, ellipsoid, mesh"
    )


def _asset_mesh(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    """Returns the simplified mesh of a mesh asset; cached."""
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    ratio = _shown_ratio(model)
    key = model.mesh_vert[vertices].tobytes() + model.mesh_face[faces].tobytes(), ratio
    if key not in _simplified_meshes:
        full = trimesh.Trimesh(model.mesh_vert[vertices], model.mesh_face[faces], process=False)
        _simplified_meshes[key] = _simplified(full, ratio)
    return _simplified_meshes[key]


def _shown_ratio(model: mujoco.MjModel) -> float:
    """Returns the ratio of triangles above ``MAX_UNSIMPLIFIED_TRIANGLES`` that a simplified mesh of the model has."""
    shown = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_group == VISUAL_GROUP)
    counts = model.mesh_facenum[model.geom_dataid[shown]]
    extra = np.maximum(counts - MAX_UNSIMPLIFIED_TRIANGLES, 0).sum()
    allowed = MAX_MODEL_TRIANGLES - np.minimum(counts, MAX_UNSIMPLIFIED_TRIANGLES).sum()
    return float(np.clip(allowed / max(extra, 1), 0.0, MAX_SHOWN_RATIO))


def _simplified(full: trimesh.Trimesh, ratio: float) -> trimesh.Trimesh:
    """Returns the mesh with fewer triangles, smooth normals and sharp edges; ``ratio`` as in ``_shown_ratio``."""
    full.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=WELD_DECIMALS)
    full.update_faces(full.nondegenerate_faces())
    extra = len(full.faces) - MAX_UNSIMPLIFIED_TRIANGLES
    if extra > 0:
        full = _decimated(full, MAX_UNSIMPLIFIED_TRIANGLES + int(ratio * extra))
    return cast(trimesh.Trimesh, trimesh.graph.smooth_shade(full, angle=SMOOTHING_ANGLE_RAD))


def _decimated(full: trimesh.Trimesh, face_count: int) -> trimesh.Trimesh:
    """Returns the mesh with ``face_count`` triangles. Small connected parts are unchanged: decimation removes them."""
    labels = cast(IntArray, trimesh.graph.connected_component_labels(full.face_adjacency, len(full.faces)))
    is_small = np.bincount(labels)[labels] <= MAX_SMALL_PART_TRIANGLES
    if not 0 < is_small.sum() < face_count / 2:
        return full.simplify_quadric_decimation(face_count=face_count, aggression=SIMPLIFICATION_AGGRESSION)
    large, small = (_faces(full, each) for each in (~is_small, is_small))
    decimated = large.simplify_quadric_decimation(
        face_count=face_count - len(small.faces), aggression=SIMPLIFICATION_AGGRESSION
    )
    return cast(trimesh.Trimesh, trimesh.util.concatenate([decimated, small]))


def _faces(mesh: trimesh.Trimesh, mask: BoolArray) -> trimesh.Trimesh:
    return cast(trimesh.Trimesh, mesh.submesh([np.flatnonzero(mask)], append=True))


def _flat(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.unmerge_vertices()
    normals = np.repeat(mesh.face_normals, 3, axis=0)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)


def _cylinder(radius_m: float, half_length_m: float) -> trimesh.Trimesh:
    mesh = _flat(trimesh.creation.cylinder(radius=radius_m, height=2.0 * half_length_m, sections=28))
    radial = mesh.vertices * [1.0, 1.0, 0.0] / radius_m
    on_cap = np.abs(mesh.vertex_normals[:, 2:]) > 0.9
    normals = np.where(on_cap, mesh.vertex_normals, radial)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)
