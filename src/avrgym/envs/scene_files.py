"""A scene with its person and robot, as an episode begins, in the files of other programs: MJB, MJCF and USD."""

import json
from dataclasses import asdict
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from avrgym.array_types import FloatArray
from avrgym.models import compliance
from avrgym.models.collision_bits import VISUAL_GROUP
from avrgym.models.colours import skin_colours, texture_mean
from avrgym.models.scene import build_spec
from avrgym.simulation.worlds import MAX_LEAD_RAD
from avrgym.system.files import write_atomically
from avrgym.tasks.episodes import Episodes

MJB, MJCF, START, USD = "scene.mjb", "scene.xml", "start.json", "scene.usdc"
OF_THE_EPISODE = ("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia")
"""What an episode sets in a compiled model, and MJCF can say. It cannot say ``body_invweight0``."""
START_KEY = "start"


def write_scene(episodes: Episodes, out: Path) -> None:
    """Write the first world, whose episode has just begun, into a new folder: MJB, MJCF with textures, and its start.

    The MJB steps to the same bits and holds no looks. The MJCF holds both, its numbers with six digits, but compiles to
    a person who gives way less where they are pressed: ``body_invweight0``, which is raised for them, is no part of it.

    Raises:
        FileExistsError: where there is something of that name.
    """
    check_new_folder(out)
    out.mkdir(parents=True)
    simulation = episodes.simulation
    mujoco.mj_saveModel(simulation.batch.get_model(0), str(out / MJB), None)
    spec = _spec(episodes)
    _embed_meshes(spec)
    _write_textures(spec, out)
    write_atomically(out / MJCF, spec.to_xml().encode())
    start = {
        "environment": episodes.environment_id,
        "person": {name: _plain(value) for name, value in asdict(episodes.person_in(0)).items()},
        "integration_state": simulation.integration_state().tolist(),
        "versions": {name: version(name) for name in ("avrgym", "mujoco")},
    }
    write_atomically(out / START, json.dumps(start, indent=1).encode())


def check_new_folder(out: Path) -> None:
    """Raise ``FileExistsError`` where something would be overwritten."""
    if out.exists():
        raise FileExistsError(f"{out} exists; scenes go into a new folder")


def write_usd(episodes: Episodes, file: Path) -> None:
    """Write how the first world looks now; the person's skin is a mesh that stands still.

    Raises:
        ModuleNotFoundError: without usd-core.
    """
    exporters: Any = import_module("mujoco.usd.exporter")
    usd_geom: Any = import_module("pxr.UsdGeom")

    spec = _spec(episodes)
    model = spec.compile()
    _freeze_skins(spec, model, _at_start(model, episodes))
    model = spec.compile()
    with TemporaryDirectory() as folder:
        exporter = exporters.USDExporter(model, output_directory_root=folder, verbose=False)
        exporter.update_scene(_at_start(model, episodes), scene_option=_visible())
        usd_geom.SetStageMetersPerUnit(exporter.stage, 1.0)
        exporter.stage.Export(str(file))


def _spec(episodes: Episodes) -> mujoco.MjSpec:
    """The scene of the first world with its looks, and where the episode put things."""
    scene, simulation = episodes.scene, episodes.simulation
    spec = build_spec(scene, episodes.person_in(0), moving=simulation.moving, appearance=True)
    compliance.limit_contact_forces(spec, scene.arm, scene.tool, MAX_LEAD_RAD)
    model, placed = spec.compile(), simulation.batch.get_model(0)
    for field in OF_THE_EPISODE:
        getattr(model, field)[:] = getattr(placed, field)
    spec.copy_back(model)
    data = _at_start(model, episodes)
    spec.add_key(name=START_KEY, qpos=data.qpos, act=data.act, ctrl=data.ctrl)
    return spec


def _at_start(model: mujoco.MjModel, episodes: Episodes) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_setState(
        model, data, episodes.simulation.integration_state(), mujoco.mjtState.mjSTATE_INTEGRATION
    )
    mujoco.mj_forward(model, data)
    return data


def _write_textures(spec: mujoco.MjSpec, out: Path) -> None:
    spec.modelfiledir = str(out)
    for texture in spec.textures:
        if len(texture.data):
            size, mode = (texture.width, texture.height), "RGB" if texture.nchannel == 3 else "RGBA"
            texture.file = f"{texture.name.replace('/', '_')}.png"
            Image.frombytes(mode, size, bytes(texture.data)).save(out / texture.file)
            texture.data, texture.content_type = b"", "image/png"


def _embed_meshes(spec: mujoco.MjSpec) -> None:
    """Let the MJCF hold the vertices of meshes that were read from files, as it holds all others'."""
    model = spec.compile()
    for mesh in spec.meshes:
        if mesh.file:
            vertices, faces = _as_read(model, model.mesh(mesh.name).id)
            mesh.file, mesh.scale = "", np.ones(3)
            mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()


def _as_read(model: mujoco.MjModel, mesh: int) -> tuple[FloatArray, NDArray[np.int32]]:
    """Vertices and faces of a mesh in its file's frame: MuJoCo moves them into that of the mesh's inertia."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[mesh])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[first : first + count] @ turn.reshape(3, 3).T + model.mesh_pos[mesh]
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return vertices, model.mesh_face[first : first + count]


def _freeze_skins(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Put in place of skins, which USD's exporter leaves out, meshes of one colour as the skins are at present."""
    scene = mujoco.MjvScene(model, maxgeom=10_000)
    mujoco.mjv_updateScene(
        model, data, _visible(), None, mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    colours = skin_colours(model)
    for skin in spec.skins:
        number = model.skin(skin.name).id
        shade = np.append(texture_mean(model, int(model.skin_matid[number])), 1.0)
        first, count = model.skin_vertadr[number], model.skin_vertnum[number]
        vertices = scene.skinvert.reshape(-1, 3)[first : first + count]
        first, count = model.skin_faceadr[number], model.skin_facenum[number]
        faces = model.skin_face[first : first + count]
        spec.add_mesh(
            name=skin.name,
            uservert=vertices.ravel(),
            userface=faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=skin.name,
            name=skin.name,
            rgba=colours[number] * shade,
            group=VISUAL_GROUP,
            contype=0,
            conaffinity=0,
        )
    for skin in list(spec.skins):
        spec.delete(skin)


def _visible() -> mujoco.MjvOption:
    option = mujoco.MjvOption()
    option.geomgroup[:], option.sitegroup[:] = 0, 0
    option.geomgroup[VISUAL_GROUP] = 1
    return option


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value
