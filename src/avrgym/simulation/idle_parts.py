"""Parts of a scene that take time in every physics step and move nothing: steps without them give the same bits."""

from copy import copy

import mujoco
import numpy as np

from avrgym.array_types import BoolArray


def without_idle_parts(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of a model that does not hold up what stands fast, and does not look for contacts that cannot be.

    Gravity compensation of a body that is fixed to the world acts on no joint. A geom touches nothing if all that its
    contact bits let it touch is fixed to what it is fixed to itself. Where the person is still, most of a robot on a
    floor is such.
    """
    model = copy(model)
    model.body_gravcomp[model.body_weldid == 0] = 0.0
    idle = ~_may_touch(model).any(axis=1)
    for of_geoms, of_bodies in (
        (model.geom_contype, model.body_contype),
        (model.geom_conaffinity, model.body_conaffinity),
    ):
        of_geoms[idle] = 0
        of_bodies[:] = 0
        np.bitwise_or.at(of_bodies, model.geom_bodyid, of_geoms)
    return model


def _may_touch(model: mujoco.MjModel) -> BoolArray:
    """Which geoms (G, G) may touch each other, by their contact bits and by what they are fixed to."""
    meets = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
    fixed_to = model.body_weldid[model.geom_bodyid]
    return (meets | meets.T) & (fixed_to[:, None] != fixed_to)
