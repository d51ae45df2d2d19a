"""An exact test of whether draws depend on membership in a group, within blocks."""

from collections.abc import Iterable
from math import comb

import numpy as np

from avrgym.array_types import FloatArray

Block = tuple[int, int, int]
"""Numbers of units in a block: of all units, of units in the group, and of drawn units."""


def draws_p(blocks: Iterable[Block], drawn_in_group: int) -> float:
    """The two-sided probability of so many draws from the group, if in each block every unit is equally likely.

    The number of draws in the group is a sum of hypergeometric numbers, one for each block; p adds up the sums that are
    not more likely than the observed one.
    """
    probabilities: FloatArray = np.ones(1)
    for block in blocks:
        probabilities = np.convolve(probabilities, _hypergeometric(*block))
    observed = probabilities[drawn_in_group] * (1.0 + 1e-9)
    return min(1.0, float(probabilities[probabilities <= observed].sum()))


def _hypergeometric(units: int, members: int, drawn: int) -> list[float]:
    """The probabilities of 0, 1 and so on up to ``drawn`` draws from the members."""
    return [
        comb(members, hits) * comb(units - members, drawn - hits) / comb(units, drawn)
        for hits in range(drawn + 1)
    ]
