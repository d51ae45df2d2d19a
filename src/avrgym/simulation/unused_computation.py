"""Removes computation without effect from a model. Physics steps become faster, and results stay bit-identical."""

from copy import copy

import mujoco
import numpy as np

from avrgym.array_types import BoolArray


def remove_unused_computation(model: mujoco.MjModel) -> mujoco.MjModel:
    """Returns a copy of a model without gravity compensation and contact bits that have no effect.

    Gravity compensation has no effect on a body that is fixed to the world. A geom never has contacts if its contact
    bits allow only geoms that are fixed to the same body. With a static person, this applies to most geoms of a robot
    on the floor.
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
    """Returns a boolean mask (G, G) of the pairs of geoms that can collide, by their contact bits and bodies."""
    meets = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
    fixed_to = model.body_weldid[model.geom_bodyid]
    return (meets | meets.T) & (fixed_to[:, None] != fixed_to)
