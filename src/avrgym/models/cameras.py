"""Cameras of a scene: their poses, and the size and type of their images.

Every scene has two cameras. The camera ``wrist`` is fixed to the hand, above the grip, and points along the tool. The
camera ``scene`` shows person and robot from the side. A robot may have further cameras, see
``models.robot.Robot.cameras``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import msgspec
import mujoco
import numpy as np

from avrgym.array_types import FloatArray, NumpyArray
from avrgym.geometry import transforms
from avrgym.models import robot
from avrgym.models.collision_bits import VISUAL_GROUP
from avrgym.models.scene import SCENE_TOOL_BODY, SceneConfig

WRIST_CAMERA, SCENE_CAMERA = "wrist", "scene"
ImageKind = Literal["rgb", "depth", "segmentation"]
IMAGE_KINDS: tuple[ImageKind, ...] = get_args(ImageKind)
MIN_IMAGE_SIZE_PX, MAX_IMAGE_SIZE_PX = (64, 64), (640, 480)
"""Minimum and maximum of the width and the height of an image, in pixels."""
MAX_IMAGE_DEPTH_M = 10.0
"""Maximum depth in depth images. Farther surfaces and the sky have this depth."""
SEGMENTATION_LABELS = ("background", "person", "robot", "tool", "particles", "furniture")
"""Labels of a segmentation image; the index of a label is its pixel value. A garment has the label ``tool``; floor and
sky are background.
"""
STATE_ENTRY, COMMAND_ENTRY = "state", "command"
"""Keys of dictionary observations for the numbers of the observation, and for the participant's latest command."""
AnyObservation = FloatArray | dict[str, NumpyArray]
"""An observation (O,). With cameras: a dictionary of ``state`` (O,) and images, see
``CameraSpec.list_image_formats``.
"""
SCENE_CAMERA_FOVY_DEG = 45.0
"""Vertical field of view of the camera ``scene``, in degrees."""
WRIST_CAMERA_FOVY_DEG = 58.0
"""Vertical field of view of the wrist camera, as of an Intel RealSense D435 (data sheet: 87° × 58°)."""
WRIST_CAMERA_OFFSET_M = np.array([-0.05, 0.0, 0.10])
"""Position of the wrist camera relative to the tool's grip, in the tool's frame: behind the grip and above the
fingers."""
WRIST_CAMERA_TARGET_M = np.array([0.40, 0.0, 0.0])
"""Point on the optical axis of the wrist camera, in the tool's frame: in front of the tool centre point."""
_FLOOR_RGBA = [0.72, 0.71, 0.68, 1.0]


ImageDtype = np.uint8 | np.float32 | np.int32


class CameraSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A camera that adds images to observations.

    Attributes:
        name: ``wrist``, ``scene``, or another camera of the robot.
        width_px, height_px: size of its images, 64 × 64 to 640 × 480.
        kinds: one or more of ``rgb`` (H, W, 3) uint8, ``depth`` (H, W) float32, and ``segmentation`` (H, W) int32.
            Depth is in metres along the optical axis, at most ``MAX_IMAGE_DEPTH_M``. ``SEGMENTATION_LABELS`` lists the
            labels of segmentations.
        fovy_deg: vertical field of view in degrees; by default that of the camera in the scene.

    Raises:
        ValueError: for a value that is not allowed.
    """

    name: str
    width_px: int = 64
    height_px: int = 64
    kinds: tuple[ImageKind, ...] = ("rgb",)
    fovy_deg: float | None = None

    def __post_init__(self) -> None:
        for what, size, low, high in (
            ("width_px", self.width_px, MIN_IMAGE_SIZE_PX[0], MAX_IMAGE_SIZE_PX[0]),
            ("height_px", self.height_px, MIN_IMAGE_SIZE_PX[1], MAX_IMAGE_SIZE_PX[1]),
        ):
            if type(size) is not int or not low <= size <= high:
                raise ValueError(f"{what} of camera {self.name!r} is {size!r}; allowed: {low} to {high}")
        kinds = tuple(self.kinds)
        if not kinds or len({*kinds}) < len(kinds) or not {*kinds} <= {*IMAGE_KINDS}:
            raise ValueError(
                f"kinds of camera {self.name!r} are {kinds!r}; allowed: one or more of {', '.join(IMAGE_KINDS)}"
            )
        msgspec.structs.force_setattr(self, "kinds", kinds)
        if self.fovy_deg is not None and not 5.0 <= self.fovy_deg <= 150.0:
            raise ValueError(f"fovy_deg of camera {self.name!r} is {self.fovy_deg!r}; allowed: 5 to 150")

    def list_image_formats(self) -> dict[str, tuple[tuple[int, ...], type[ImageDtype], float]]:
        """Returns shape, type and largest value of each image, by the name of the image's entry, such as
        ``wrist_rgb``."""
        size = (self.height_px, self.width_px)
        format_of_kind: dict[ImageKind, tuple[tuple[int, ...], type[ImageDtype], float]] = {
            "rgb": ((*size, 3), np.uint8, 255),
            "depth": (size, np.float32, MAX_IMAGE_DEPTH_M),
            "segmentation": (size, np.int32, len(SEGMENTATION_LABELS) - 1),
        }
        return {f"{self.name}_{kind}": format_of_kind[kind] for kind in self.kinds}


CameraDescription = CameraSpec | str | Mapping[str, Any]
"""A description of a camera: a ``CameraSpec``, its fields, its name, or a text such as ``wrist:128x96:rgb+depth``."""


def parse_cameras(cameras: Iterable[CameraDescription], scene_robot: robot.Robot) -> tuple[CameraSpec, ...]:
    """Convert descriptions of cameras to ``CameraSpec`` records, and check them for a robot. Returns the records.

    Raises:
        ValueError: for a camera that the robot does not have, two cameras with the same name, or an invalid
            field. The message lists the allowed values.
    """
    if isinstance(cameras, str | CameraSpec | Mapping):
        raise ValueError(f"cameras is {cameras!r}; allowed: a list of camera names, such as ['wrist']")
    found = tuple(_as_camera(each) for each in cameras)
    allowed = (WRIST_CAMERA, SCENE_CAMERA, *scene_robot.cameras)
    for each in found:
        if each.name not in allowed:
            raise ValueError(
                f"unknown camera {each.name!r} of robot {scene_robot.name}; allowed: {', '.join(allowed)}"
            )
    names = [each.name for each in found]
    if len({*names}) < len(names):
        raise ValueError(
            f"cameras are {', '.join(names)}; allowed: each camera once, with all its kinds of images"
        )
    return found


def _as_camera(camera: CameraDescription) -> CameraSpec:
    if isinstance(camera, CameraSpec):
        return camera
    try:
        if isinstance(camera, str):
            return parse_camera(camera)
        return msgspec.convert(dict(camera), CameraSpec)
    except (msgspec.ValidationError, TypeError) as error:
        raise ValueError(
            f"camera {camera!r} is invalid: {error}; allowed: a text such as 'wrist:128x96:rgb+depth', or the fields "
            f"{', '.join(CameraSpec.__struct_fields__)}"
        ) from error


def parse_camera(text: str) -> CameraSpec:
    """Returns the camera for a text with name, size and kinds of images, such as ``wrist:128x96:rgb+depth``.

    Raises:
        ValueError: for a text with another format.
    """
    name, *rest = text.split(":")
    size, kinds = (*rest, "", "")[:2]
    width, _, height = (size or "64x64").partition("x")
    if len(rest) > 2 or not (width.isdecimal() and height.isdecimal()):
        raise ValueError(
            f"the camera is {text!r}; allowed: NAME, NAME:WIDTHxHEIGHT or NAME:WIDTHxHEIGHT:KINDS, such as "
            "wrist:128x96:rgb+depth"
        )
    chosen: Any = tuple(kinds.split("+")) if kinds else ("rgb",)
    return CameraSpec(name, int(width), int(height), chosen)


def list_image_formats(
    cameras: Iterable[CameraSpec],
) -> dict[str, tuple[tuple[int, ...], type[ImageDtype], float]]:
    """Returns shape, type and largest value of each image of these cameras, by the name of the image's entry."""
    return {name: entry for camera in cameras for name, entry in camera.list_image_formats().items()}


@dataclass(frozen=True)
class SceneCameraPose:
    """Pose of the camera ``scene``: its position and a point on its optical axis, (3,) each, world frame, metres."""

    pos_w: FloatArray
    target_pos_w: FloatArray


def add_cameras(
    spec: mujoco.MjSpec, scene: SceneConfig, view: SceneCameraPose, cameras: Sequence[CameraSpec]
) -> None:
    """Add cameras to the model of a scene. ``view`` is the pose of the camera ``scene``."""
    for camera in cameras:
        if camera.name == SCENE_CAMERA:
            body, pos, fovy_deg = spec.worldbody, view.pos_w, SCENE_CAMERA_FOVY_DEG
            q = compute_camera_rotation(view.target_pos_w - view.pos_w, [0.0, 0.0, 1.0])
        elif camera.name == WRIST_CAMERA:
            add_wrist_camera(spec, scene, camera.fovy_deg)
            continue
        else:
            mount = scene.robot.cameras[camera.name]
            body, pos, fovy_deg = spec.body(robot.ROBOT_NAME_PREFIX + mount.body), mount.pos_m, mount.fovy_deg
            q = compute_camera_rotation(mount.forward, mount.up)
        body.add_camera(name=camera.name, pos=pos, quat=q, fovy=camera.fovy_deg or fovy_deg)


def add_wrist_camera(spec: mujoco.MjSpec, scene: SceneConfig, fovy_deg: float | None = None) -> None:
    """Add the wrist camera to the model of a scene. ``fovy_deg`` is the vertical field of view in degrees, by default
    ``WRIST_CAMERA_FOVY_DEG``.
    """
    pos = scene.tool.grip_pos + WRIST_CAMERA_OFFSET_M
    spec.body(SCENE_TOOL_BODY).add_camera(
        name=WRIST_CAMERA,
        pos=pos,
        quat=compute_camera_rotation(WRIST_CAMERA_TARGET_M - pos, [0.0, 0.0, 1.0]),
        fovy=fovy_deg or WRIST_CAMERA_FOVY_DEG,
    )


def compute_camera_rotation(
    forward: Sequence[float] | FloatArray, up: Sequence[float] | FloatArray
) -> FloatArray:
    """Returns the rotation (4,) of a camera with the viewing direction ``forward``.

    The camera's axes are those of MuJoCo: −z forward, y up, x right.
    """
    back = -np.asarray(forward, float) / np.linalg.norm(forward)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return transforms.from_matrix(np.stack([right, np.cross(back, right), back], axis=-1))


def add_surroundings(spec: mujoco.MjSpec) -> None:
    """Add a visible floor and sky, and light from above and in front of the person."""
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[20.0, 20.0, 0.1], rgba=_FLOOR_RGBA,
        group=VISUAL_GROUP, contype=0, conaffinity=0,
    )  # fmt: skip
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0.4, -2.6, 3.2], dir=[-0.15, 0.7, -1.0],
        diffuse=[0.6] * 3, specular=[0.2] * 3, castshadow=True,
    )  # fmt: skip
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.35] * 3, [0.35] * 3
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.86, 0.89, 0.92], rgb2=[0.62, 0.66, 0.70], width=64, height=384,
    )  # fmt: skip


def update_poses(model: mujoco.MjModel, data: mujoco.MjData, qpos: FloatArray) -> None:
    """Compute the poses of all bodies, geoms and cloth vertices for rendering, from joint positions (nq,)."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    mujoco.mj_camlight(model, data)


def make_rendering_options() -> mujoco.MjvOption:
    """Returns MuJoCo's rendering options for images with visual geoms and without collision geoms."""
    option = mujoco.MjvOption()
    option.geomgroup[:] = 0
    option.geomgroup[VISUAL_GROUP] = 1
    option.sitegroup[:] = 0
    return option
