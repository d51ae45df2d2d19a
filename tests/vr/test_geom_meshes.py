"""Meshes for headsets have fewer triangles and the same surface."""

from functools import cache

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from avrgym.array_types import FloatArray
from avrgym.models.collision_bits import VISUAL_GROUP
from avrgym.vr.scene.geom_meshes import MAX_UNSIMPLIFIED_TRIANGLES, make_geom_mesh, make_pose_matrix
from helpers.robots.example_robots import ALL_ROBOTS, robot_model

LEAST_AREA, MOST_AREA = 0.97, 1.03
OFF_M, MOST_OFF_M = 0.003, 0.007
"""Of nearly all points, and of ribs in openings of a housing."""
NEARLY_ALL = 0.995
TURNED_DEG = 60.0
"""How far a vertex's normal may be from that of a triangle around it."""
SAMPLES, PERSON_LOCATIONS, NEAREST = 2000, 60_000, 24


@cache
def robot_meshes(name: str) -> list[tuple[str, trimesh.Trimesh, trimesh.Trimesh]]:
    """The robot's meshes as their files have them and as they are shown, each once."""
    model = robot_model(name)
    is_mesh = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_group == VISUAL_GROUP)
    meshes, geoms = np.unique(model.geom_dataid[is_mesh], return_index=True)
    shown = np.flatnonzero(is_mesh)[geoms]
    return [
        (model.mesh(mesh).name, as_stored(model, geom), make_geom_mesh(model, geom))
        for mesh, geom in zip(meshes.tolist(), shown.tolist(), strict=True)
    ]


def as_stored(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    mesh = model.geom_dataid[geom]
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    stored = trimesh.Trimesh(vertices, faces, process=False)
    return stored.apply_transform(make_pose_matrix(model.geom_pos[geom], model.geom_quat[geom]))


def distances_m(one: trimesh.Trimesh, other: trimesh.Trimesh) -> FloatArray:
    """How far points of one surface are from the other."""
    points, *_ = trimesh.sample.sample_surface(one, SAMPLES, seed=0)
    places, of_face, *_ = trimesh.sample.sample_surface(other, PERSON_LOCATIONS, seed=1)
    places = np.concatenate([places, other.triangles_center])
    of_face = np.concatenate([of_face, np.arange(len(other.faces))])
    _, near = cKDTree(places).query(points, k=NEAREST)
    away = [
        np.linalg.norm(
            trimesh.triangles.closest_point(other.triangles[of_face[each]], points) - points, axis=1
        )
        for each in near.T
    ]
    return np.min(away, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_ROBOTS)
def test_a_simplified_mesh_keeps_its_surface(name: str) -> None:
    """Also where a file stores each triangle by itself."""
    simplified = [each for each in robot_meshes(name) if len(each[1].faces) > MAX_UNSIMPLIFIED_TRIANGLES]
    off = {
        mesh: np.concatenate([distances_m(stored, shown), distances_m(shown, stored)])
        for mesh, stored, shown in simplified
    }
    assert {mesh: away.max() for mesh, away in off.items() if away.max() > MOST_OFF_M} == {}
    assert [mesh for mesh, away in off.items() if np.quantile(away, NEARLY_ALL) > OFF_M] == []


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("name", ALL_ROBOTS)
def test_a_mesh_keeps_its_area(name: str) -> None:
    meshes = robot_meshes(name)
    shares = {mesh: shown.area / stored.area for mesh, stored, shown in meshes}
    assert meshes
    assert {mesh: share for mesh, share in shares.items() if not LEAST_AREA < share < MOST_AREA} == {}


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("name", ALL_ROBOTS)
def test_normals_are_those_of_the_surface(name: str) -> None:
    """No face is shaded as if it faced another way, but for slivers."""
    for _, _, shown in robot_meshes(name):
        cosines = (shown.vertex_normals[shown.faces] * shown.face_normals[:, None]).sum(axis=2).min(axis=1)
        turned = shown.area_faces[cosines < np.cos(np.radians(TURNED_DEG))].sum()
        assert turned < 0.04 * shown.area


def test_triangles_with_vertices_of_their_own_are_simplified_as_one_surface() -> None:
    """A sphere of a file that shares no vertex."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    spec = mujoco.MjSpec()
    spec.add_mesh(
        name="ball",
        uservert=ball.triangles.ravel(),
        userface=np.arange(3 * len(ball.faces)),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ball", group=VISUAL_GROUP)
    shown = make_geom_mesh(spec.compile(), 0)
    assert len(shown.faces) < len(ball.faces) / 2
    assert shown.area > LEAST_AREA * ball.area
    np.testing.assert_allclose(np.linalg.norm(shown.vertices, axis=1), 0.1, rtol=0.01)
