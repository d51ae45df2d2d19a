"""The scene as a GLB file: what the client draws, from the same model that pictures use.

One node per body with ``extras.body``, its meshes below it, one per material, in the body's frame; z up.
"""

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from avrgym.models.contacts import VISUAL_GROUP
from avrgym.transforms import to_matrix

DETAILED_TRIANGLES = 1500
"""Meshes with more triangles keep these and an eighth of the rest: CAD meshes have far more than a headset shows."""
SMOOTHING_ANGLE_RAD = np.radians(35.0)


def visible_bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """The bodies that have something to draw, in the model's order."""
    return tuple(model.body(body).name for body in _geoms_by_body(model))


def export_glb(model: mujoco.MjModel) -> bytes:
    """The visual geoms of a model that was built with its appearance."""
    scene = trimesh.Scene(base_frame="world")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for body, geoms in _geoms_by_body(model).items():
        name = model.body(body).name
        pose = _matrix(data.xpos[body], data.xquat[body])
        scene.graph.update(frame_to=name, frame_from="world", matrix=pose, metadata={"body": name})
        for material, mesh in _meshes_by_material(model, geoms).items():
            scene.add_geometry(
                mesh, node_name=f"{name}:{material}", geom_name=f"{name}:{material}", parent_node_name=name
            )
    return scene.export(file_type="glb", include_normals=True)  # type: ignore[return-value]


def _geoms_by_body(model: mujoco.MjModel) -> dict[int, list[int]]:
    found: dict[int, list[int]] = {}
    for geom in range(model.ngeom):
        if model.geom_group[geom] == VISUAL_GROUP:
            found.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    return found


def _meshes_by_material(model: mujoco.MjModel, geoms: list[int]) -> dict[str, trimesh.Trimesh]:
    pieces: dict[int, list[trimesh.Trimesh]] = {}
    for geom in geoms:
        pieces.setdefault(int(model.geom_matid[geom]), []).append(_geom_mesh(model, geom))
    return {model.mat(material).name: _painted(model, material, parts) for material, parts in pieces.items()}


def _painted(model: mujoco.MjModel, material: int, parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    mesh = trimesh.util.concatenate(parts)
    assert isinstance(mesh, trimesh.Trimesh)
    linear = np.append(model.mat_rgba[material][:3] ** 2.2, 1.0)
    mesh.visual = TextureVisuals(
        material=PBRMaterial(
            name=model.mat(material).name,
            baseColorFactor=linear,
            metallicFactor=float(model.mat_metallic[material]),
            roughnessFactor=float(model.mat_roughness[material]),
        )
    )
    return mesh


def _geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    mesh = _unplaced_mesh(model, geom)
    mesh.apply_transform(_matrix(model.geom_pos[geom], model.geom_quat[geom]))
    return mesh


def _unplaced_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _asset_mesh(model, int(model.geom_dataid[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _flat(trimesh.creation.box(extents=2.0 * size))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _cylinder(float(size[0]), float(size[1]))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return trimesh.creation.capsule(radius=size[0], height=2.0 * size[1], count=(10, 10))
    ball = trimesh.creation.icosphere(subdivisions=2)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return ball.apply_scale(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return ball.apply_scale(size)
    raise ValueError(f"cannot draw a geom of type {kind.name}")


def _asset_mesh(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    """A mesh, simplified where it has very many triangles: smooth where it is smooth, sharp at its edges."""
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    full = trimesh.Trimesh(model.mesh_vert[vertices], model.mesh_face[faces], process=False)
    if len(full.faces) > DETAILED_TRIANGLES:
        full = full.simplify_quadric_decimation(face_count=_kept_triangles(len(full.faces)))
    return trimesh.graph.smooth_shade(full, angle=SMOOTHING_ANGLE_RAD)


def _kept_triangles(count: int) -> int:
    return DETAILED_TRIANGLES + (count - DETAILED_TRIANGLES) // 8


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


def _matrix(pos: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = to_matrix(q), pos
    return matrix
