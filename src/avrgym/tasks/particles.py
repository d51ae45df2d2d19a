"""Where particles are with respect to the person's body."""

import numpy as np
from numpy.typing import NDArray

from avrgym.simulation import State

Array = NDArray[np.float64]

TOUCH_MARGIN_M = 0.002


def touching_person(state: State, radius_m: float) -> NDArray[np.bool_]:
    """Which particles (N, K) lie within 2 mm of the surface of a capsule of the person's body."""
    start, end = state.person_segment_w[:, None, :, 0], state.person_segment_w[:, None, :, 1]
    point = state.particle_pos_w[:, :, None]
    axis = end - start
    length_squared = (axis * axis).sum(axis=-1)
    along = ((point - start) * axis).sum(axis=-1) / np.maximum(length_squared, 1e-12)
    offset = point - start - np.clip(along, 0.0, 1.0)[..., None] * axis
    gap = np.sqrt((offset * offset).sum(axis=-1)) - state.person_radius_m[:, None] - radius_m
    return (gap < TOUCH_MARGIN_M).any(axis=-1)
