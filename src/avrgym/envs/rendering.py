"""Renders images of a world: the scene with the person's clothed body."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.models import human
from avrgym.models.cameras import add_surroundings, make_rendering_options, update_poses
from avrgym.models.human import DEVICE_TO_BODY_QUAT, HEADSET_OFFSET_M, Person
from avrgym.models.scene import build_scene_spec
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.task import CameraView

DEFAULT_IMAGE_HEIGHT_PX, DEFAULT_IMAGE_WIDTH_PX = 480, 640
"""Default height and width of rendered images of a world, in pixels."""
SHADOW_MAP_SIZE_PX = 2048
"""Width and height of the shadow map: half of MuJoCo's default, sufficient for a scene of 2 m. Without a graphics card,
a smaller map shortens rendering.
"""
EYES_CAMERA_NAME, EYES_VERTICAL_FIELD_OF_VIEW_DEG = "eyes", 96.0
"""Name and vertical field of view (degrees) of the camera at the person's eyes. The headset Quest 3 has this field of
view.
"""


class Camera:
    """Renders images of one world during one episode."""

    def __init__(
        self,
        episodes: Episodes,
        world: int,
        *,
        width_px: int = DEFAULT_IMAGE_WIDTH_PX,
        height_px: int = DEFAULT_IMAGE_HEIGHT_PX,
        first_person: bool = False,
    ) -> None:
        """Build the scene of the current episode with its visual geoms.

        The view is from the side, or with ``first_person`` from the person's eyes.

        Raises:
            RuntimeError: if rendering fails. The message contains a setting that may help.
        """
        self._episodes, self._world = episodes, world
        scene, simulation = episodes.scene, episodes.simulation
        spec = build_scene_spec(
            scene, episodes.get_person(world), moving=simulation.has_moving_people, appearance=True
        )
        add_surroundings(spec)
        _add_eyes(spec, episodes.get_person(world))
        self._model = spec.compile()
        self._model.vis.global_.offheight, self._model.vis.global_.offwidth = height_px, width_px
        self._model.vis.quality.shadowsize = SHADOW_MAP_SIZE_PX
        placed = simulation.batch.get_model(world)
        self._model.body_pos[:], self._model.body_quat[:] = placed.body_pos, placed.body_quat
        self._data = mujoco.MjData(self._model)
        self._viewpoint: mujoco.MjvCamera | str = EYES_CAMERA_NAME
        if first_person:
            _hide_head(self._model)
        else:
            self._viewpoint = _camera(episodes.task.camera_views.select_view(scene.mount))
        self._renderer = _renderer(self._model, width_px, height_px)

    def render(self) -> NDArray[np.uint8]:
        """Returns an RGB image (``height_px``, ``width_px``, 3) of the current state."""
        update_poses(self._model, self._data, self._episodes.simulation.get_qpos(self._world))
        self._renderer.update_scene(self._data, self._viewpoint, make_rendering_options())
        self._add_marks()
        return self._renderer.render()

    def _add_marks(self) -> None:
        marks, scene = self._episodes.task.markers, self._renderer.scene
        if marks is None:
            return
        for place in self._episodes.compute_marker_positions_w()[self._world]:
            mujoco.mjv_initGeom(
                scene.geoms[scene.ngeom],
                mujoco.mjtGeom.mjGEOM_SPHERE,
                np.full(3, marks.radius_m),
                place,
                np.eye(3).ravel(),
                np.array([*marks.rgb, 1.0], dtype=np.float32),
            )
            scene.ngeom += 1

    def close(self) -> None:
        """Free the graphics memory of the camera. Afterwards, ``render`` cannot be called."""
        self._renderer.close()


class Renderer:
    """Base class of environments of one world that render images. Each episode uses a new camera."""

    episodes: Episodes
    render_mode: str | None
    _camera: Camera | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Returns the attributes for copying and pickling, without the camera. A copy continues bit-identically and
        creates its own camera.
        """
        return {**self.__dict__, "_camera": None}

    def render(self) -> NDArray[np.uint8] | None:
        """Returns an image (480, 640, 3) in the render mode ``rgb_array``, else ``None``.

        Raises:
            RuntimeError: if rendering fails. The message contains a setting that may help.
        """
        if self.render_mode is None:
            return None
        if self._camera is None:
            self._camera = Camera(self.episodes, 0)
        return self._camera.render()

    def close(self) -> None:
        """Close the camera. The next call of ``render`` creates a new camera."""
        self.close_camera()

    def close_camera(self) -> None:
        """Close the camera at the end of an episode."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None


def _add_eyes(spec: mujoco.MjSpec, person: Person) -> None:
    """Add a camera at the position of the person's headset."""
    sites = human.compute_body_layout(
        np.array([person.sex == "woman"]), np.array([person.torso_height_m])
    ).site_pos
    x, y, z = sites["head_centre"][0]
    spec.body(human.PERSON_NAME_PREFIX + "head").add_camera(
        name=EYES_CAMERA_NAME,
        pos=[x, y - HEADSET_OFFSET_M, z],
        quat=DEVICE_TO_BODY_QUAT,
        fovy=EYES_VERTICAL_FIELD_OF_VIEW_DEG,
    )


def _hide_head(model: mujoco.MjModel) -> None:
    from avrgym.models.human_shape import HEAD_SKIN_PARTS
    from avrgym.tasks.camera_images import HIDDEN_GEOM_GROUP

    for part in HEAD_SKIN_PARTS:
        model.skin_group[model.skin(human.PERSON_NAME_PREFIX + part).id] = HIDDEN_GEOM_GROUP


def _camera(view: CameraView) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.lookat[:] = view.target_pos_w
    camera.distance, camera.azimuth, camera.elevation = view.distance_m, view.azimuth_deg, view.elevation_deg
    return camera


def _renderer(model: mujoco.MjModel, width_px: int, height_px: int) -> mujoco.Renderer:
    from avrgym.tasks.camera_images import check_graphics  # environments without images never import it

    check_graphics()
    return mujoco.Renderer(model, height_px, width_px)
