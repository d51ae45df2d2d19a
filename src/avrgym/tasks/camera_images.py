"""Renders camera images of the worlds of ``Episodes``, with MuJoCo's renderer.

All worlds share one model for each sex. Before a world is rendered, its person and positions are copied to the model.
Physics has its own model without visual geometry.
"""

import warnings
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from functools import cache
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import BoolArray, IntArray, NumpyArray
from avrgym.models import human, robot
from avrgym.models.cameras import (
    MAX_IMAGE_DEPTH_M,
    SEGMENTATION_LABELS,
    CameraSpec,
    ImageKind,
    SceneCameraPose,
    add_cameras,
    add_surroundings,
    list_image_formats,
    make_rendering_options,
    update_poses,
)
from avrgym.models.human import Person
from avrgym.models.human_shape import add_person_skins
from avrgym.models.scene import SCENE_TOOL_BODY, build_scene_spec
from avrgym.system.mujoco_setup import RENDERING_HINT

if TYPE_CHECKING:
    from avrgym.tasks.episodes import Episodes

NEAR_CLIP_M, FAR_CLIP_M = 0.02, 20.0
"""Minimum and maximum rendered distance from the camera.

Shadows are not rendered, because they are slow without a graphics card.
"""
_BACKGROUND, _PERSON, _ROBOT, _TOOL, _PARTICLES, _FURNITURE = range(len(SEGMENTATION_LABELS))
HIDDEN_GEOM_GROUP = 5
Images = dict[str, NumpyArray]
"""Images by key of the observation dictionary, such as ``wrist_rgb``."""
PersonAppearanceKey = tuple[str, float, float, str, float | None, float | None]


class CameraImageRenderer:
    """Renders the cameras of N worlds. The first image creates the graphics context.

    Any thread may then render images, one thread at a time.
    """

    def __init__(self, episodes: "Episodes", cameras: Sequence[CameraSpec]) -> None:
        """Store the worlds and their cameras, a result of ``models.cameras.parse_cameras``."""
        self._context: Any = None
        self.cameras = tuple(cameras)
        self._episodes = episodes
        self._models: dict[str, _SexModel] = {}

    def render_images(self, worlds: Iterable[int] | None = None) -> Images:
        """Returns images (n, ...) of the current state of ``worlds`` (default: all), by entry name.

        ``CameraSpec`` defines their types.

        Raises:
            RuntimeError: if rendering fails. The message contains a setting that may help.
        """
        chosen = [*range(self._episodes.simulation.num_worlds)] if worlds is None else [*worlds]
        found = {
            name: np.empty((len(chosen), *shape), dtype)
            for name, (shape, dtype, _) in list_image_formats(self.cameras).items()
        }
        with self._graphics():
            for row, world in enumerate(chosen):
                person = self._episodes.get_person(world)
                model = self._model_of(person)
                model.show(self._episodes, world, person)
                for camera in self.cameras:
                    model.render(camera, {kind: found[f"{camera.name}_{kind}"][row] for kind in camera.kinds})
        return found

    def close(self) -> None:
        """Free the graphics memory. The next call of ``render_images`` allocates it again."""
        if self._context is not None:
            with self._context.as_current():
                for model in self._models.values():
                    model.free()
            self._models.clear()
            self._context.free()
            self._context = None

    def __del__(self) -> None:
        """Free the graphics memory when the object is deleted."""
        self.close()

    def _graphics(self) -> AbstractContextManager[None]:
        """Returns a context manager that makes the graphics context current. The first call creates the context."""
        if self._context is None:
            check_graphics()
            self._context = _owned_context()(*self._size_px)
        return self._context.as_current()

    @property
    def _size_px(self) -> tuple[int, int]:
        """Largest width and largest height of all images."""
        return max(each.width_px for each in self.cameras), max(each.height_px for each in self.cameras)

    def _model_of(self, person: Person) -> "_SexModel":
        if person.sex not in self._models:
            self._models[person.sex] = _SexModel(self._episodes, person, self.cameras, self._size_px)
        return self._models[person.sex]


class _SexModel:
    """The model of the scene with a woman or a man, in graphics memory. It contains the state of one world at a
    time."""

    def __init__(
        self,
        episodes: "Episodes",
        person: Person,
        cameras: Sequence[CameraSpec],
        size_px: tuple[int, int],
    ) -> None:
        scene = episodes.scene
        spec = build_scene_spec(scene, person, moving=episodes.simulation.has_moving_people, appearance=True)
        add_surroundings(spec)
        view = episodes.task.camera_views.select_view(scene.mount)
        add_cameras(spec, scene, SceneCameraPose(view.camera_pos_w, np.array(view.target_pos_w)), cameras)
        self.model = model = spec.compile()
        self._data = mujoco.MjData(model)
        model.vis.global_.offwidth, model.vis.global_.offheight = size_px
        model.vis.map.znear, model.vis.map.zfar = (
            NEAR_CLIP_M / model.stat.extent,
            FAR_CLIP_M / model.stat.extent,
        )
        self._groups = model.geom_group.copy()
        self._option = make_rendering_options()
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nskin + 100)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._labels = _labels(model, episodes)
        self._shown: PersonAppearanceKey | None = None
        self._people: dict[PersonAppearanceKey, dict[str, NumpyArray]] = {}
        self._skins = _skin_rows(model)

    def show(self, episodes: "Episodes", world: int, person: Person) -> None:
        """Copies the person and the body poses of a world to this model."""
        build = person.stature_m, person.bmi_kg_m2
        key = (person.sex, person.torso_height_m, person.arm_scale, person.skin_tone, *build)
        if key != self._shown:
            self._set_person(key, person, episodes)
        model, batch = self.model, episodes.simulation.batch
        model.body_pos[:] = batch.expand("body_pos")[world]
        model.body_quat[:] = batch.expand("body_quat")[world]
        update_poses(model, self._data, episodes.simulation.get_qpos(world))

    def _set_person(self, key: PersonAppearanceKey, person: Person, episodes: "Episodes") -> None:
        """Set the body size and the skin tone of the person in this model."""
        if key not in self._people:
            if len(self._people) > episodes.simulation.num_worlds:
                self._people.clear()
            self._people[key] = _person_skins(person, episodes)
        for name, array in self._people[key].items():
            rows = self._skins["mat_rgba" if name == "mat_rgba" else _axis(name)]
            getattr(self.model, name)[rows] = array
        self._shown = key

    def render(self, camera: CameraSpec, out: dict[ImageKind, NumpyArray]) -> None:
        """Render a camera's images into the arrays ``out``, by kind of image."""
        model, scene = self.model, self._scene
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(camera.name).id
        model.geom_group[:] = np.where(
            self._outside(camera, view.fixedcamid), HIDDEN_GEOM_GROUP, self._groups
        )
        mujoco.mjv_updateScene(model, self._data, self._option, None, view, mujoco.mjtCatBit.mjCAT_ALL, scene)
        mujoco.mjr_setBuffer(
            mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context
        )  # both models use this buffer
        rect = mujoco.MjrRect(0, 0, camera.width_px, camera.height_px)
        colours = np.empty((camera.height_px, camera.width_px, 3), np.uint8)
        depth = np.empty((camera.height_px, camera.width_px), np.float32)
        if "rgb" in out:
            mujoco.mjr_render(rect, scene, self._context)
            mujoco.mjr_readPixels(colours, None, rect, self._context)
            out["rgb"][:] = colours[::-1]
        if "depth" in out or "segmentation" in out:
            flags = scene.flags.copy()
            scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
            mujoco.mjr_render(rect, scene, self._context)
            mujoco.mjr_readPixels(colours, depth, rect, self._context)
            scene.flags[:] = flags
        if "depth" in out:
            out["depth"][:] = _metres(depth)[::-1]
        if "segmentation" in out:
            out["segmentation"][:] = self._segmented(colours)[::-1]

    def _outside(self, camera: CameraSpec, number: int) -> BoolArray:
        """Returns a boolean mask of geoms that are completely outside of an image.

        Rendering without these geoms is faster.
        """
        model, data = self.model, self._data
        pos = (data.geom_xpos - data.cam_xpos[number]) @ data.cam_xmat[number].reshape(3, 3)
        radius, ahead = model.geom_rbound, -pos[:, 2]
        half_height = np.tan(0.5 * np.radians(model.cam_fovy[number]))
        beyond = ahead + radius < NEAR_CLIP_M
        for axis, half in ((0, half_height * camera.width_px / camera.height_px), (1, half_height)):
            beyond |= np.abs(pos[:, axis]) - half * ahead > radius * np.hypot(1.0, half)
        return beyond & (radius > 0.0)

    def _segmented(self, colours: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Returns labels (H, W) for the object numbers that the renderer encodes as colours; 0 is the background."""
        number = colours.astype(np.int32) @ np.array([1, 256, 65536], np.int32)
        label = np.zeros(self._scene.ngeom + 1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0:
                label[geom.segid + 1] = self._labels.get((geom.objtype, geom.objid), _BACKGROUND)
        return label[number]

    def free(self) -> None:
        """Free the graphics memory; the context must be current."""
        self._context.free()


@cache
def _owned_context() -> Any:
    """Returns a class of graphics contexts that only ``CameraImageRenderer.close`` frees.

    Otherwise, garbage collection could free a context before the memory of its models.
    """

    def ignore(context: Any) -> None:
        """Does nothing. ``CameraImageRenderer.close`` frees the context."""

    return type("_OwnedContext", (mujoco.GLContext,), {"__del__": ignore})


def check_graphics() -> None:
    """Raises ``RuntimeError`` if nothing can be rendered. The message contains a setting that may help."""
    error = find_rendering_error()
    if error is not None:
        raise RuntimeError(f"rendering failed: {RENDERING_HINT}; {error}")


@cache
def find_rendering_error() -> str | None:
    """Returns the error message of a rendering test, or ``None`` if rendering works.

    The result is cached: a second attempt without a graphics library ends the process.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mujoco.Renderer(mujoco.MjSpec().compile(), 1, 1).close()
    except Exception as error:  # each graphics library raises its own exceptions
        return f"{type(error).__name__}: {error}"
    return None


def _metres(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns distances along the optical axis in metres, computed from the renderer's depth values.

    The depth is 0 at ``FAR_CLIP_M`` and 1 at ``NEAR_CLIP_M``.
    """
    share = depth.astype(np.float64)
    metres = NEAR_CLIP_M * FAR_CLIP_M / (NEAR_CLIP_M + share * (FAR_CLIP_M - NEAR_CLIP_M))
    return np.minimum(metres, MAX_IMAGE_DEPTH_M).astype(np.float32)


def _labels(model: mujoco.MjModel, episodes: "Episodes") -> dict[tuple[int, int], int]:
    """Returns the label of each geom, skin and flex, by type and number of the object."""
    particles = episodes.scene.tool.particles
    grains = () if particles is None else particles.bodies
    tool = model.body(SCENE_TOOL_BODY).id
    labels: list[int] = []
    for body in range(model.nbody):
        name, parent = model.body(body).name, model.body_parentid[body]
        if body == tool or (body and labels[parent] == _TOOL):
            labels.append(_TOOL)
        elif name.startswith(robot.ROBOT_NAME_PREFIX):
            labels.append(_ROBOT)
        elif name.startswith(human.PERSON_NAME_PREFIX):
            labels.append(_PERSON)
        else:
            labels.append(_PARTICLES if name in grains else _FURNITURE if body else _BACKGROUND)
    geoms, skins = mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_SKIN
    body_of_geom: list[int] = model.geom_bodyid.tolist()
    body_of_skin: list[int] = model.skin_bonebodyid[model.skin_boneadr].tolist()
    found = {(int(geoms), geom): labels[body] for geom, body in enumerate(body_of_geom)}
    found |= {(int(skins), skin): labels[body] for skin, body in enumerate(body_of_skin)}
    return found | {(int(mujoco.mjtObj.mjOBJ_FLEX), flex): _TOOL for flex in range(model.nflex)}


SKIN_MODEL_FIELDS = ("skin_vert", "skin_bonebindpos", "skin_bonebindquat")


def _axis(name: str) -> str:
    return "vertices" if name == "skin_vert" else "bones"


def _skin_rows(model: mujoco.MjModel) -> dict[str, IntArray]:
    """Returns the rows of vertices, bones and materials of the person's skins, in the order of the skins' names."""
    names = sorted(
        model.skin(i).name
        for i in range(model.nskin)
        if model.skin(i).name.startswith(human.PERSON_NAME_PREFIX)
    )
    ids = [model.skin(name).id for name in names]
    return {
        "vertices": _ranges(model.skin_vertadr[ids], model.skin_vertnum[ids]),
        "bones": _ranges(model.skin_boneadr[ids], model.skin_bonenum[ids]),
        "mat_rgba": model.skin_matid[ids].astype(np.intp),
    }


def _ranges(first: NumpyArray, count: NumpyArray) -> IntArray:
    bounds: list[tuple[int, int]] = [*zip(first.tolist(), (first + count).tolist(), strict=True)]
    return np.concatenate([np.arange(start, end) for start, end in bounds])


def _person_skins(person: Person, episodes: "Episodes") -> dict[str, NumpyArray]:
    """Returns the model fields of a person's skins, in the order of ``_skin_rows``."""
    scene = episodes.scene
    spec = mujoco.MjSpec()
    human.add_person(spec, person, scene.posture, moving=episodes.simulation.has_moving_people)
    add_person_skins(spec, person, scene.posture, open_mouth=scene.tool.particles is not None)
    model = spec.compile()
    rows = _skin_rows(model)
    return {name: getattr(model, name)[rows[_axis(name)]] for name in SKIN_MODEL_FIELDS} | {
        "mat_rgba": model.mat_rgba[rows["mat_rgba"]]
    }
