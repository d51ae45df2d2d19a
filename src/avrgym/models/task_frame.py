"""The task's frame, for scenes that are mirrored or have another height.

The functions of a task assume one arm of the person, and the default height of seat or bed. A scene with the other arm
or another height is transformed to the task's frame. This frame is mirrored at the person's sagittal plane, and shifted
vertically. The robot is also mirrored; its joint positions do not change.
"""

from dataclasses import dataclass, replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.geometry.kinematics import Chain
from avrgym.models import human
from avrgym.models.human import JOINTS, People
from avrgym.models.human.joints import X_AXIS
from avrgym.models.robot import Mount

X_AXIS_INDEX, Y_AXIS_INDEX = 0, 1
"""Indices of the axes normal to the planes of symmetry: x of the world and of people, y of robots and most tools."""


def exchange_side_in_name(name: str) -> str:
    """Returns the name of the same joint or body part on the other side of the person."""
    side, _, part = name.partition("_")
    return {"left": "right_", "right": "left_"}[side] + part if side in ("left", "right") else name


_NAMES, _GEOMS = list(JOINTS), list(human.GEOMS)
_JOINTS = np.array([_NAMES.index(exchange_side_in_name(name)) for name in _NAMES])
_JOINT_SIGNS = np.array([1.0 if joint.axis == X_AXIS else -1.0 for joint in JOINTS.values()])
OPPOSITE_GEOM_INDICES = np.array([_GEOMS.index(exchange_side_in_name(name)) for name in _GEOMS])
"""Index of the geom on the other side of the body, for each of ``human.GEOMS``."""


@dataclass(frozen=True)
class TaskFrame:
    """A task's frame: mirrored at the person's sagittal plane (x = 0), and ``rise_m`` above the world frame.

    Mirroring is its own inverse. Methods without the argument ``to_world`` therefore transform in both directions.
    """

    is_mirrored: bool = False
    height_offset_m: float = 0.0

    def transform_points(self, pos: FloatArray, *, to_world: bool = False) -> FloatArray:
        """Transform positions (..., 3) from the world frame to the task's frame; with ``to_world`` in reverse."""
        moved = self.transform_vectors(pos)
        if self.height_offset_m:
            rise_m = self.height_offset_m if to_world else -self.height_offset_m
            moved = moved + constant_like(np.array([0.0, 0.0, rise_m]), pos)
        return moved

    def transform_vectors(self, v: FloatArray) -> FloatArray:
        """Transform vectors (..., 3) from the world frame to the task's frame, or back."""
        return v * constant_like(_signs(X_AXIS_INDEX), v) if self.is_mirrored else v

    def transform_rotations(self, q: FloatArray, axis: int) -> FloatArray:
        """Transform rotations (..., 4) of symmetric bodies from the world frame to the task's frame, or back. ``axis``
        is the normal of the body's plane of symmetry.
        """
        return mirror_rotations(q, X_AXIS_INDEX, axis) if self.is_mirrored else q

    def transform_joint_angles(self, joint_angles_rad: FloatArray) -> FloatArray:
        """Transform the joint angles (..., 20) of people from the world frame to the task's frame, or back."""
        if not self.is_mirrored:
            return joint_angles_rad
        signs = constant_like(_JOINT_SIGNS, joint_angles_rad)
        return self.exchange_joint_sides(joint_angles_rad) * signs

    def exchange_joint_sides(self, values: FloatArray, axis: int = -1) -> FloatArray:
        """Exchange the values of left and right joints, without a change of sign. The joints are along ``axis``."""
        if not self.is_mirrored:
            return values
        return get_namespace(values).take(values, constant_like(_JOINTS, values), axis=axis)

    def transform_people(self, people: People) -> People:
        """Transform people from the world frame to the task's frame, or back. In a mirrored frame, their sides are
        exchanged.
        """
        if not self.is_mirrored:
            return people
        xp, strength, torque = (
            get_namespace(people.torque_fraction),
            people.strength_share,
            people.torque_fraction,
        )
        torque = self.exchange_joint_sides(torque, axis=-2)
        reversed_axis = constant_like(_JOINT_SIGNS < 0.0, torque)[:, None]
        return replace(
            people,
            joint_angles_rad=self.transform_joint_angles(people.joint_angles_rad),
            tremor_rad=self.exchange_joint_sides(people.tremor_rad),
            strength_share=self.exchange_joint_sides(strength) if strength.ndim > 1 else strength,
            torque_fraction=xp.where(reversed_axis, xp.flip(torque, axis=-1), torque),
            damping_n_m_s=self.exchange_joint_sides(people.damping_n_m_s),
        )

    def transform_mount(self, mount: Mount) -> Mount:
        """Transform a mount from the world frame to the task's frame."""
        x, y, z = mount.pos_w
        if not self.is_mirrored:
            return replace(mount, pos_w=(x, y, z - self.height_offset_m))
        base_range = None if mount.base_range is None else mount.base_range.mirror()
        return replace(
            mount,
            pos_w=(-x, y, z - self.height_offset_m),
            yaw_rad=np.pi - mount.yaw_rad,
            base_range=base_range,
        )


WORLD_FRAME = TaskFrame()
LINK_MIRROR_FACTORS = np.array([1.0, -1.0, 1.0])
"""Factors (3,) that mirror a point in the frame of a robot's link."""


def mirror_rotations(q: FloatArray, world_axis: int, body_axis: int) -> FloatArray:
    """Returns rotations (..., 4) of bodies in a mirrored world. ``world_axis`` is the normal of the mirror plane,
    ``body_axis`` the normal of the bodies' plane of symmetry.

    With the reflections M of the world and S of the body, the rotation matrix R becomes M R S.
    """
    turned = q * constant_like(_conjugation(world_axis), q)
    if world_axis == body_axis:
        return turned
    half_turn = np.zeros(4)
    half_turn[4 - world_axis - body_axis] = 1.0
    return transforms.multiply(turned, constant_like(half_turn, q))


def mirror_chain(chain: Chain, tip_axis: int) -> Chain:
    """Returns the mirror image of a kinematic chain for the same joint positions.

    All frames except the tip's are mirrored along y. ``tip_axis`` is the normal of the tip's plane of symmetry.
    """
    slides = np.isin(np.arange(len(chain.joint_axis)), list(chain.slide_joints))[:, None]
    axis = chain.joint_axis * LINK_MIRROR_FACTORS
    return replace(
        chain,
        body_pos=chain.body_pos * LINK_MIRROR_FACTORS,
        body_quat=chain.body_quat * _conjugation(Y_AXIS_INDEX),
        joint_axis=np.where(slides, axis, -axis),
        tip_pos=chain.tip_pos * LINK_MIRROR_FACTORS,
        tip_quat=mirror_rotations(chain.tip_quat, Y_AXIS_INDEX, tip_axis),
    )


def _signs(axis: int) -> FloatArray:
    """Returns factors (3,) that mirror a vector along an axis: −1 for this axis, 1 for the others."""
    signs = np.ones(3)
    signs[axis] = -1.0
    return signs


def _conjugation(axis: int) -> FloatArray:
    """Returns factors (4,) that mirror a quaternion along an axis (rotation matrix M R M)."""
    signs = -np.ones(4)
    signs[[0, axis + 1]] = 1.0
    return signs
