"""Corrects contacts that differ between MuJoCo Warp 4.0 and MuJoCo, before constraints are computed.

In MuJoCo the geom with the higher priority determines a contact's parameters. Warp ignores the priority if a geom has
explicit stiffness and damping (``solref`` below zero). Warp then uses the lower values of the two geoms. This module
sets the parameters of the geom with the higher priority, for example of the washcloth on skin.

In MuJoCo a contact's impedance changes with depth from a first to a last value. For people the last value is lower:
people become more compliant with depth (``models.compliance``). Warp assumes a higher last value when it clips the
impedance. Contacts with people would then have the last value at any depth. This module therefore sets MuJoCo's
impedance at the current depth as a constant, with the corresponding stiffness and damping.
"""

# Warp has its own types, and is installed only with the extra ``gpu``.
# pyright: basic, reportMissingImports=false, reportInvalidTypeForm=false

from typing import Any

import warp as wp

SolimpVector = wp.types.vector(length=5, dtype=wp.float32)
"""MuJoCo's contact parameters ``solimp``: impedance as a function of depth."""


@wp.kernel(enable_backward=False)
def _correct(
    count: wp.array(dtype=int),
    world: wp.array(dtype=int),
    geoms: wp.array(dtype=wp.vec2i),
    distance: wp.array(dtype=float),
    margin: wp.array(dtype=float),
    priority: wp.array(dtype=int),
    stiffness_damping_of_geom: wp.array2d(dtype=wp.vec2),
    stiffness_damping: wp.array(dtype=wp.vec2),
    impedance: wp.array(dtype=SolimpVector),
):
    contact = wp.tid()
    if contact >= count[0]:
        return
    given = stiffness_damping[contact]
    row = world[contact] % stiffness_damping_of_geom.shape[0]
    one, other = geoms[contact][0], geoms[contact][1]
    if priority[one] > priority[other]:
        given = stiffness_damping_of_geom[row, one]
    elif priority[other] > priority[one]:
        given = stiffness_damping_of_geom[row, other]
    at = impedance[contact]
    first, last, middle, power = at[0], at[1], at[3], at[4]
    if first > last and given[0] <= 0.0 and given[1] <= 0.0:
        share = wp.clamp(wp.abs(distance[contact] - margin[contact]) / at[2], 0.0, 1.0)
        gone = 0.0
        if share <= middle:
            gone = middle * wp.pow(share / middle, power)
        else:
            gone = 1.0 - (1.0 - middle) * wp.pow((1.0 - share) / (1.0 - middle), power)
        now = first + gone * (last - first)
        ratio = now / last
        impedance[contact] = SolimpVector(now, now, at[2], middle, power)
        given = wp.vec2(given[0] * ratio * ratio, given[1] * ratio)
    stiffness_damping[contact] = given


def correct_contacts(model: Any, data: Any) -> None:
    """Correct the parameters of all contacts in place. No contact is removed."""
    contact = data.contact
    wp.launch(
        _correct,
        dim=data.naconmax,
        inputs=[
            data.nacon,
            contact.worldid,
            contact.geom,
            contact.dist,
            contact.includemargin,
            model.geom_priority,
            model.geom_solref,
            contact.solref,
            contact.solimp,
        ],
    )
