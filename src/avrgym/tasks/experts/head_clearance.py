"""Computes directions and shifts for an approach to the head without contact."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.human import GEOMS
from avrgym.simulation.worlds import State

HEAD_GEOM_INDICES = [list(GEOMS).index(name) for name in ("jaw", "cranium")]


def compute_direction_into_face_w(state: State) -> FloatArray:
    """Returns the horizontal direction (N, 3) from the front into the face, in the world frame."""
    into = transforms.rotate(state.head_quat_w, [0.0, 1.0, 0.0])
    return transforms.normalize(into * [1.0, 1.0, 0.0])


def compute_clearance_shift_m(
    points_w: FloatArray, out: FloatArray, state: State, clearance_m: FloatArray | float
) -> FloatArray:
    """Returns the shift (N,) of points (N, P, 3) along ``out`` (N, 3), in metres.

    After the shift, the distance of all points from the head is at least ``clearance_m`` (N,).
    """
    radius = state.person_radius_m[:, HEAD_GEOM_INDICES] + np.asarray(clearance_m)[..., None]
    offset = points_w[:, None] - state.person_capsule_ends_w[:, HEAD_GEOM_INDICES, :1]
    along = (offset * out[:, None, None]).sum(axis=-1)
    reach = along**2 - (offset * offset).sum(axis=-1) + radius[..., None] ** 2
    way = np.where(reach > 0.0, np.sqrt(np.maximum(reach, 0.0)) - along, 0.0)
    return np.maximum(way.max(axis=(1, 2)), 0.0)
