"""The scene as a GLB file: what the client draws, from the same model that pictures use.

Its nodes stand in the world's frame, z up, and say in ``extras`` what moves them:

- ``body``: the node follows this body. Bodies that cannot move against each other are one node.
- ``swing``: the node follows this body without its twist about its own z axis, ``parent`` being the body that carries
  it; see ``skins``.
- ``bodies``: the mesh is drawn once at each of these bodies, which look alike.
- ``skin_of``: a skinned mesh, and the body that most of it follows.
"""

import io
from collections.abc import Iterable

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from avrgym.models.contacts import VISUAL_GROUP
from avrgym.vr.glb import Glb
from avrgym.vr.meshes import geom_mesh, pose_matrix
from avrgym.vr.skins import Bone, Skin, skins_of

Array = NDArray[np.float64]

FEWEST_ALIKE = 3
"""So many bodies must look alike to be drawn as copies of one."""
_SHORT, _BYTE = np.iinfo(np.int16).max, np.iinfo(np.int8).max


def export_glb(model: mujoco.MjModel) -> bytes:
    """The visual geoms and skins of a model that was built with its appearance."""
    return _Export(model).run()


class _Export:
    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._glb = model, Glb()
        self._data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)
        self._roots: list[int] = []
        self._materials: dict[int, int] = {}
        self._joints: dict[tuple[str, bool], int] = {}

    def run(self) -> bytes:
        carried = _geoms_by_carrier(self._model)
        for bodies in _alike(self._model, carried):
            self._add_copies(bodies, carried.pop(bodies[0]))
            for body in bodies[1:]:
                del carried[body]
        for body, geoms in carried.items():
            self._add_body(body, geoms)
        for skin in skins_of(self._model):
            self._add_skin(skin)
        return self._glb.finish(self._roots)

    # Rigid things

    def _add_body(self, body: int, geoms: list[int]) -> None:
        children = [
            self._glb.add("nodes", mesh=mesh, scale=[scale] * 3)
            for material, part in self._by_material(body, geoms).items()
            for mesh, scale in [self._add_mesh(part, material)]
        ]
        self._add_root(body, children=children)

    def _add_root(self, body: int, **content: object) -> int:
        name = self._model.body(body).name
        node = self._glb.add("nodes", name=name, **self._pose(body), **content, extras={"body": name})
        self._roots.append(node)
        return node

    def _add_copies(self, bodies: list[int], geoms: list[int]) -> None:
        ((material, part),) = self._by_material(bodies[0], geoms).items()
        mesh, _ = self._add_mesh(part, material, quantised=False)
        names = [self._model.body(body).name for body in bodies]
        self._roots.append(self._glb.add("nodes", mesh=mesh, extras={"bodies": names}))

    def _pose(self, body: int) -> dict[str, list[float]]:
        w, x, y, z = self._data.xquat[body].tolist()
        return {"translation": self._data.xpos[body].tolist(), "rotation": [x, y, z, w]}

    def _by_material(self, carrier: int, geoms: Iterable[int]) -> dict[int, trimesh.Trimesh]:
        """The geoms of one node, joined by material, in the frame of the body that carries them."""
        pieces: dict[int, list[trimesh.Trimesh]] = {}
        from_world = np.linalg.inv(pose_matrix(self._data.xpos[carrier], self._data.xquat[carrier]))
        for geom in geoms:
            body = self._model.geom_bodyid[geom]
            mesh = geom_mesh(self._model, geom)
            mesh.apply_transform(from_world @ pose_matrix(self._data.xpos[body], self._data.xquat[body]))
            pieces.setdefault(int(self._model.geom_matid[geom]), []).append(mesh)
        return {material: _joined(parts) for material, parts in pieces.items()}

    def _add_mesh(self, mesh: trimesh.Trimesh, material: int, *, quantised: bool = True) -> tuple[int, float]:
        """A mesh and the scale of its numbers."""
        scale = float(np.abs(mesh.vertices).max()) if quantised else 1.0
        attributes = self._surface(mesh.vertices, mesh.vertex_normals, scale, quantised=quantised)
        return self._add_primitive(attributes, mesh.faces, material), scale

    def _surface(
        self, vertices: Array, normals: Array, scale: float, *, quantised: bool = True
    ) -> dict[str, int]:
        places = np.round(vertices / scale * _SHORT).astype(np.int16) if quantised else vertices.astype("<f4")
        return {
            "POSITION": self._glb.add_vertices(places, normalized=quantised),
            "NORMAL": self._glb.add_vertices(np.round(normals * _BYTE).astype(np.int8), normalized=True),
        }

    def _add_primitive(self, attributes: dict[str, int], faces: NDArray, material: int) -> int:
        indices = self._glb.add_indices(faces)
        primitive = {"attributes": attributes, "indices": indices, "material": self._material(material)}
        return self._glb.add("meshes", primitives=[primitive])

    # Skins

    def _add_skin(self, skin: Skin) -> None:
        scale = float(np.abs(skin.vertices).max())
        attributes = self._surface(skin.vertices, skin.normals, scale) | {
            "TEXCOORD_0": self._glb.add_vertices(_full_range(skin.uv, np.uint16), normalized=True),
            "JOINTS_0": self._glb.add_vertices(skin.bone_of.astype(np.uint8)),
            "WEIGHTS_0": self._glb.add_vertices(_weights(skin.weight_of), normalized=True),
        }
        mesh = self._add_primitive(attributes, skin.faces, skin.material)
        joints = [self._joint(bone) for bone in skin.bones]
        grown = np.diag([scale, scale, scale, 1.0])
        inverse = self._glb.add_matrices(np.stack([bone.inverse_bind @ grown for bone in skin.bones]))
        rig = self._glb.add("skins", joints=joints, inverseBindMatrices=inverse)
        extras = {"skin_of": skin.main_body}
        self._roots.append(self._glb.add("nodes", name=skin.name, mesh=mesh, skin=rig, extras=extras))

    def _joint(self, bone: Bone) -> int:
        key = bone.body, bone.swing
        if key not in self._joints:
            body = self._model.body(bone.body).id
            self._joints[key] = self._add_swing(body) if bone.swing else self._add_root(body)
        return self._joints[key]

    def _add_swing(self, body: int) -> int:
        name = self._model.body(body).name
        parent = self._model.body(self._model.body_parentid[body]).name
        extras = {"swing": name, "parent": parent}
        node = self._glb.add("nodes", name=f"{name}/swing", **self._pose(body), extras=extras)
        self._roots.append(node)
        return node

    # Materials

    def _material(self, number: int) -> int:
        if number not in self._materials:
            model = self._model
            self._materials[number] = self._glb.add(
                "materials",
                name=model.mat(number).name,
                pbrMetallicRoughness={
                    "baseColorFactor": [*(model.mat_rgba[number][:3] ** 2.2).tolist(), 1.0],
                    "metallicFactor": float(model.mat_metallic[number]),
                    "roughnessFactor": float(model.mat_roughness[number]),
                    **self._texture(number),
                },
            )
        return self._materials[number]

    def _texture(self, material: int) -> dict[str, object]:
        texture = self._model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]
        if texture < 0:
            return {}
        model, start = self._model, self._model.tex_adr[texture]
        shape = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
        pixels = model.tex_data[start : start + np.prod(shape)].reshape(shape)
        encoded = io.BytesIO()
        Image.fromarray(pixels).save(encoded, "JPEG", quality=88)
        return {"baseColorTexture": {"index": self._glb.add_texture(encoded.getvalue(), "image/jpeg")}}


def _geoms_by_carrier(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Visual geoms by the body that carries them: the outermost one that they cannot move against."""
    found: dict[int, list[int]] = {}
    for geom in range(model.ngeom):
        if model.geom_group[geom] == VISUAL_GROUP:
            found.setdefault(_carrier(model, int(model.geom_bodyid[geom])), []).append(geom)
    return found


def _carrier(model: mujoco.MjModel, body: int) -> int:
    """Bodies that stand in the world are each placed anew in every episode."""
    while model.body_jntnum[body] == 0 and model.body_parentid[body] != 0:
        body = int(model.body_parentid[body])
    return body


def _alike(model: mujoco.MjModel, carried: dict[int, list[int]]) -> list[list[int]]:
    """Bodies of one geom each that look the same, in groups."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for body, geoms in carried.items():
        if len(geoms) == 1 and model.geom_type[geoms[0]] != mujoco.mjtGeom.mjGEOM_MESH:
            (geom,) = geoms
            place = [*model.geom_pos[geom], *model.geom_quat[geom], *model.geom_size[geom]]
            groups.setdefault((model.geom_type[geom], model.geom_matid[geom], *place), []).append(body)
    return [bodies for bodies in groups.values() if len(bodies) >= FEWEST_ALIKE]


def _joined(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    mesh = trimesh.util.concatenate(parts)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def _full_range(shares: Array, kind: type) -> NDArray:
    return np.round(shares * np.iinfo(kind).max).astype(kind)


def _weights(weight_of: Array) -> NDArray[np.uint8]:
    """Weights (V, 4) in bytes that sum to 255."""
    weights = np.round(255.0 * weight_of)
    weights[:, 0] += 255.0 - weights.sum(axis=1)
    return weights.astype(np.uint8)
