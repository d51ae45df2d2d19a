"""Exports a scene to a GLB file for the client.

Nodes are in the world frame, z up. The field ``extras`` of a node contains the bodies that move it:

- ``body``: the node follows this body. Bodies that are fixed to each other share a node; the tool has its own.
- ``swing``: the node follows this body without the twist about its z axis; ``parent``: its parent body. See ``skins``.
- ``bodies``: the mesh is instanced at each of these bodies.
- ``vertices``: the mesh is a cloth; the position of each vertex is the position of one of these bodies.
- ``skin_of``: the mesh is skinned; this body has the largest weight.

A camera of the model is a child of its body's node.

Colours are vertex colours, computed from geom and material as in MuJoCo. All geoms of a node with the same
``SurfaceMaterial`` are one mesh. This reduces the number of draw calls and the rendering time on a headset.
"""

# The types of trimesh are known only in part.
# pyright: reportUnknownMemberType=false

import io
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from avrgym.array_types import FloatArray
from avrgym.models import human
from avrgym.models.collision_bits import VISUAL_GROUP
from avrgym.models.colours import (
    compute_geom_colours,
    convert_srgb_to_linear,
    find_texture_index,
    read_texture_pixels,
)
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.vr.scene.geom_meshes import make_geom_mesh, make_pose_matrix
from avrgym.vr.scene.glb_writer import GlbWriter
from avrgym.vr.scene.skins import Bone, Skin, add_cap, merge_skins, read_skins

ColouredMesh = tuple[trimesh.Trimesh, FloatArray]
"""(mesh, its colour (4,): red, green, blue, alpha)."""

HEAD_BODY = human.PERSON_NAME_PREFIX + "head"
DEFAULT_ROUGHNESS = 0.75
"""Roughness (0 to 1) of geoms without a roughness in their material, similar to MuJoCo's renderer."""
MIN_INSTANCED_BODIES = 3
"""Minimum number of identical bodies that become instances of one mesh."""
_SHORT, _BYTE = np.iinfo(np.int16).max, np.iinfo(np.int8).max


@dataclass(frozen=True)
class SurfaceMaterial:
    """Properties of a surface except its colour.

    ``texture_id`` is the id of a texture in the model, or −1. Cloth is ``two_sided``.
    """

    metallic_factor: float
    roughness: float
    alpha: float
    texture_id: int = -1
    two_sided: bool = False

    @classmethod
    def from_material(
        cls, model: mujoco.MjModel, material: int, alpha: float, texture: int = -1
    ) -> "SurfaceMaterial":
        """Returns the surface material of a material id (−1: no material). Rounded values limit the number of different
        materials."""
        metallic, roughness = (
            (model.mat_metallic[material], model.mat_roughness[material]) if material >= 0 else (-1.0, -1.0)
        )
        return cls(
            metallic_factor=round(2.0 * float(metallic)) / 2.0 if metallic >= 0.0 else 0.0,
            roughness=round(4.0 * float(roughness)) / 4.0 if roughness >= 0.0 else DEFAULT_ROUGHNESS,
            alpha=round(float(alpha), 2),
            texture_id=texture,
        )


def export_glb(model: mujoco.MjModel) -> bytes:
    """Returns the GLB file of the visual geoms, skins and cloth of a model that includes materials and textures."""
    return _Export(model).run()


class _Export:
    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._glb = model, GlbWriter()
        self._colours = compute_geom_colours(model)
        self._data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)
        self._roots: list[int] = []
        self._finishes: dict[SurfaceMaterial, int] = {}
        self._joints: dict[tuple[str, bool], int] = {}

    def run(self) -> bytes:
        carried = group_geoms_by_body(self._model)
        for bodies in _instances(self._model, self._colours, carried):
            self._add_copies(bodies, carried.pop(bodies[0]))
            for body in bodies[1:]:
                del carried[body]
        for body, geoms in carried.items():
            self._add_body(body, geoms)
        for (_, finish), skins in self._skins_by_finish().items():
            self._add_skin(merge_skins(skins), finish)
        for flex in range(self._model.nflex):
            self._add_cloth(flex)
        return self._glb.to_bytes(self._roots)

    # Rigid bodies

    def _add_body(self, body: int, geoms: list[int]) -> None:
        children = [
            self._glb.add_element("nodes", mesh=mesh, scale=[scale] * 3)
            for finish, pieces in self._by_finish(body, geoms).items()
            for mesh, scale in [self._add_mesh(pieces, finish)]
        ]
        self._add_root(body, children=[*children, *self._add_cameras(body)])

    def _add_cameras(self, body: int) -> list[int]:
        """Adds the cameras that are fixed to a body. Returns their node indices. GLB and MuJoCo cameras have the same
        axes."""
        nodes: list[int] = []
        for number in np.flatnonzero(self._model.cam_bodyid == body).tolist():
            yfov = float(np.radians(self._model.cam_fovy[number]))
            camera = self._glb.add_element(
                "cameras", type="perspective", perspective={"yfov": yfov, "znear": 0.01}
            )
            w, x, y, z = self._model.cam_quat[number].tolist()
            pos = self._model.cam_pos[number].tolist()
            name = self._model.camera(number).name
            nodes.append(
                self._glb.add_element(
                    "nodes", name=name, camera=camera, translation=pos, rotation=[x, y, z, w]
                )
            )
        return nodes

    def _add_root(self, body: int, **content: object) -> int:
        name = self._model.body(body).name
        node = self._glb.add_element("nodes", name=name, **self._pose(body), **content, extras={"body": name})
        self._roots.append(node)
        return node

    def _add_copies(self, bodies: list[int], geoms: list[int]) -> None:
        ((finish, pieces),) = self._by_finish(bodies[0], geoms).items()
        mesh, _ = self._add_mesh(pieces, finish, quantised=False)
        names = [self._model.body(body).name for body in bodies]
        self._roots.append(self._glb.add_element("nodes", mesh=mesh, extras={"bodies": names}))

    def _pose(self, body: int) -> dict[str, list[float]]:
        w, x, y, z = self._data.xquat[body].tolist()
        return {"translation": self._data.xpos[body].tolist(), "rotation": [x, y, z, w]}

    def _by_finish(self, carrier: int, geoms: Iterable[int]) -> dict[SurfaceMaterial, list[ColouredMesh]]:
        """Returns the geoms of one node, by surface material, in the frame of the node's body."""
        pieces: dict[SurfaceMaterial, list[ColouredMesh]] = {}
        from_world = np.linalg.inv(make_pose_matrix(self._data.xpos[carrier], self._data.xquat[carrier]))
        for geom in geoms:
            body, colour = self._model.geom_bodyid[geom], self._colours[geom]
            mesh = make_geom_mesh(self._model, geom)
            mesh.apply_transform(from_world @ make_pose_matrix(self._data.xpos[body], self._data.xquat[body]))
            finish = SurfaceMaterial.from_material(self._model, int(self._model.geom_matid[geom]), colour[3])
            pieces.setdefault(finish, []).append((mesh, colour))
        return pieces

    def _add_mesh(
        self, pieces: list[ColouredMesh], finish: SurfaceMaterial, *, quantised: bool = True
    ) -> tuple[int, float]:
        """Adds one mesh that contains all given meshes. Returns its index and the scale of its coordinates."""
        mesh = trimesh.util.concatenate([piece for piece, _ in pieces])
        assert isinstance(mesh, trimesh.Trimesh)
        rgba = np.concatenate([np.tile(colour, (len(piece.vertices), 1)) for piece, colour in pieces])
        scale = float(np.abs(mesh.vertices).max()) if quantised else 1.0
        surface = self._surface(mesh.vertices, mesh.vertex_normals, rgba, scale, quantised=quantised)
        return self._add_primitive(surface, mesh.faces, finish), scale

    def _surface(
        self,
        vertices: FloatArray,
        normals: FloatArray,
        rgba: FloatArray,
        scale: float,
        *,
        quantised: bool = True,
    ) -> dict[str, int]:
        places = np.round(vertices / scale * _SHORT).astype(np.int16) if quantised else vertices.astype("<f4")
        linear = convert_srgb_to_linear(rgba[:, :3])
        return {
            "POSITION": self._glb.add_vertices(places, normalized=quantised),
            "NORMAL": self._glb.add_vertices(np.round(normals * _BYTE).astype(np.int8), normalized=True),
            "COLOR_0": self._glb.add_vertices(_full_range(linear, np.uint8), normalized=True),
        }

    def _add_primitive(
        self, attributes: dict[str, int], faces: NDArray[np.integer[Any]], finish: SurfaceMaterial
    ) -> int:
        indices = self._glb.add_indices(faces)
        primitive = {"attributes": attributes, "indices": indices, "material": self._material(finish)}
        return self._glb.add_element("meshes", primitives=[primitive])

    # Skins

    def _skins_by_finish(self) -> dict[tuple[bool, SurfaceMaterial], list[Skin]]:
        """Returns groups of skins, by (whether it is the head, surface material). Each group becomes one mesh.

        The head is separate, because the first-person view hides it. All other skins have a cap at the neck.
        """
        groups: dict[tuple[bool, SurfaceMaterial], list[Skin]] = {}
        skins = list(read_skins(self._model))
        head = [skin for skin in skins if skin.main_body_name == HEAD_BODY]
        for skin in skins:
            of_head = skin.main_body_name == HEAD_BODY
            if not of_head:
                skin = reduce(add_cap, head, skin)
            texture = find_texture_index(self._model, skin.material_id)
            finish = SurfaceMaterial.from_material(
                self._model, skin.material_id, float(skin.rgba[0, 3]), texture
            )
            groups.setdefault((of_head, finish), []).append(skin)
        return groups

    def _add_skin(self, skin: Skin, finish: SurfaceMaterial) -> None:
        scale = float(np.abs(skin.vertices).max())
        attributes = self._surface(skin.vertices, skin.normals, skin.rgba, scale) | {
            "TEXCOORD_0": self._glb.add_vertices(_full_range(skin.uv, np.uint16), normalized=True),
            "JOINTS_0": self._glb.add_vertices(skin.bone_indices.astype(np.uint8)),
            "WEIGHTS_0": self._glb.add_vertices(_weights(skin.bone_weights), normalized=True),
        }
        mesh = self._add_primitive(attributes, skin.faces, finish)
        joints = [self._joint(bone) for bone in skin.bones]
        grown = np.diag([scale, scale, scale, 1.0])
        inverse = self._glb.add_matrices(np.stack([bone.inverse_bind_matrix @ grown for bone in skin.bones]))
        rig = self._glb.add_element("skins", joints=joints, inverseBindMatrices=inverse)
        extras = {"skin_of": skin.main_body_name}
        self._roots.append(self._glb.add_element("nodes", name=skin.name, mesh=mesh, skin=rig, extras=extras))

    def _joint(self, bone: Bone) -> int:
        key = bone.body_name, bone.is_swing
        if key not in self._joints:
            body = self._model.body(bone.body_name).id
            self._joints[key] = self._add_swing(body) if bone.is_swing else self._add_root(body)
        return self._joints[key]

    def _add_swing(self, body: int) -> int:
        name = self._model.body(body).name
        parent = self._model.body(self._model.body_parentid[body]).name
        extras = {"swing": name, "parent": parent}
        node = self._glb.add_element("nodes", name=f"{name}/swing", **self._pose(body), extras=extras)
        self._roots.append(node)
        return node

    # Cloth

    def _add_cloth(self, flex: int) -> None:
        model = self._model
        first, count = int(model.flex_vertadr[flex]), int(model.flex_vertnum[flex])
        corners, triangles = int(model.flex_elemdataadr[flex]), int(model.flex_elemnum[flex])
        bodies = model.flex_vertbodyid[first : first + count]
        faces = model.flex_elem[corners : corners + 3 * triangles].reshape(-1, 3)
        material = int(model.flex_matid[model.flex_elemadr[flex]])
        mesh = trimesh.Trimesh(self._data.xpos[bodies], faces, process=False)
        rgba = np.tile(model.mat_rgba[material], (count, 1))
        surface = self._surface(mesh.vertices, mesh.vertex_normals, rgba, 1.0, quantised=False)
        finish = replace(SurfaceMaterial.from_material(model, material, float(rgba[0, 3])), two_sided=True)
        primitive = self._add_primitive(surface, faces, finish)
        extras = {"vertices": [model.body(body).name for body in bodies]}
        self._roots.append(self._glb.add_element("nodes", mesh=primitive, extras=extras))

    # Materials

    def _material(self, finish: SurfaceMaterial) -> int:
        if finish not in self._finishes:
            surface = {
                "metallicFactor": finish.metallic_factor,
                "roughnessFactor": finish.roughness,
                **self._texture(finish.texture_id),
            }
            blend: dict[str, object] = {}
            if finish.alpha < 1.0:
                surface["baseColorFactor"] = [1.0, 1.0, 1.0, finish.alpha]
                blend["alphaMode"] = "BLEND"
            if finish.two_sided:
                blend["doubleSided"] = True
            self._finishes[finish] = self._glb.add_element("materials", pbrMetallicRoughness=surface, **blend)
        return self._finishes[finish]

    def _texture(self, texture: int) -> dict[str, object]:
        if texture < 0:
            return {}
        encoded = io.BytesIO()
        Image.fromarray(read_texture_pixels(self._model, texture)).save(encoded, "JPEG", quality=88)
        return {"baseColorTexture": {"index": self._glb.add_texture(encoded.getvalue(), "image/jpeg")}}


def group_geoms_by_body(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Returns the ids of visible geoms, by body id. Bodies that are fixed to each other have the id of their topmost
    body."""
    found: dict[int, list[int]] = {}
    visible = (model.geom_group == VISUAL_GROUP) & (compute_geom_colours(model)[:, 3] > 0.0)
    for geom in range(model.ngeom):
        if visible[geom]:
            found.setdefault(_carrier(model, int(model.geom_bodyid[geom])), []).append(geom)
    return found


def _carrier(model: mujoco.MjModel, body: int) -> int:
    """Returns the topmost ancestor to which a body is fixed.

    Children of the world are considered movable, because episodes place them. The tool has its own node, because
    clients highlight it.
    """
    while (
        model.body_jntnum[body] == 0
        and model.body_parentid[body] != 0
        and model.body(body).name != SCENE_TOOL_BODY
    ):
        body = int(model.body_parentid[body])
    return body


def _instances(model: mujoco.MjModel, colours: FloatArray, carried: dict[int, list[int]]) -> list[list[int]]:
    """Returns groups of at least ``MIN_INSTANCED_BODIES`` identical bodies with one geom each, as body ids."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for body, geoms in carried.items():
        if len(geoms) == 1 and model.geom_type[geoms[0]] != mujoco.mjtGeom.mjGEOM_MESH:
            (geom,) = geoms
            looks = model.geom_type[geom], model.geom_matid[geom], *colours[geom], *model.geom_size[geom]
            place = *model.geom_pos[geom], *model.geom_quat[geom]
            groups.setdefault((*looks, *place), []).append(body)
    return [bodies for bodies in groups.values() if len(bodies) >= MIN_INSTANCED_BODIES]


def _full_range(shares: FloatArray, kind: type[np.unsignedinteger[Any]]) -> NDArray[np.unsignedinteger[Any]]:
    return np.round(shares * np.iinfo(kind).max).astype(kind)


def _weights(weight_of: FloatArray) -> NDArray[np.uint8]:
    """Returns skinning weights (V, 4) as bytes. The four weights of a vertex sum to 255."""
    weights = np.round(255.0 * weight_of)
    weights[:, 0] += 255.0 - weights.sum(axis=1)
    return weights.astype(np.uint8)
