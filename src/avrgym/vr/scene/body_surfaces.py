"""Surfaces of each body as coloured triangles, for viewers that cannot render skins.

Skins are divided by body. Each triangle belongs to the body with the largest skinning weight.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray, IntArray
from avrgym.models.colours import compute_geom_colours, find_texture_index, read_texture_pixels
from avrgym.vr.scene.geom_meshes import make_geom_mesh, make_pose_matrix
from avrgym.vr.scene.scene_export import group_geoms_by_body
from avrgym.vr.scene.skins import Skin, read_skins


@dataclass(frozen=True, eq=False)
class BodySurface:
    """A triangle mesh in the frame of a body: ``vertices`` (V, 3) in metres, ``faces`` (F, 3), ``rgba`` (V, 4)."""

    vertices: FloatArray
    faces: NDArray[np.int64]
    rgba: FloatArray


def make_body_surfaces(model: mujoco.MjModel) -> dict[str, list[BodySurface]]:
    """Returns the surfaces of a model, by body name. The model must include materials and textures."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    colours = compute_geom_colours(model)
    found: dict[str, list[BodySurface]] = {}
    for carrier, geoms in group_geoms_by_body(model).items():
        from_world = np.linalg.inv(make_pose_matrix(data.xpos[carrier], data.xquat[carrier])).astype(float)
        found[model.body(carrier).name] = [
            _of_geom(model, data, geom, from_world, colours[geom]) for geom in geoms
        ]
    for skin in read_skins(model):
        colours = _skin_colours(model, skin)
        for body, surface in _cut(skin, colours):
            found.setdefault(body, []).append(surface)
    return found


def _of_geom(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, from_world: FloatArray, rgba: FloatArray
) -> BodySurface:
    body = model.geom_bodyid[geom]
    mesh = make_geom_mesh(model, geom)
    to_carrier = from_world @ make_pose_matrix(data.xpos[body], data.xquat[body])
    mesh.apply_transform(to_carrier)  # pyright: ignore[reportUnknownMemberType]
    return BodySurface(
        np.asarray(mesh.vertices), np.asarray(mesh.faces), np.tile(rgba, (len(mesh.vertices), 1))
    )


def _skin_colours(model: mujoco.MjModel, skin: Skin) -> FloatArray:
    """Returns the colour RGBA (V, 4) of each vertex: material colour times texture colour."""
    colours, texture = skin.rgba.copy(), find_texture_index(model, skin.material_id)
    if texture >= 0:
        pixels = read_texture_pixels(model, texture)
        row, column = (
            np.clip(skin.uv[:, axis] * size, 0, size - 1).astype(int)
            for axis, size in ((1, pixels.shape[0]), (0, pixels.shape[1]))
        )
        colours[:, :3] *= pixels[row, column, :3] / 255.0
    return colours


def _cut(skin: Skin, colours: FloatArray) -> list[tuple[str, BodySurface]]:
    """Divides a skin by body. Returns body names and surfaces, each in the frame of its body."""
    bodies = list(dict.fromkeys(bone.body_name for bone in skin.bones))
    of_bone = np.array([bodies.index(bone.body_name) for bone in skin.bones])
    weights = np.zeros((len(skin.vertices), len(bodies)))
    for place in range(skin.bone_indices.shape[1]):
        np.add.at(
            weights,
            (np.arange(len(weights)), of_bone[skin.bone_indices[:, place]]),
            skin.bone_weights[:, place],
        )
    of_face: IntArray = weights[skin.faces].sum(axis=1).argmax(axis=1)
    parts: list[tuple[str, BodySurface]] = []
    for number in map(int, np.unique(of_face)):
        used, faces = np.unique(skin.faces[of_face == number], return_inverse=True)
        bind = next(bone.inverse_bind_matrix for bone in skin.bones if bone.body_name == bodies[number])
        vertices = skin.vertices[used] @ bind[:3, :3].T + bind[:3, 3]
        parts.append((bodies[number], BodySurface(vertices, faces.reshape(-1, 3), colours[used])))
    return parts
