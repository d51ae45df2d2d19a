"""Applies settings to a scene: other furniture, another base pose of the robot, the person's other arm."""

import inspect
import math
from dataclasses import replace
from functools import partial
from typing import Any

from avrgym.models.furniture.bed import MATTRESS_TOP_HEIGHT_M
from avrgym.models.furniture.wheelchair import SEAT_HEIGHT_M
from avrgym.models.robot import ROBOT_ARM_SIDES, Arm, FurnitureBuilder, Mount, Robot, make_robot_obstacle
from avrgym.models.scene import SceneConfig
from avrgym.models.task_frame import TaskFrame
from avrgym.robots.registry import find_robot
from avrgym.tasks.settings import Settings


def apply_scene_settings(scene: SceneConfig, settings: Settings, *, mirrored: bool) -> SceneConfig:
    """Returns the scene with the settings applied.

    ``mirrored``: the robot works on the person's other arm, from the other side. A robot with two arms uses its other
    arm.

    Raises:
        ValueError: for settings of furniture that the scene does not have.
    """
    rise_m = _rise_m(scene, settings)
    given: dict[str, Any] = {"rise_m": rise_m} if rise_m is not None else {}
    if settings.backrest_deg is not None:
        given["backrest_deg"] = settings.backrest_deg
    for name in _KEYWORDS:
        if getattr(settings, name) is not None and not has_furniture(scene, name):
            raise ValueError(f"the scene has no furniture for the setting {name}; remove this setting")
    if mirrored:
        given["mirrored"] = True
    mount = _mount(scene.mount, settings, mirrored=mirrored, rise_m=(rise_m or 0.0) * scene.posture.is_seated)
    furniture = [
        mount.carrier_builder
        if add is scene.mount.carrier_builder and mount.carrier_builder is not None
        else _with(add, given)
        for add in scene.furniture
    ]
    for number, (name, x, y, yaw_deg) in enumerate(settings.standing_by):
        furniture.append(
            make_robot_obstacle(find_robot(name), f"standing_by_{number}", (x, y), math.radians(yaw_deg))
        )
    changed = replace(
        scene,
        furniture=furniture,
        mount=mount,
        arm=_other_arm(scene.robot, scene.arm) if mirrored else scene.arm,
        control_step_s=settings.control_step_s,
        checks_reach=mirrored
        or any(getattr(settings, name) is not None for name in ("robot_pose", *_KEYWORDS)),
        body_mass_kg=settings.body_mass_kg,
        self_collision=settings.self_collision,
    )
    return _in_frame(changed, settings, TaskFrame(mirrored, rise_m or 0.0))


_KEYWORDS = {
    "table_offset_m": "offset_m", "seat_height_m": "rise_m", "bed_height_m": "rise_m", "backrest_deg": "backrest_deg"
}  # fmt: skip
"""Maps each setting of furniture to a keyword argument of the function that adds the furniture."""


def has_furniture(scene: SceneConfig, setting: str) -> bool:
    """Returns whether the scene has the furniture to which a setting applies."""
    if setting in ("seat_height_m", "bed_height_m") and scene.posture.is_seated != (
        setting == "seat_height_m"
    ):
        return False
    return any(_takes(add, _KEYWORDS[setting]) for add in scene.furniture)


def _rise_m(scene: SceneConfig, settings: Settings) -> float | None:
    """Returns the height of seat or bed above its default height; ``None`` without this setting."""
    if scene.posture.is_seated:
        return None if settings.seat_height_m is None else settings.seat_height_m - SEAT_HEIGHT_M
    return None if settings.bed_height_m is None else settings.bed_height_m - MATTRESS_TOP_HEIGHT_M


def _in_frame(scene: SceneConfig, settings: Settings, frame: TaskFrame) -> SceneConfig:
    """Returns the scene with the person's posture according to the settings. If the task's frame differs, it also has a
    ``task_scene``.
    """
    posture = scene.posture
    if settings.backrest_deg is not None:
        posture = replace(posture, hips_deg=settings.backrest_deg - 90.0, thigh_deg=-settings.backrest_deg)
    if frame == TaskFrame():
        return replace(scene, posture=posture)
    task_scene = replace(scene, posture=posture, mount=frame.transform_mount(scene.mount), task_frame=frame)
    return replace(
        scene, posture=replace(posture, height_offset_m=frame.height_offset_m), transformed_scene=task_scene
    )


def _mount(mount: Mount, settings: Settings, *, mirrored: bool, rise_m: float) -> Mount:
    """Returns the mount with the settings applied. A mount on the wheelchair rises with the seat."""
    if mirrored:
        mount = mount.mirror()
    carrier = mount.carrier_builder
    if rise_m and isinstance(carrier, partial) and "mount_m" in carrier.keywords:
        (x, y, z), (_, _, height_m) = carrier.keywords["mount_m"], mount.pos_w
        mount = replace(
            mount,
            pos_w=(*mount.pos_w[:2], height_m + rise_m),
            carrier_builder=partial(carrier, mount_m=(x, y, z + rise_m)),
        )
    if settings.robot_pose is not None:
        x, y, yaw_deg = settings.robot_pose
        mount = replace(mount, pos_w=(x, y, mount.pos_w[2]), yaw_rad=math.radians(yaw_deg), base_range=None)
    return mount


def _other_arm(robot: Robot, arm: Arm) -> Arm:
    """Returns the other arm of a robot with two arms; otherwise the same arm."""
    others = [robot.arms[side] for side in ROBOT_ARM_SIDES if side in robot.arms]
    return next((other for other in others if other.joints != arm.joints), arm)


def _takes(add: FurnitureBuilder, keyword: str) -> bool:
    return keyword in inspect.signature(add).parameters


def _with(add: FurnitureBuilder, given: dict[str, Any]) -> FurnitureBuilder:
    """Returns the furniture function ``add`` with those keyword arguments of ``given`` that it accepts."""
    taken = {name: value for name, value in given.items() if _takes(add, name)}
    return partial(add, **taken) if taken else add
