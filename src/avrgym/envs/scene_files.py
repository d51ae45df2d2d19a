"""Exports the initial state of an episode (scene, person and robot) to MJB, MJCF and USD."""

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
from avrgym.models.colours import compute_mean_texture_colour, compute_skin_colours
from avrgym.models.scene import build_scene_spec
from avrgym.simulation.worlds import MAX_SERVO_LEAD_RAD
from avrgym.system.files import write_atomically
from avrgym.tasks.episodes import Episodes

MJB_FILE, MJCF_FILE, INITIAL_STATE_FILE, USD_FILE = "scene.mjb", "scene.xml", "start.json", "scene.usdc"
"""Names of the exported scene files."""
EPISODE_MODEL_FIELDS = ("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia")
"""Model fields that an episode sets and MJCF can store. MJCF cannot store ``body_invweight0``."""
INITIAL_STATE_KEYFRAME = "start"
"""Name of the MJCF keyframe with the initial state of the episode."""


def write_scene(episodes: Episodes, out: Path) -> None:
    """Write the scene of the first world at the start of its episode into a new folder.

    The files are ``MJB_FILE``, ``MJCF_FILE`` with textures, and ``INITIAL_STATE_FILE`` (JSON). ``INITIAL_STATE_FILE``
    contains the environment id, the person, the initial simulation state and the program versions. ``MJB_FILE``
    reproduces the simulation bit for bit, but contains no visual geoms. ``MJCF_FILE`` contains dynamics and
    appearance, with six significant digits. In MJCF the person is less compliant, because MJCF cannot store the
    person's higher ``body_invweight0``.

    Raises:
        FileExistsError: if the folder exists.
    """
    check_new_folder(out)
    out.mkdir(parents=True)
    simulation = episodes.simulation
    mujoco.mj_saveModel(simulation.batch.get_model(0), str(out / MJB_FILE), None)
    spec = _spec(episodes)
    _embed_meshes(spec)
    _write_textures(spec, out)
    write_atomically(out / MJCF_FILE, spec.to_xml().encode())
    start = {
        "environment": episodes.environment_id,
        "person": {name: _plain(value) for name, value in asdict(episodes.get_person(0)).items()},
        "integration_state": simulation.get_integration_state().tolist(),
        "versions": {name: version(name) for name in ("avrgym", "mujoco")},
    }
    write_atomically(out / INITIAL_STATE_FILE, json.dumps(start, indent=1).encode())


def check_new_folder(out: Path) -> None:
    """Raises ``FileExistsError`` if the output folder ``out`` exists."""
    if out.exists():
        raise FileExistsError(f"folder {out} already exists; choose a new folder")


def write_usd(episodes: Episodes, file: Path) -> None:
    """Write the current appearance of the first world as USD. The person's skin becomes a static mesh.

    Raises:
        ModuleNotFoundError: if the package usd-core is not installed.
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
    """Returns the scene of the first world with its appearance and with the episode's values of
    ``EPISODE_MODEL_FIELDS``.
    """
    scene, simulation = episodes.scene, episodes.simulation
    spec = build_scene_spec(
        scene, episodes.get_person(0), moving=simulation.has_moving_people, appearance=True
    )
    compliance.limit_contact_forces(spec, scene.arm, scene.tool, MAX_SERVO_LEAD_RAD)
    model, placed = spec.compile(), simulation.batch.get_model(0)
    for field in EPISODE_MODEL_FIELDS:
        getattr(model, field)[:] = getattr(placed, field)
    spec.copy_back(model)
    data = _at_start(model, episodes)
    spec.add_key(name=INITIAL_STATE_KEYFRAME, qpos=data.qpos, act=data.act, ctrl=data.ctrl)
    return spec


def _at_start(model: mujoco.MjModel, episodes: Episodes) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_setState(
        model, data, episodes.simulation.get_integration_state(), mujoco.mjtState.mjSTATE_INTEGRATION
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
    """Embed the vertices and faces of mesh files in ``spec``, so the MJCF file needs no mesh files."""
    model = spec.compile()
    for mesh in spec.meshes:
        if mesh.file:
            vertices, faces = _as_read(model, model.mesh(mesh.name).id)
            mesh.file, mesh.scale = "", np.ones(3)
            mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()


def _as_read(model: mujoco.MjModel, mesh: int) -> tuple[FloatArray, NDArray[np.int32]]:
    """Returns vertices and faces of a mesh in the frame of its file. MuJoCo stores them in the frame of the mesh's
    inertia."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[mesh])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[first : first + count] @ turn.reshape(3, 3).T + model.mesh_pos[mesh]
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return vertices, model.mesh_face[first : first + count]


def _freeze_skins(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Replace each skin by a mesh of one colour with the skin's current shape. The USD exporter omits skins."""
    scene = mujoco.MjvScene(model, maxgeom=10_000)
    mujoco.mjv_updateScene(
        model, data, _visible(), None, mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    colours = compute_skin_colours(model)
    for skin in spec.skins:
        number = model.skin(skin.name).id
        shade = np.append(compute_mean_texture_colour(model, int(model.skin_matid[number])), 1.0)
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
