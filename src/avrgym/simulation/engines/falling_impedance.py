"""Contacts whose impedance falls with their depth, for MuJoCo Warp: people give way ever more, see ``models.yielding``.

MuJoCo's impedance goes from its first to its last value whichever is larger. MuJoCo Warp 4.0 holds it between the two
as if the last were the larger, which makes of ours the last from the first touch on. So before constraints are made of
contacts, each such contact gets the impedance that MuJoCo computes at its depth as a constant, and stiffness and
damping that make the same of it.
"""

# Warp's own language, and a package that is there only with the extra ``gpu``.
# pyright: basic, reportMissingImports=false, reportInvalidTypeForm=false

from typing import Any

import warp as wp

Five = wp.types.vector(length=5, dtype=wp.float32)


@wp.kernel(enable_backward=False)
def _fix(
    count: wp.array(dtype=int),
    distance: wp.array(dtype=float),
    margin: wp.array(dtype=float),
    stiffness_damping: wp.array(dtype=wp.vec2),
    impedance: wp.array(dtype=Five),
):
    contact = wp.tid()
    if contact >= count[0]:
        return
    at = impedance[contact]
    given = stiffness_damping[contact]
    first, last, middle, power = at[0], at[1], at[3], at[4]
    if first <= last or given[0] > 0.0 or given[1] > 0.0:
        return
    share = wp.clamp(wp.abs(distance[contact] - margin[contact]) / at[2], 0.0, 1.0)
    gone = 0.0
    if share <= middle:
        gone = middle * wp.pow(share / middle, power)
    else:
        gone = 1.0 - (1.0 - middle) * wp.pow((1.0 - share) / (1.0 - middle), power)
    now = first + gone * (last - first)
    ratio = now / last
    impedance[contact] = Five(now, now, at[2], middle, power)
    stiffness_damping[contact] = wp.vec2(given[0] * ratio * ratio, given[1] * ratio)


def fix(model: Any, data: Any) -> None:
    """A contact filter: it changes contacts and leaves out none."""
    contact = data.contact
    wp.launch(
        _fix,
        dim=data.naconmax,
        inputs=[data.nacon, contact.dist, contact.includemargin, contact.solref, contact.solimp],
    )
