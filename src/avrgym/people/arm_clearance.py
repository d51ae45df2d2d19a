"""Clearance of a person's right arm from the rest of the body and from furniture."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.geometry.capsules import segment_box_distance, segment_distance
from avrgym.models import human
from avrgym.models.human import GEOMS, RIGHT_ARM_BODIES, SEATED_POSTURE, Z_AXIS, People, Posture
from avrgym.models.robot import FurnitureBuilder
from avrgym.models.task_frame import X_AXIS_INDEX, TaskFrame


@dataclass(frozen=True)
class Boxes:
    """B boxes in the world frame: centres (B, 3), orientations (B, 4) and half edges (B, 3)."""

    pos_w: FloatArray
    quat_w: FloatArray
    half_size_m: FloatArray

    def transform_to_frame(self, frame: TaskFrame) -> "Boxes":
        """Returns the boxes, converted from the world frame to the task's frame ``frame``."""
        return Boxes(
            frame.transform_points(self.pos_w),
            frame.transform_rotations(self.quat_w, X_AXIS_INDEX),
            self.half_size_m,
        )


CONNECTED_CAPSULE_PAIRS = frozenset({("right_upper_arm", "right_shoulder"), ("right_upper_arm", "chest")})
"""Pairs of neighbouring capsules. They overlap in every pose in which the arm hangs down."""

CHECKED_CAPSULE_PAIRS = tuple(
    (part, other)
    for part in RIGHT_ARM_BODIES
    for other in GEOMS
    if other not in RIGHT_ARM_BODIES
    if (part, other) not in CONNECTED_CAPSULE_PAIRS
)
"""Pairs of an arm capsule and another body capsule that must not touch."""

_NAMES = tuple(GEOMS)
_ARM = np.array([_NAMES.index(part) for part in RIGHT_ARM_BODIES])
_PART = np.array([_NAMES.index(part) for part, _ in CHECKED_CAPSULE_PAIRS])
_OTHER = np.array([_NAMES.index(other) for _, other in CHECKED_CAPSULE_PAIRS])


def make_furniture_boxes(furniture: Sequence[FurnitureBuilder]) -> Boxes:
    """Returns the collision boxes of furniture at its default position, world frame."""
    spec = mujoco.MjSpec()
    for add in furniture:
        add(spec, False)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    boxes = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    rotation = data.geom_xmat[boxes].reshape(-1, 3, 3)
    return Boxes(data.geom_xpos[boxes], transforms.from_matrix(rotation), model.geom_size[boxes])


def compute_person_capsules(
    people: People, posture: Posture = SEATED_POSTURE
) -> tuple[FloatArray, FloatArray]:
    """Returns the body capsules of N people, in the order of ``human.GEOMS``.

    Returns:
        Ends of the capsule axes (N, G, 2, 3) in the world frame, and radii (N, G) in metres. The axis of a sphere has
        length zero.
    """
    xp = get_namespace(people.torso_height_m)
    layout = human.compute_people_layout(people, posture)
    pos_w, q_w = human.compute_body_frames(people, posture)
    segments: list[FloatArray] = []
    for name, geom in GEOMS.items():
        reach = layout.geom_size[name][:, 1:2] * constant_like(
            np.array(geom.axis or Z_AXIS), people.torso_height_m
        )
        ends = layout.geom_pos[name][:, None] + xp.stack([-reach, reach], axis=1)
        segments.append(pos_w[geom.body][:, None] + transforms.rotate(q_w[geom.body][:, None], ends))
    radii = [layout.geom_size[name][:, 0] for name in GEOMS]
    return xp.stack(segments, axis=1), xp.stack(radii, axis=1)


def compute_arm_clearance_m(
    segments_w: FloatArray, radii_m: FloatArray, furniture: Boxes | None = None
) -> FloatArray:
    """Returns the smallest distance (N,) in metres between the right arm and the body or furniture. It is negative for
    an overlap.

    The distance stops decreasing when a capsule axis intersects another axis or a box.

    Args:
        segments_w: capsule axes (N, G, 2, 3), in the order of ``human.GEOMS``.
        radii_m: capsule radii (N, G).
        furniture: additional obstacles, or None.
    """
    xp, first, second = (
        get_namespace(segments_w),
        constant_like(_PART, segments_w),
        constant_like(_OTHER, segments_w),
    )
    part, other = segments_w[:, first], segments_w[:, second]
    apart = segment_distance(part[:, :, 0], part[:, :, 1], other[:, :, 0], other[:, :, 1])
    gap = xp.min(apart - radii_m[:, first] - radii_m[:, second], axis=1)
    if furniture is None:
        return gap
    arm = constant_like(_ARM, segments_w)
    return xp.minimum(gap, _furniture_gap(segments_w[:, arm], radii_m[:, arm], furniture))


def _furniture_gap(segments_w: FloatArray, radii_m: FloatArray, boxes: Boxes) -> FloatArray:
    begin, end = segments_w[:, :, None, 0], segments_w[:, :, None, 1]
    to_axis = segment_box_distance(boxes.pos_w, boxes.quat_w, boxes.half_size_m, begin, end)
    return get_namespace(to_axis).min(to_axis - radii_m[..., None], axis=(1, 2))
