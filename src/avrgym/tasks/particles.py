"""What happens to the particles that a tool carries."""

import numpy as np
from numpy.typing import NDArray

from avrgym.simulation import State

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

TOUCH_MARGIN_M = 0.002


def touching_person(state: State, radius_m: float, asked: Bools) -> Bools:
    """Which of the particles that are ``asked`` for, (N, K) both, touch the person.

    They do within 2 mm of the surface of a capsule of the person's body.
    """
    world, particle = np.nonzero(asked)
    start, end = state.person_segment_w[world, :, 0], state.person_segment_w[world, :, 1]
    point = state.particle_pos_w[world, particle][:, None]
    axis = end - start
    length_squared = (axis * axis).sum(axis=-1)
    along = ((point - start) * axis).sum(axis=-1) / np.maximum(length_squared, 1e-12)
    offset = point - start - np.clip(along, 0.0, 1.0)[..., None] * axis
    gap = np.sqrt((offset * offset).sum(axis=-1)) - state.person_radius_m[world] - radius_m
    touching = np.zeros_like(asked)
    touching[world, particle] = (gap < TOUCH_MARGIN_M).any(axis=-1)
    return touching


def count(events: Bools) -> Array:
    """How many particles (N,) of (N, K) something happens to."""
    return events.sum(axis=-1).astype(float)
