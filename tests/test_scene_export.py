"""What the client draws: the GLB against the model that it comes from."""

import io
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import pytest
import trimesh

from avrgym.models.human import Person
from avrgym.models.scene import build_spec
from avrgym.vr.scene_export import export_glb, visible_bodies

if TYPE_CHECKING:
    from avrgym.models.scene import Stage

MOST_MESHES, MOST_TRIANGLES = 100, 300_000
REACH_M = 1.2
"""How far a body's picture may go from its frame: the table is the largest."""


@pytest.fixture(scope="module")
def model(feeding_stage: "Stage") -> mujoco.MjModel:
    return build_spec(feeding_stage, Person("man", 0.6), moving=True, appearance=True).compile()


@pytest.fixture(scope="module")
def scene(model: mujoco.MjModel) -> trimesh.Scene:
    loaded = trimesh.load(io.BytesIO(export_glb(model)), file_type="glb")
    assert isinstance(loaded, trimesh.Scene)
    return loaded


def test_every_visible_body_is_a_node_that_names_it(model: mujoco.MjModel, scene: trimesh.Scene) -> None:
    edges = scene.graph.to_edgelist()
    named = [data["metadata"]["body"] for _, _, data in edges if "body" in data.get("metadata", {})]
    assert sorted(named) == sorted(visible_bodies(model))
    assert {"person/head", "person/right_hand", "wheelchair", "robot/tool", "food_7"} <= set(named)


def test_a_headset_can_draw_it(scene: trimesh.Scene) -> None:
    assert len(scene.geometry) < MOST_MESHES
    assert sum(len(mesh.faces) for mesh in scene.geometry.values()) < MOST_TRIANGLES


def test_every_mesh_is_sound(scene: trimesh.Scene) -> None:
    for name, mesh in scene.geometry.items():
        assert np.isfinite(mesh.vertices).all(), name
        assert mesh.visual.material.name, name
        lengths = np.linalg.norm(mesh.vertex_normals, axis=1)
        np.testing.assert_allclose(lengths, 1.0, atol=1e-3, err_msg=name)


def test_bodies_stand_where_the_model_has_them(model: mujoco.MjModel, scene: trimesh.Scene) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for body in visible_bodies(model):
        matrix, _ = scene.graph.get(body)
        np.testing.assert_allclose(matrix[:3, 3], data.body(body).xpos, atol=1e-6)


def test_nothing_is_drawn_far_from_its_body(model: mujoco.MjModel, scene: trimesh.Scene) -> None:
    for name, mesh in scene.geometry.items():
        if not name.startswith("table"):
            assert np.linalg.norm(mesh.vertices, axis=1).max() < REACH_M, name
